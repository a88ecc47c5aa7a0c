# SPDX-License-Identifier: GPL-3.0-or-later
"""A grid of samples over a terrain, divided into tiles of one size.

Samples of the grid are `num` / `den` samples of the raster apart, along each axis.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import TerrainError
from ..field.lattice import Lattice
from ..query.grid import GridAxis, grid_axes

MAX_TILE, MAX_TILES = 32_768, 10_000
PATTERN = "{name}_x{x}_y{y}"  # file name of a tile
# Samples a side that fill Unreal's landscape components completely (Landscape Technical Guide).
UNREAL_SIZES = (505, 1009, 2017, 4033, 8129)


@dataclass(frozen=True)
class TileAxis:
    """The samples of a grid along one axis.

    Attributes:
        size: samples of a tile.
        tiles: number of tiles.
        overlap: samples that neighbouring tiles share.
        grid: positions of the samples on the terrain. Samples beyond repeat the border.
    """

    size: int
    tiles: int
    overlap: int
    grid: GridAxis

    @property
    def spacing(self) -> float:
        """Return the distance between samples, metres."""
        return self.grid.spacing

    @property
    def length(self) -> float:
        """Return the length of the terrain, metres."""
        return self.grid.length

    @property
    def total(self) -> int:
        """Return the number of samples of all tiles along the axis, those beyond the terrain included."""
        return self.tiles * (self.size - self.overlap) + self.overlap

    @property
    def inside(self) -> int:
        """Return the number of samples on the terrain; those beyond repeat its border."""
        return min(self.total, self.grid.inside)

    def first(self, tile: int) -> int:
        """Return the first sample of a tile; neighbours share `overlap` samples."""
        return tile * (self.size - self.overlap)

    @cached_property
    def places(self) -> np.ndarray:
        """Return the positions of the samples, float64 metres from the first one."""
        return np.minimum(np.arange(self.total) * self.spacing, self.length)


def axes_of(
    lattice: Lattice, size: int, tiles: tuple[int, int] | None, overlap: int, step: float = 0.0
) -> tuple[TileAxis, TileAxis]:
    """Return the axes from west to east and between north and south.

    Raises TerrainError for sizes and overlaps out of range, and for more than MAX_TILES tiles.

    Args:
        lattice: the terrain's lattice.
        size: samples of a tile's side; 0 for one tile.
        tiles: number of tiles along x and y that cover the terrain exactly, with another spacing of the samples; None
            for samples `step` apart, and the last tiles reach beyond its border.
        overlap: samples that neighbouring tiles share, 0 or 1.
        step: metres between samples, 0 for those of the raster.
    """
    if overlap not in (0, 1):
        raise TerrainError(f"Tiles overlap by {overlap} samples", expected="0 or 1")
    if size and not 2 <= size <= MAX_TILE:
        raise TerrainError(f"A tile has {size} samples a side", expected=f"2 to {MAX_TILE:,}")
    if tiles and not size:
        raise TerrainError("The number of tiles has no size of a tile", expected="samples a side, as 1009")
    if tiles and step:
        raise TerrainError("The number of tiles and the step of samples exclude each other", fix="leave one out")
    counts = tiles or (0, 0)
    axes = tuple(_axis(*each, size, overlap) for each in zip(grid_axes(lattice, step), counts, strict=True))
    if axes[0].tiles * axes[1].tiles > MAX_TILES:
        raise TerrainError(
            f"These are {axes[0].tiles:,} x {axes[1].tiles:,} tiles",
            expected=f"at most {MAX_TILES:,}",
            fix="enlarge them",
        )
    return axes[0], axes[1]


def _axis(grid: GridAxis, count: int, size: int, overlap: int) -> TileAxis:
    """Return the tiles along an axis with the samples of a grid.

    `count`: tiles that end at the border exactly, with another grid; 0 to keep the grid. `size`: samples of a
    tile, 0 for a single tile. `overlap`: samples that neighbours share, 0 or 1. `grid.inside`: number of samples on the
    terrain.
    """
    if not size:
        return TileAxis(size=grid.inside, tiles=1, overlap=overlap, grid=grid)
    stride = size - overlap
    if not count:
        return TileAxis(size, max(1, math.ceil((grid.inside - overlap) / stride)), overlap, grid)
    # All tiles have count * stride + overlap samples, which are num / den steps of the raster apart.
    fitted = GridAxis(grid.samples, grid.step, num=grid.samples - 1, den=count * stride + overlap - 1)
    return TileAxis(size, count, overlap, fitted)
