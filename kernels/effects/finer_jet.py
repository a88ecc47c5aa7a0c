# SPDX-License-Identifier: GPL-3.0-or-later
"""Jets at levels below 0, of finer tiles and the pyramid of their heights.

A *finer tile* is a square of the raster with heights at a fraction of its step. Level -bits has the finer heights. The
levels up to -1 are those of a pyramid over all finer heights; level 0 is the raster, so that values are continuous
where a point's level passes 0.
"""

import warp as wp

from ..field.finer import SIDE, STRIDE, TILE_BITS
from ..unchecked import item_at
from .pyramid import Jet, Pyramid, inverse_power, jet_of, level_jet


@wp.struct
class FinerHeights:
    """The pyramids of tiles with finer heights, one above the other in one struct.

    At level l a tile has SIDE >> l cells a side, and one more sample before the first and one after the last.
    """

    bits: wp.int32  # a raster cell has 2^bits finer cells a side; the pyramids have levels 0 .. bits - 1
    columns: wp.int32  # of the table of tiles
    tiles: wp.array(dtype=wp.int32)  # [rows * columns]: number of each tile in the array of level 0
    numbers: wp.array(dtype=wp.int32)  # ... and in those of the coarser levels; -1 without finer heights
    cells_x: wp.int32  # finer cells of the raster
    cells_y: wp.int32
    levels: Pyramid


@wp.func
def tile_jet(
    finer: FinerHeights, column: wp.int32, row: wp.int32, level: wp.int32, x: wp.float64, y: wp.float64
) -> Jet:
    """Return the jet (z, zx, zy, zxx, zxy, zyy) of one level of the tile in a column and row of the table of tiles.

    x, y: position in finer cells of the raster. level: of the tile's pyramid, 0 the finest. z: metres before vertical
    scaling; the derivatives are per metre.
    """
    scale = inverse_power(level)  # 2^-level
    side = SIDE >> level
    first_x = column << TILE_BITS
    first_y = row << TILE_BITS
    u = (x - wp.float64(first_x)) * scale
    v = (y - wp.float64(first_y)) * scale
    i = wp.min(wp.int32(u), wp.min(side, (finer.cells_x - first_x) >> level) - 1)
    j = wp.min(wp.int32(v), wp.min(side, (finer.cells_y - first_y) >> level) - 1)
    place = row * finer.columns + column
    # Rows of the level's array before those of the tile. A tile has side + 1 samples and one more at each end, so side
    # + 3 rows; at level 0 that is STRIDE. It begins one sample before the tile, so (i, j) is the first of the 4 x 4
    # samples of the cell. Level 0 has all tiles, the others only those with finer heights.
    first_row = wp.where(level == 0, item_at(finer.tiles, place) * STRIDE, item_at(finer.numbers, place) * (side + 3))
    q = jet_of(finer.levels, level, i, first_row + j, wp.float32(u - wp.float64(i)), wp.float32(v - wp.float64(j)))
    per_x = finer.levels.per_x * scale
    per_y = finer.levels.per_y * scale
    return Jet(q[0], q[1] * per_x, q[2] * per_y, q[3] * per_x * per_x, q[4] * per_x * per_y, q[5] * per_y * per_y)


@wp.func
def finer_jet_at(finer: FinerHeights, ground: Pyramid, x: wp.float64, y: wp.float64, level: wp.float32) -> Jet:
    """Return the jet (z, zx, zy, zxx, zxy, zyy) of displaced heights at x, y metres and a level below 0.

    A level below 0 is finer than the raster's samples. finer.cells_x, cells_y: finer cells of the raster. ground: its
    pyramid, whose level 0 counts where no heights are finer. Points outside the raster are clamped to its border.
    """
    last_x = wp.float64(ground.columns[0] - 1)
    last_y = wp.float64(ground.rows[0] - 1)
    cell_x = wp.clamp((x - ground.west) * ground.per_x, wp.float64(0.0), last_x)
    cell_y = wp.clamp((y - ground.south) * ground.per_y, wp.float64(0.0), last_y)
    finer_per_cell = wp.float64(wp.int32(1) << finer.bits)
    finer_x = cell_x * finer_per_cell
    finer_y = cell_y * finer_per_cell
    column = wp.min(wp.int32(finer_x), finer.cells_x - 1) >> TILE_BITS
    row = wp.min(wp.int32(finer_y), finer.cells_y - 1) >> TILE_BITS
    # Level -bits is level 0 of the tile's pyramid; its level `bits` is the raster itself.
    pyramid_level = wp.float32(finer.bits)
    if item_at(finer.numbers, row * finer.columns + column) >= 0:  # a tile with finer heights
        pyramid_level = wp.max(pyramid_level + level, wp.float32(0.0))
    lower_level = wp.int32(pyramid_level)
    fraction = wp.float64(pyramid_level) - wp.float64(lower_level)
    q = Jet()
    for k in range(wp.where(fraction > wp.float64(0.0), 2, 1)):
        jet = Jet()
        if lower_level + k < finer.bits:  # a level of the tile's pyramid
            jet = tile_jet(finer, column, row, lower_level + k, finer_x, finer_y)
        else:
            jet = level_jet(ground, 0, cell_x, cell_y)
        q += jet * wp.where(k == 0, wp.float64(1.0) - fraction, fraction)
    q *= ground.height_scale
    q[0] = q[0] + ground.height_offset
    return q
