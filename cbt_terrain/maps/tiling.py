# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground cut into tiles, each an image of its own: numbered as UDIM tiles are, which count ten across.

Renderers interpolate within a tile's image, not across its rim, and EEVEE, which packs tiles of several sizes side by
side, mixes in texels of a stranger. So every image shows a margin of its neighbours' ground: MARGIN of its side all
round, which is at least one texel. What looks a tile up keeps clear of it
(operators/effects/map_images.py).

A terrain that fits into one image is not cut: EEVEE takes the jump from tile to tile for the derivative of the place,
and shows the coarsest mip in a line of a pixel or two where tiles meet; the terrain's own material takes no mips there
(operators/effects/material.py). Cycles has no mips, and shows no line. One image has no margin, and the mesh's UV are
places in it.
"""

import math
from dataclasses import dataclass

from ..field.lattice import Lattice

# A texture's side; Blender's own limit for a graphics card is 16,384, and a tile of 4096 is 64 MB as bytes.
LEAST, MOST = 64, 4096
MARGIN = 1 / LEAST
# So many cells of the raster are one image; a tile has so many, or more where there would be more than ten across.
SINGLE_CELLS, TILE_CELLS = 4096, 992
MOST_COLUMNS, MOST_ROWS = 10, 99
FIRST = 1001


@dataclass(frozen=True)
class Tiling:
    """`columns` x `rows` tiles of `width` x `height` metres over the ground from `west` and `south` on.

    A tile is known by its index, from the south-western one eastwards. `margin`: part of an image's side.
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
        """Part of an image's side that is not margin."""
        return 1.0 - 2.0 * self.margin

    def number(self, tile: int) -> int:
        """As UDIM counts."""
        return FIRST + tile % self.columns + 10 * (tile // self.columns)

    def box(self, tile: int) -> tuple[float, float, float, float]:
        """West, south, east and north rim of a tile, without its margin."""
        west = self.west + tile % self.columns * self.width
        south = self.south + tile // self.columns * self.height
        return west, south, west + self.width, south + self.height

    def texel(self, resolution: int) -> tuple[float, float]:
        """Metres from texel to texel of an image of so many a side, east and north."""
        return self.width / (resolution * self.inner), self.height / (resolution * self.inner)

    def first_texel(self, tile: int, resolution: int) -> tuple[float, float]:
        """The centre of the north-western texel of an image."""
        west, _, _, north = self.box(tile)
        step_x, step_y = self.texel(resolution)
        beyond = resolution * self.margin - 0.5
        return west - beyond * step_x, north + beyond * step_y


def tiling_of(lattice: Lattice) -> Tiling:
    """The tiles of a raster: about square, and no more of them than can be numbered."""
    west, south, east, north = lattice.rectangle()
    if max(lattice.cells_x, lattice.cells_y) <= SINGLE_CELLS:
        return Tiling(1, 1, west, south, east - west, north - south, 0.0)
    side = TILE_CELLS * max(lattice.step_x, lattice.step_y)
    side = max(side, (east - west) / MOST_COLUMNS, (north - south) / MOST_ROWS)
    columns = min(math.ceil((east - west) / side), MOST_COLUMNS)
    rows = min(math.ceil((north - south) / side), MOST_ROWS)
    return Tiling(columns, rows, west, south, (east - west) / columns, (north - south) / rows, MARGIN)
