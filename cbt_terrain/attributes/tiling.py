# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles of the ground, each one image, with UDIM numbers, which have ten columns.

Renderers interpolate within a tile's image, not across its border, and EEVEE, which packs tiles of several sizes next
to each other, mixes in texels of other tiles. So every image has a margin of its neighbours' ground, MARGIN of its side
and at least one texel, which lookups avoid (operators/maps/images.py).

A terrain that fits into one image has one tile. EEVEE takes the jump between tiles for the derivative of the position
and shows a line of the coarsest mip there; the terrain's material uses no mips there (operators/layers/material.py).
Cycles has no mips and shows no line. A single image has no margin, and the mesh's UV are positions in it.
"""

import math
from dataclasses import dataclass

from ..field.lattice import Lattice

# Side of an image in texels. Blender's limit for graphics cards is 16,384; 4096 x 4096 texels of 8 bits are 64 MB.
MIN_SIDE, MAX_SIDE = 64, 4096
MARGIN = 1 / MIN_SIDE
# Cells along a side of a raster with one image, and of a tile, which has more if there would be too many columns.
SINGLE_CELLS, TILE_CELLS = 4096, 992
MAX_COLUMNS, MAX_ROWS = 10, 99
FIRST = 1001  # UDIM number of the south-western tile


@dataclass(frozen=True)
class Tiling:
    """`columns` x `rows` tiles of `width` x `height` metres from `west` and `south` on.

    Tiles are indexed from the south-western one eastwards. `margin`: fraction of an image's side.
    """

    columns: int
    rows: int
    west: float
    south: float
    width: float
    height: float
    margin: float

    def __len__(self) -> int:
        return self.columns * self.rows

    @property
    def inner(self) -> float:
        """Return the fraction of an image's side without the margins."""
        return 1.0 - 2.0 * self.margin

    def udim_number(self, tile: int) -> int:
        """Return the UDIM number of a tile: 1001 for the south-western one, + 1 for each column, + 10 for each row."""
        return FIRST + tile % self.columns + 10 * (tile // self.columns)

    def box(self, tile: int) -> tuple[float, float, float, float]:
        """Return the west, south, east and north border of a tile without its margin, metres in the terrain's space."""
        west = self.west + tile % self.columns * self.width
        south = self.south + tile // self.columns * self.height
        return west, south, west + self.width, south + self.height

    def texel(self, resolution: int) -> tuple[float, float]:
        """Return the size of a texel in metres, east and north, for a number of texels along a side.

        resolution: this number, with the margins.
        """
        return self.width / (resolution * self.inner), self.height / (resolution * self.inner)

    def first_texel(self, tile: int, resolution: int) -> tuple[float, float]:
        """Return x and y, metres, of the centre of the north-western texel of a tile's image.

        resolution: texels along a side, with the margins.
        """
        west, _, _, north = self.box(tile)
        step_x, step_y = self.texel(resolution)
        beyond = resolution * self.margin - 0.5
        return west - beyond * step_x, north + beyond * step_y


def tiling_of(lattice: Lattice, min_level: int = 0) -> Tiling:
    """Return the tiling of a raster: one tile up to SINGLE_CELLS, else about square ones.

    Tiles are larger than TILE_CELLS where MAX_COLUMNS or MAX_ROWS, the limits of UDIM numbers, require it. min_level:
    finest level of the raster's heights, 0, or below with finer tiles; SINGLE_CELLS and TILE_CELLS are cells of it.
    """
    west, south, east, north = lattice.rectangle()
    if max(lattice.cells_x, lattice.cells_y) << -min_level <= SINGLE_CELLS:
        return Tiling(1, 1, west, south, east - west, north - south, margin=0.0)
    side = TILE_CELLS * max(lattice.step_x, lattice.step_y) * 2.0**min_level
    side = max(side, (east - west) / MAX_COLUMNS, (north - south) / MAX_ROWS)
    columns = min(math.ceil((east - west) / side), MAX_COLUMNS)
    rows = min(math.ceil((north - south) / side), MAX_ROWS)
    return Tiling(columns, rows, west, south, (east - west) / columns, (north - south) / rows, MARGIN)
