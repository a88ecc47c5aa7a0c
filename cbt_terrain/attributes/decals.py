# SPDX-License-Identifier: GPL-3.0-or-later
"""Decals: images projected on the ground from above, over its colour or its normals."""

import hashlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from ..errors import TerrainError
from ..plain_numbers import keep_plain_numbers
from ..run import launch
from .attribute import Parameter, SamplePoints

DECALS = Parameter("decals", (), -math.inf, math.inf, "", "Decals laid on the ground, the topmost last")

LARGEST = np.float32(1e9)  # limit of colours, so that sums and products of a few are finite
BLOCK_VALUES = 1 << 16  # float32 of a block of rows: 256 KiB


@dataclass(frozen=True, eq=False)
class DecalPicture:
    """An image, identified by `digest`.

    `values`: float32 [rows, columns, 4], row 0 at the lower edge, premultiplied by alpha: linear red, green, blue and
    alpha or, if `tilts`, slopes along columns and rows, 0 and alpha.
    """

    values: np.ndarray = field(repr=False)
    tilts: bool
    digest: str

    @cached_property
    def mips(self) -> list[np.ndarray]:
        """Return the image and its mipmaps, each the means of 2 x 2 pixels of the one before."""
        mips = [self.values]
        while max(mips[-1].shape[:2]) > 1:
            mips.append(_halve(mips[-1]))
        return mips


def _halve(image: np.ndarray) -> np.ndarray:
    """Return the means of 2 x 2 pixels of float32 [rows, columns, channels]; an odd last row or column counts twice."""
    rows, columns, channels = image.shape
    means = np.empty(((rows + 1) // 2, (columns + 1) // 2, channels), np.float32)

    def fill(first: int, end: int) -> None:
        """Compute the rows `first` to `end` (exclusive) of the means."""
        part = image[2 * first : 2 * end]
        if len(part) % 2 or columns % 2:
            part = np.pad(part, ((0, len(part) % 2), (0, columns % 2), (0, 0)), "edge")
        south, north, out = part[0::2], part[1::2], means[first:end]
        np.add(south[:, 0::2], south[:, 1::2], out=out)
        out += north[:, 0::2]
        out += north[:, 1::2]
        out *= np.float32(0.25)

    blocks_of_rows(means.shape, fill)
    return means


def blocks_of_rows(shape: tuple[int, ...], work: Callable[[int, int], None]) -> None:
    """Call `work(first, end)` for blocks of rows of an image that fit into a core's cache, on several threads."""
    rows, length = shape[0], max(1, BLOCK_VALUES // max(1, math.prod(shape[1:])))
    blocks = [(first, min(first + length, rows)) for first in range(0, rows, length)]

    def run(part: tuple[int, int]) -> None:
        for block in blocks[slice(*part)]:
            work(*block)

    pieces = launch.ranges(len(blocks), min(launch.default_threads(), len(blocks)))
    launch.together([partial(run, part) for part in pieces])


def picture(pixels: np.ndarray, tilts: bool) -> DecalPicture:
    """Return the picture of pixels, float [rows, columns, 4], 0 .. 1, row 0 at the lower edge, not premultiplied.

    tilts: the pixels are a normal map, of which slopes are stored; else linear colours, which may exceed 1. Values that
    are not finite become finite.
    """
    return picture_of_rows(pixels.shape, lambda first, end: pixels[first:end], tilts)


def picture_of_rows(shape: tuple[int, ...], read_rows: Callable[[int, int], np.ndarray], tilts: bool) -> DecalPicture:
    """Return the picture of pixels that are computed by blocks of rows, on several threads.

    shape: rows, columns and 4. read_rows: returns the pixels, float [rows, columns, 4], not premultiplied, from one row
    up to another (exclusive). tilts: the pixels are a normal map, of which slopes are stored; else linear colours.
    """
    values = np.empty(shape, np.float32)

    def fill(first: int, end: int) -> None:
        values[first:end] = _premultiplied(read_rows(first, end), tilts)

    blocks_of_rows(shape, fill)
    content = hashlib.blake2b(repr((values.shape, tilts)).encode(), digest_size=16)
    content.update(values.data)
    return DecalPicture(values, tilts, content.hexdigest())


def _premultiplied(pixels: np.ndarray, tilts: bool) -> np.ndarray:
    """Return the values of a `DecalPicture` for pixels of some rows: colours or slopes times alpha, and alpha.

    pixels: float [rows, columns, 4]. tilts: they are a normal map, of which slopes are computed.
    """
    finite = np.array(pixels, np.float32)
    if not (finite.min() >= -LARGEST and finite.max() <= LARGEST):  # a NaN makes both comparisons false
        np.clip(np.nan_to_num(finite, copy=False), -LARGEST, LARGEST, out=finite)
    alpha = np.clip(finite[..., 3:], 0.0, 1.0)
    if tilts:  # a normal map has -1 .. 1 as 0 .. 1
        normals = finite[..., :3] * np.float32(2.0) - np.float32(1.0)
        finite[..., :2] = -normals[..., :2] / np.maximum(normals[..., 2:], np.float32(0.05))  # slopes of 20 at most
        finite[..., 2] = 0.0
    finite *= alpha  # all four values: numpy takes twice as long for three of four
    finite[..., 3:] = alpha
    return finite


@dataclass(frozen=True)
class Decal:
    """A picture on the ground.

    `corner`: its lower left corner, `along`, `up`: vectors of its lower and left edge, all x and y in metres in the
    terrain's space. `opacity`: 0 .. 1.
    """

    name: str
    picture: DecalPicture
    corner: tuple[float, float]
    along: tuple[float, float]
    up: tuple[float, float]
    opacity: float = 1.0

    def __post_init__(self) -> None:
        """Check that numbers are finite and that the decal has an area from above. Raises TerrainError."""
        keep_plain_numbers(self, "The decal's")
        if not (math.isfinite(self._area) and self._area != 0.0):
            raise TerrainError(f"The decal {self.name!r} stands upright or has no size", fix="rotate or scale it")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Decal) and repr(self) == repr(other)

    def __hash__(self) -> int:
        return hash(repr(self))

    @property
    def _area(self) -> float:
        """Return the signed area of the image on the ground, m^2; below 0 if it is mirrored."""
        return self.along[0] * self.up[1] - self.along[1] * self.up[0]

    @property
    def pixel(self) -> float:
        """Return the side of a square with the area of a pixel, metres."""
        rows, columns, _ = self.picture.values.shape
        return math.sqrt(abs(self._area) / (rows * columns))

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Return west, south, east and north end, metres in the terrain's space."""
        x, y = ((0.0, self.along[k], self.up[k], self.along[k] + self.up[k]) for k in (0, 1))
        west, south = self.corner[0] + min(x), self.corner[1] + min(y)
        return west, south, self.corner[0] + max(x), self.corner[1] + max(y)

    def sample(self, points: SamplePoints) -> tuple[np.ndarray, np.ndarray]:
        """Return the indices of the points that it covers, int64 [n], and its values there, float32 [n, 4].

        Values are those of `DecalPicture`, interpolated between the two mipmaps nearest to each point's scale, and
        multiplied by the opacity.
        """
        x = points.positions[:, 0].astype(np.float64) - self.corner[0]
        y = points.positions[:, 1].astype(np.float64) - self.corner[1]
        # Fractions of the way along the picture's lower and left edge; `_area` is that of the parallelogram of both.
        u = (x * self.up[1] - y * self.up[0]) / self._area
        v = (y * self.along[0] - x * self.along[1]) / self._area
        which = np.flatnonzero((u >= 0) & (u <= 1) & (v >= 0) & (v <= 1))
        u, v = u[which], v[which]
        mips, lattice = self.picture.mips, points.field.lattice
        rows, columns, _ = mips[0].shape
        # The scale of each point as a level of the raster's pyramid; all texels of a map have `image_level`.
        levels = points.level[which] if points.image_level is None else points.image_level
        # The same scale as a number of mipmaps, 0 for the image itself, whose pixels are `pixel` metres.
        levels = levels + np.full(len(which), math.log2(max(lattice.step_x, lattice.step_y) / self.pixel))
        levels = np.clip(levels, 0.0, len(mips) - 1.0)
        values = np.zeros((len(which), 4), np.float32)
        for number, mip in enumerate(mips):
            weight = np.maximum(1.0 - abs(levels - number), 0.0).astype(np.float32)
            between = np.flatnonzero(weight)  # points whose scale is near this mipmap's
            pixel = u[between] * (columns / 2**number) - 0.5, v[between] * (rows / 2**number) - 0.5
            values[between] += weight[between, None] * _interpolate(mip, *pixel)
        return which, values * np.float32(self.opacity)


def _interpolate(image: np.ndarray, column: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Interpolate an image bilinearly between the centres of its pixels; clamped at its edges.

    image: float32 [rows, columns, channels]. column, row: float64 [n] in pixels. Returns float32 [n, channels].
    """
    rows, columns, _ = image.shape
    column, row = np.clip(column, 0, columns - 1), np.clip(row, 0, rows - 1)
    west, south = column.astype(np.int64), row.astype(np.int64)
    east, north = np.minimum(west + 1, columns - 1), np.minimum(south + 1, rows - 1)
    s, t = (column - west).astype(np.float32)[:, None], (row - south).astype(np.float32)[:, None]
    lower = image[south, west] * (1 - s) + image[south, east] * s
    return lower * (1 - t) + (image[north, west] * (1 - s) + image[north, east] * s) * t


def cover(colors: np.ndarray, decals: Sequence[Decal], points: SamplePoints) -> None:
    """Composite colour decals over `colors`, float32 [n, 3], in place and in order (Porter and Duff 1984, "over").

    Decals that are normal maps are skipped. points: where these colours are.
    """
    for decal in decals:
        if not decal.picture.tilts:
            which, values = decal.sample(points)
            colors[which] = values[:, :3] + (1 - values[:, 3:]) * colors[which]


def tilt(normals: np.ndarray, decals: Sequence[Decal], points: SamplePoints) -> None:
    """Add the slopes of decals that are normal maps to those of the ground, in place: `normals`, float32 [n, 3].

    The first two values of such a decal are the slopes along the two sides of its image. Colour decals are skipped.
    points: where these normals are.
    """
    for decal in decals:
        if decal.picture.tilts:
            which, values = decal.sample(points)
            upright = normals[which] / normals[which, 2:]
            for slope, (x, y) in zip(values.T[:2], (decal.along, decal.up), strict=True):
                length = math.sqrt(x * x + y * y)
                # An upright normal, z = 1, has the negative slopes as x and y.
                upright[:, 0] -= slope * np.float32(x / length)
                upright[:, 1] -= slope * np.float32(y / length)
            normals[which] = upright / np.sqrt((upright * upright).sum(axis=1, keepdims=True))
