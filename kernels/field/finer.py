# SPDX-License-Identifier: GPL-3.0-or-later
"""Finer tiles: squares of a raster whose heights, at a fraction of its step, replace the raster's surface there.

`cbt_terrain/field/finer_tiles.py` makes them. The *change* is the surface of the tiles less the bilinear one of the
raster, 0 outside of tiles. It counts as a displacement: its errors and slopes are added to those of the raster.

A diamond is the pair of triangles that share a longest edge; its *vertex* is the middle of that edge. Vertices are
stored in *groups* of four depths: group g has the finer samples at multiples of 4^g but not of 4^(g+1). Tiles have SIDE
x SIDE finer cells. `finer.heights` has them one above the other, STRIDE rows each, with a row and a column more before
the first of a tile.

The errors of a tile are ERRORS codes, entries of `finer.table`: of diamonds first, of its finer cells from CELLS on.
"""

import warp as wp

from ..unchecked import item_at
from .cells import in_cell
from .codes import Samples, corners_of, sample_at, sample_index
from .layout import tile_index

TILE_BITS = wp.constant(8)  # a tile has 2^8 finer cells a side
SIDE = wp.constant(256)
STRIDE = wp.constant(259)  # samples in a row: also one before the tile's first, and one after its last
# Errors are stored of diamonds of cells of 2^6 finer cells and smaller: of three groups of depths, and of finer cells.
STORED_BITS = wp.constant(6)
ERRORS = wp.constant(136192)  # codes of a tile
CELLS = wp.constant(70656)  # ... the first of its finer cells
RANGES = wp.constant(18432)  # height ranges of a tile, of every other sample and three groups, too


@wp.struct
class PackedTiles:
    """The finer tiles of a raster, which share its memory."""

    bits: wp.int32  # a raster cell has 2^bits finer cells a side
    columns: wp.int32  # of the table of tiles; one column and row are beyond the raster's border
    rows: wp.int32
    tiles: wp.array(dtype=wp.int32)  # ... number of each tile, -1 where there is none
    heights: Samples  # of all tiles, one above the other: STRIDE rows of STRIDE samples each
    errors: wp.array(dtype=wp.uint8)  # ERRORS codes a tile, of the change
    table: wp.array(dtype=wp.float32)  # metres of the codes
    # CELLS codes a tile, of the errors of a bicubic surface itself, without the raster's; the last one is infinity.
    bounds: wp.array(dtype=wp.uint8)
    bounds_table: wp.array(dtype=wp.float32)
    ranges: wp.array(dtype=wp.uint16)  # two codes of each of the RANGES of a tile; a height is base + code * step
    range_base: wp.float64
    range_step: wp.float64
    off: wp.float64  # metres from the surface to the bilinear one between heights, at most; 0 without a bicubic surface
    # Largest magnitude of the change, metres, and its largest slope along an axis, of each place of the table, of 2 x 2
    # places, and so on.
    limits: wp.array(dtype=wp.vec2f)
    top: wp.int32  # ... last level, where one block has all places


@wp.func
def tile_at(finer: PackedTiles, i: wp.int32, j: wp.int32) -> wp.int32:
    """Return the number of the tile that holds finer cell (i, j); -1 for none."""
    x = i >> TILE_BITS
    y = j >> TILE_BITS
    tile = wp.int32(-1)
    if x >= 0 and y >= 0 and x < finer.columns and y < finer.rows:
        tile = item_at(finer.tiles, wp.int64(y) * wp.int64(finer.columns) + wp.int64(x))
    return tile


@wp.func
def finer_corners(finer: PackedTiles, tile: wp.int32, i: wp.int32, j: wp.int32) -> wp.vec4d:
    """Return the heights at the corners of finer cell (i, j): south-west, south-east, north-west, north-east."""
    return corners_of(finer.heights, 1 + (i & (SIDE - 1)), tile * STRIDE + 1 + (j & (SIDE - 1)))


@wp.func
def finer_at(finer: PackedTiles, tile: wp.int32, i: wp.int32, j: wp.int32, s: wp.float64, t: wp.float64) -> wp.vec3d:
    """Return the height (metres) and its slopes (metres a raster cell) in finer cell (i, j) of a tile, before scaling.

    s, t: position in the finer cell, 0 .. 1. Slopes are interpolated between samples.
    """
    height_and_slopes = in_cell(finer.heights, 1 + (i & (SIDE - 1)), tile * STRIDE + 1 + (j & (SIDE - 1)), s, t)
    finer_per_cell = wp.float64(wp.int32(1) << finer.bits)
    return wp.vec3d(height_and_slopes[0], height_and_slopes[1] * finer_per_cell, height_and_slopes[2] * finer_per_cell)


@wp.func
def stored_change(finer: PackedTiles, i: wp.int32, j: wp.int32, group: wp.int32) -> wp.float32:
    """Return the stored error, metres, of the change at the diamond with its vertex at finer sample (i, j).

    It is 0 without a tile. group: that of the diamond's depth, 0 for the finest.
    """
    tile = tile_at(finer, i, j)
    error = wp.float32(0.0)
    if tile >= 0:
        code = item_at(finer.errors, wp.int64(tile) * wp.int64(ERRORS) + entry_in_tile(i, j, group))
        error = item_at(finer.table, wp.int32(code))
    return error


@wp.func
def entry_in_tile(i: wp.int32, j: wp.int32, group: wp.int32) -> wp.int64:
    """Return the number of an error in its tile: that of the diamond with its vertex at finer sample (i, j).

    group: that of the diamond's depth, 0 for the finest.
    """
    x = (i & (SIDE - 1)) >> (2 * group)  # vertices of a group are 4^group samples apart
    y = (j & (SIDE - 1)) >> (2 * group)
    # Entries of the groups before: none, 256 x 256, and 64 x 64 more.
    first = wp.where(group == 0, 0, wp.where(group == 1, 65536, 69632))
    # Pages of 32 x 32 entries in a row of the group; the last group has 16 x 16 entries in one page.
    return wp.int64(first) + tile_index(x, y, wp.where(group == 0, 8, wp.where(group == 1, 2, 1)))


@wp.func
def stored_bound(finer: PackedTiles, i: wp.int32, j: wp.int32, group: wp.int32) -> wp.float32:
    """Return the stored error, metres, of a bicubic surface at the diamond with its vertex at finer sample (i, j).

    It is infinite where tiles do not cover the diamond's box. group: that of the diamond's depth, 0 for the finest.
    """
    tile = tile_at(finer, i, j)
    bound = wp.float32(wp.inf)
    if tile >= 0:
        code = item_at(finer.bounds, wp.int64(tile) * wp.int64(CELLS) + entry_in_tile(i, j, group))
        bound = item_at(finer.bounds_table, wp.int32(code))
    return bound


@wp.func
def cell_change(finer: PackedTiles, i: wp.int32, j: wp.int32) -> wp.float32:
    """Return the stored error, metres, of the change in finer cell (i, j); 0 without a tile."""
    tile = tile_at(finer, i, j)
    error = wp.float32(0.0)
    if tile >= 0:
        # 8 pages of 32 x 32 cells in a row
        entry = wp.int64(CELLS) + tile_index(i & (SIDE - 1), j & (SIDE - 1), 8)
        error = item_at(finer.table, wp.int32(item_at(finer.errors, wp.int64(tile) * wp.int64(ERRORS) + entry)))
    return error


@wp.func
def range_in_tile(finer: PackedTiles, i: wp.int32, j: wp.int32, group: wp.int32) -> wp.int64:
    """Return the index in `finer.ranges` of the lower height code of the diamond with its vertex at finer sample i, j.

    The upper code follows. The index is -1 without a tile. group: here 0 for cells of 4 x 4 and 8 x 8 finer cells,
    whose vertices are 2 samples apart, 1 for cells four times as wide, and so on.
    """
    tile = tile_at(finer, i, j)
    index = wp.int64(-1)
    if tile >= 0:
        x = (i & (SIDE - 1)) >> (1 + 2 * group)
        y = (j & (SIDE - 1)) >> (1 + 2 * group)
        # Entries of the groups before: 128 x 128 and 32 x 32.
        first = wp.where(group == 0, 0, wp.where(group == 1, 16384, 17408))
        # Pages of 32 x 32 entries in a row of the group; the last group has 8 x 8 entries in one page.
        entry = wp.int64(first) + tile_index(x, y, wp.where(group == 0, 4, 1))
        index = wp.int64(2) * (wp.int64(tile) * wp.int64(RANGES) + entry)
    return index


@wp.func
def covers(finer: PackedTiles, i0: wp.int32, j0: wp.int32, i1: wp.int32, j1: wp.int32) -> wp.bool:
    """Return whether tiles hold all finer samples from (i0, j0) to (i1, j1), which are in 2 x 2 tiles at most."""
    at_ends = tile_at(finer, i0, j0) >= 0 and tile_at(finer, i1, j1) >= 0
    return at_ends and tile_at(finer, i1, j0) >= 0 and tile_at(finer, i0, j1) >= 0


@wp.func
def finer_sample(finer: PackedTiles, i: wp.int32, j: wp.int32) -> wp.float32:
    """Return the height of finer sample (i, j), which a tile holds, metres before scaling."""
    row = tile_at(finer, i, j) * STRIDE + 1 + (j & (SIDE - 1))
    return sample_at(finer.heights, sample_index(finer.heights, 1 + (i & (SIDE - 1)), row))


@wp.func
def limits_over(
    finer: PackedTiles, x0: wp.int32, y0: wp.int32, x1: wp.int32, y1: wp.int32, shift: wp.int32, wide: wp.int32
) -> wp.vec2f:
    """Return the largest magnitude (metres) and slope of the change in a lattice rectangle (x0, y0) .. (x1, y1).

    The slope is along an axis, metres a metre before scaling; both are 0 without tiles. shift: log2 of the lattice
    units of a finer cell. wide: log2 of lattice units that are at least the rectangle's sides. The tiles are looked up
    in blocks at least as wide, so 2 x 2 are read at most; blocks are nested, and so is the result of nested rectangles.
    """
    # The level of `limits` whose blocks are wide enough: level 0 has single tiles, each next one blocks of 2 x 2.
    level = wp.clamp(wide - shift - TILE_BITS, 0, finer.top)
    level_entry = wp.int64(0)
    for k in range(level):
        level_entry += wp.int64(((finer.columns - 1) >> k) + 1) * wp.int64(((finer.rows - 1) >> k) + 1)
    last_column = (finer.columns - 1) >> level
    last_row = (finer.rows - 1) >> level
    shift += TILE_BITS + level  # now of a block
    largest = wp.vec2f()
    for j in range(wp.max(y0 >> shift, 0), wp.min(y1 >> shift, last_row) + 1):
        for i in range(wp.max(x0 >> shift, 0), wp.min(x1 >> shift, last_column) + 1):
            limits = item_at(finer.limits, level_entry + wp.int64(j) * wp.int64(last_column + 1) + wp.int64(i))
            largest = wp.vec2f(wp.max(largest[0], limits[0]), wp.max(largest[1], limits[1]))
    return largest
