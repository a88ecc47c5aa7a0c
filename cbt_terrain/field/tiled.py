# SPDX-License-Identifier: GPL-3.0-or-later
"""A tiling image as a height below the raster's cells, and how far a triangle can be from it.

Its pixels are the control heights of a uniform bicubic B-spline that repeats: a surface with continuous second
derivatives, between the least and the most of its pixels, and a little softer than they are. As with every B-spline,
derivatives are means of differences of control heights: of four by four of them that make a piece, those along x of
first differences along x, and so on. So their largest absolute values bound that piece's slope; and with a, b of the
second differences along x and y and c of the mixed ones, its second derivative in any direction by the larger
eigenvalue of ((a, c), (c, b)).

An image has rough and smooth parts. A coarser net of half as many pixels along each axis is by subdivision a net of all
pixels too, exactly: U d. The image's own less that is bounded by its control heights. Net by net that gives a way to
divide the surface (detail_bounds.py): `far` is the sum of the ranges of what was taken off, bend and slope are those of
the net that is left. Which net is taken changes how near the bound is, not whether it holds.
"""

import hashlib
from dataclasses import dataclass
from functools import lru_cache, reduce

import numpy as np

from ...kernels.field import detail as kernels
from ..ask.linear import add_up
from ..errors import TerrainError, check_number
from ..plain_numbers import keep_plain_numbers
from .detail import EDGES_A_WAVE, LARGEST
from .detail_bounds import OUTWARD, Part, Way
from .painted import Painted

MOST_PIXELS = 1 << 22
# To a net of every other pixel: no wave of two pixels is left, and of long ones U gives back what was there.
DOWN = (-3 / 16, 4 / 16, 14 / 16, 4 / 16, -3 / 16)


@dataclass(frozen=True)
class Tiled:
    """An image as heights: `amplitude` metres where it is 1, as much below the surface where it is 0. A tile has `size`
    metres along x, and square pixels; the middle of its first pixel is in the terrain's middle."""

    amplitude: float
    size: float
    image: Painted

    def __post_init__(self):
        keep_plain_numbers(self, "The detail's")
        check_number("The detail's amplitude", self.amplitude, 0.0, LARGEST, "metres")
        check_number("The detail's tile", self.size, 1e-3, LARGEST, "metres")
        if self.image.values.size > MOST_PIXELS:
            raise TerrainError(
                f"The detail's image has {self.image.values.size:,} pixels; expected {MOST_PIXELS:,} at most, as 2048 "
                "x 2048: scale it down."
            )

    @property
    def key(self) -> str:
        """Equal for equal details."""
        text = repr((float(self.amplitude), float(self.size), self.image.digest))
        return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()

    def _net(self, finest: float) -> tuple["_Net", float]:
        """The finest net that leaves with edges of `finest` metres can show, and metres between its pixels."""
        nets, texel = _nets(self.image), self.size / self.image.values.shape[1]
        number = 0
        while number + 1 < len(nets) and 2 * texel * 2**number < EDGES_A_WAVE * finest:
            number += 1
        return nets[number], texel * 2**number

    def parts(self, finest: float) -> list[Part]:
        """As bounds are taken of it."""
        net, texel = self._net(finest)
        a, per = self.amplitude, 1.0 / texel
        ways = tuple(Way(a * w.far, a * w.bend * per * per, a * w.steep * per, a * w.most) for w in net.ways)
        return [Part(a * net.ways[0].most, a * net.ways[0].steep * per, 2 * texel, ways)]

    def packed(self, finest: float) -> tuple[kernels.Detail, np.ndarray]:
        """As the kernels read it, and its control heights, float32 [rows, columns]."""
        (net, texel), d = self._net(finest), kernels.Detail()
        d.rows, d.columns = net.heights.shape
        d.amplitude, d.frequency = self.amplitude, 1.0 / texel
        return d, net.heights


@dataclass(frozen=True, eq=False)
class _Net:
    """Control heights of an amplitude of 1, a metre apart, and the ways to divide their surface."""

    heights: np.ndarray
    ways: tuple[Way, ...]


@lru_cache(maxsize=16)
def _nets(image: Painted) -> tuple[_Net, ...]:
    """The image's own net and coarser ones, the finest first; a metre between the pixels of each."""
    first = 2.0 * image.values.astype(np.float64) - 1.0
    heights, off = [first.astype(np.float32)], []
    while all(n % 2 == 0 for n in heights[-1].shape):
        net = heights[-1].astype(np.float64)
        heights.append(_halved(net).astype(np.float32))
        off.append(_range(net - _doubled(heights[-1].astype(np.float64))))
    smooth = [_bounds(net.astype(np.float64)) for net in heights]
    found = []
    for k, net in enumerate(heights):
        ways, far = [], 0.0
        for j in range(k, len(heights)):
            side = 2.0 ** (j - k)
            bend, steep, most = smooth[j]
            ways.append(Way(far, bend / (side * side) * OUTWARD, steep / side * OUTWARD, most * OUTWARD))
            far += off[j] * OUTWARD if j < len(off) else 0.0
        ways.append(Way(_range(net.astype(np.float64)) * OUTWARD, 0.0, 0.0, 0.0))
        found.append(_Net(np.ascontiguousarray(net), tuple(ways)))
    return tuple(found)


def _range(net: np.ndarray) -> float:
    """Between the least and the most of it and 0."""
    return float(max(net.max(), 0.0) - min(net.min(), 0.0))


def _halved(net: np.ndarray) -> np.ndarray:
    """A net of every other pixel along both axes, near the surface of this one."""
    for axis in (0, 1):
        net = add_up(weight * np.roll(net, 2 - k, axis) for k, weight in enumerate(DOWN))
        net = net[::2] if axis == 0 else net[:, ::2]
    return net


def _doubled(net: np.ndarray) -> np.ndarray:
    """The net of twice as many pixels along both axes that has the same surface (subdivision of cubic B-splines)."""
    for axis in (0, 1):
        before, after = np.roll(net, 1, axis), np.roll(net, -1, axis)
        pairs = np.stack([(before + 6 * net + after) / 8, (net + after) / 2], axis + 1)
        net = pairs.reshape(-1, net.shape[1]) if axis == 0 else pairs.reshape(net.shape[0], -1)
    return net


def _bounds(net: np.ndarray) -> tuple[float, float, float]:
    """Largest second derivative, slope and distance from 0 of a net's surface, its pixels a metre apart."""
    along = [np.roll(net, -1, axis) - net for axis in (1, 0)]  # from this pixel to the next
    second = [step - np.roll(step, 1, axis) for step, axis in zip(along, (1, 0), strict=True)]
    mixed = np.roll(along[0], -1, 0) - along[0]
    # Of the piece between this pixel and the next: its control heights are those of one before to two after.
    a, b = _most_of(second[0], (-1, 2), (0, 1)), _most_of(second[1], (0, 1), (-1, 2))
    c = _most_of(mixed, (-1, 1), (-1, 1))
    bend = 0.5 * (a + b) + np.sqrt(0.25 * (a - b) * (a - b) + c * c)
    east, north = _most_of(along[0], (-1, 2), (-1, 1)), _most_of(along[1], (-1, 1), (-1, 2))
    steep = np.sqrt(east * east + north * north)
    return float(bend.max()), float(steep.max()), float(np.abs(net).max())


def _most_of(values: np.ndarray, rows: tuple[int, int], columns: tuple[int, int]) -> np.ndarray:
    """The largest magnitude of those from rows[0] to rows[1] rows and as many columns after each."""
    found = np.abs(values)
    for axis, (first, last) in enumerate((rows, columns)):
        found = reduce(np.maximum, (np.roll(found, -k, axis) for k in range(first, last + 1)))
    return found
