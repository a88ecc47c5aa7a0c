# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement below the raster's cells by a tiling image.

Its pixels are the control heights of a uniform periodic bicubic B-spline: a surface with continuous second derivatives,
between the minimum and the maximum of its pixels, and a little smoother than they are. Derivatives of a B-spline are
means of differences of control heights. A piece has four by four control heights, and its derivative along x is a mean
of their first differences along x, and so on. So the largest absolute differences bound the piece's slope. With the
largest second differences a along x, b along y and c mixed, the larger eigenvalue of ((a, c), (c, b)) bounds its second
derivative in any direction.

An image has rough and smooth parts. By subdivision a coarser net with half the pixels along each axis is exactly a net
of all pixels, too: U d. The control heights of the difference bound the remainder of the image. So each coarser net
gives a split of the surface (detail_bounds.py): `far` is the sum of the ranges of the differences, curvature and slope
are those of the coarser net. The choice of the net changes only how tight the bound is.
"""

import hashlib
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import TYPE_CHECKING

import numpy as np

from ..errors import TerrainError, check_number
from ..plain_numbers import keep_plain_numbers
from ..view.linear import add_up
from .detail import EDGES_A_WAVE, LARGEST
from .detail_bounds import OUTWARD, DetailTerm, Split
from .painted import Painted

if TYPE_CHECKING:
    from ...kernels.field import detail as kernels

MAX_PIXELS = 1 << 22
# Weights for a net of every other pixel: they remove waves of two pixels, and U restores long waves.
DOWN = (-3 / 16, 4 / 16, 14 / 16, 4 / 16, -3 / 16)


@dataclass(frozen=True)
class Tiled:
    """An image as heights: `amplitude` metres for the value 1, minus `amplitude` for the value 0.

    A tile is `size` metres wide and has square pixels; the middle of its first pixel is in the terrain's middle.
    """

    amplitude: float
    size: float
    image: Painted

    def __post_init__(self) -> None:
        """Raise TerrainError for a number outside of its range or an image that is too large."""
        keep_plain_numbers(self, "The detail's")
        check_number("The detail's amplitude", self.amplitude, 0.0, LARGEST, "metres")
        check_number("The detail's tile", self.size, 1e-3, LARGEST, "metres")
        if self.image.values.size > MAX_PIXELS:
            raise TerrainError(
                f"The detail's image has {self.image.values.size:,} pixels",
                expected=f"{MAX_PIXELS:,} at most, as 2048 x 2048",
                fix="scale it down",
            )

    @property
    def key(self) -> str:
        """Return a hex digest of the parameters and the image, by which surfaces and results are cached."""
        text = repr((float(self.amplitude), float(self.size), self.image.digest))
        return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()

    def _net(self, finest: float) -> tuple["_Net", float]:
        """Return the finest net of control heights that a mesh can show, and the metres between its pixels.

        finest: shortest edge of the mesh's triangles, metres. If no net is coarse enough for it, the coarsest is
        returned.
        """
        nets, texel = _nets(self.image), self.size / self.image.values.shape[1]
        number = 0
        # The shortest waves of a net are two of its pixels; a wave has to have at least EDGES_A_WAVE edges.
        while number + 1 < len(nets) and 2 * texel * 2**number < EDGES_A_WAVE * finest:
            number += 1
        return nets[number], texel * 2**number

    def parts(self, finest: float) -> list[DetailTerm]:
        """Return the surface as one summand, from which bounds are computed.

        finest: metres of the shortest edges of meshes.
        """
        net, texel = self._net(finest)
        # Limits of a net are for the amplitude 1 and pixels a metre apart: factors of heights, and per metre of slopes.
        a, per = self.amplitude, 1.0 / texel
        splits = tuple(
            Split(a * s.far, a * s.curvature * per * per, a * s.steep * per, a * s.highest) for s in net.splits
        )
        highest, steep = a * net.splits[0].highest, a * net.splits[0].steep * per
        return [DetailTerm(highest, steep, shortest=2 * texel, splits=splits)]

    def packed(self, finest: float) -> "tuple[kernels.PackedDetail, np.ndarray]":
        """Return the detail as a structure of kernels, and its control heights, float32 [rows, columns], -1 to 1.

        They are the net that suits a mesh with shortest edges of `finest` metres; `texel` is the metres of its pixels.
        """
        from ...kernels.field import detail as kernels

        (net, texel), d = self._net(finest), kernels.PackedDetail()
        d.rows, d.columns = net.heights.shape
        d.amplitude, d.frequency = self.amplitude, 1.0 / texel
        return d, net.heights


@dataclass(frozen=True, eq=False)
class _Net:
    """Control heights for the amplitude 1, a metre apart, and the splits of their surface."""

    heights: np.ndarray
    splits: tuple[Split, ...]


@lru_cache(maxsize=16)
def _nets(image: Painted) -> tuple[_Net, ...]:
    """Return the image's control heights and coarser ones, the finest net first, each for pixels a metre apart.

    A net has the control heights of a B-spline, -1 .. 1 for values 0 .. 1; a coarser one has half the rows and columns.
    The last one has an odd number of rows or columns.
    """
    first = 2.0 * image.values.astype(np.float64) - 1.0
    heights, ranges = [first.astype(np.float32)], []  # ranges: of the difference of each net to the next
    while all(n % 2 == 0 for n in heights[-1].shape):
        net = heights[-1].astype(np.float64)
        heights.append(_halve_net(net).astype(np.float32))
        ranges.append(_range(net - _double_net(heights[-1].astype(np.float64))))
    bounds = [_bounds(net.astype(np.float64)) for net in heights]
    nets = []
    for k, values in enumerate(heights):
        splits, far = [], 0.0  # with each coarser net's surface as the smooth part; far: range of the remainder
        for j in range(k, len(heights)):
            side = 2.0 ** (j - k)  # metres between the pixels of net j
            curvature, steep, highest = bounds[j]
            splits.append(Split(far, curvature / (side * side) * OUTWARD, steep / side * OUTWARD, highest * OUTWARD))
            far += ranges[j] * OUTWARD if j < len(ranges) else 0.0
        far = _range(values.astype(np.float64)) * OUTWARD
        splits.append(Split(far, curvature=0.0, steep=0.0, highest=0.0))  # no smooth part
        nets.append(_Net(np.ascontiguousarray(values), tuple(splits)))
    return tuple(nets)


def _range(net: np.ndarray) -> float:
    """Return the length of the smallest interval that contains 0 and all values of a net."""
    return float(max(net.max(), 0.0) - min(net.min(), 0.0))


def _halve_net(net: np.ndarray) -> np.ndarray:
    """Return control heights with half the pixels along both axes, whose surface is near that of `net`.

    A filter, with the weights DOWN along each axis, removes the waves of two pixels before every other one is taken.
    Meshes with long edges show the result in place of `net`. Both sides of `net` are even.
    """
    for axis in (0, 1):
        net = add_up(weight * np.roll(net, 2 - k, axis) for k, weight in enumerate(DOWN))
        net = net[::2] if axis == 0 else net[:, ::2]
    return net


def _double_net(net: np.ndarray) -> np.ndarray:
    """Return control heights with twice the pixels along both axes and the same surface.

    It is the subdivision of cubic B-splines.
    """
    for axis in (0, 1):
        before, after = np.roll(net, 1, axis), np.roll(net, -1, axis)
        pairs = np.stack([(before + 6 * net + after) / 8, (net + after) / 2], axis + 1)
        net = pairs.reshape(-1, net.shape[1]) if axis == 0 else pairs.reshape(net.shape[0], -1)
    return net


def _bounds(net: np.ndarray) -> tuple[float, float, float]:
    """Return the largest curvature, slope and magnitude of a net's surface with pixels a metre apart."""
    along = [np.roll(net, -1, axis) - net for axis in (1, 0)]  # from this pixel to the next
    second = [step - np.roll(step, 1, axis) for step, axis in zip(along, (1, 0), strict=True)]
    mixed = np.roll(along[0], -1, 0) - along[0]
    # The piece between this pixel and the next has the control heights from one pixel before to two after. Pairs are
    # the first and last pixels of its differences: along y, then along x.
    a, b = _max_around(second[0], (-1, 2), (0, 1)), _max_around(second[1], (0, 1), (-1, 2))
    c = _max_around(mixed, (-1, 1), (-1, 1))
    curvature = 0.5 * (a + b) + np.sqrt(0.25 * (a - b) * (a - b) + c * c)  # eigenvalue of [[a, c], [c, b]]
    east, north = _max_around(along[0], (-1, 2), (-1, 1)), _max_around(along[1], (-1, 1), (-1, 2))
    steep = np.sqrt(east * east + north * north)
    return float(curvature.max()), float(steep.max()), float(np.abs(net).max())


def _max_around(values: np.ndarray, rows: tuple[int, int], columns: tuple[int, int]) -> np.ndarray:
    """Return the largest magnitude from rows[0] to rows[1] and columns[0] to columns[1] after each pixel."""
    largest = np.abs(values)
    for axis, (first, last) in enumerate((rows, columns)):
        largest = reduce(np.maximum, (np.roll(largest, -k, axis) for k in range(first, last + 1)))
    return largest
