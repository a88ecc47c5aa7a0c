# SPDX-License-Identifier: GPL-3.0-or-later
"""The height field, its lattice and its placement as the walk and the displacement read them."""

import warp as wp

from .codes import Samples
from .finer import PackedTiles

# Options of modules whose kernels judge diamonds or read heights at points. Warp passes structs by value, and LLVM
# undoes that only where it inlines. With Warp's threshold of 9000 the walk, a count, geomorphing and queries of heights
# take 1.4 to 4 times as long.
INLINED = {"cpu_compiler_flags": "-march=native -mllvm=-inline-threshold=60000"}


@wp.struct
class Domain:
    """A placed height field, whose arrays share its memory; filled in by `cbt_terrain/field/domain.py`.

    `cbt_terrain/refine/request.py` adds the rounding of positions.
    """

    columns: wp.int32  # root squares in a row of the lattice
    rows: wp.int32
    levels: wp.int32  # a root square has 2**levels raster cells a side
    unit_bits: wp.int32  # and 2**unit_bits lattice units
    east: wp.int32  # lattice units at which the raster ends before the lattice does, or the largest int32
    north: wp.int32
    unit_x: wp.float64  # metres of a lattice unit
    unit_y: wp.float64
    west: wp.float64  # metres, x of lattice coordinate 0
    south: wp.float64
    height_scale: wp.float64  # a height of z metres before scaling is z * height_scale + height_offset
    height_offset: wp.float64
    range_base: wp.float64  # code q of `ranges` is the height range_base + q * range_step, metres before scaling
    range_step: wp.float64
    error_scale: wp.float64  # magnitude of height_scale
    rounding: wp.float64  # metres: largest rounding error of float32 heights
    lean: wp.float64  # ... further error by plane coordinates, metres a metre of the range of a diamond's box
    max_lean: wp.float64  # ... largest such error, metres
    near_x: wp.float64  # ... fraction of it, 1 at most, a metre between a box and the anchor along x; both 0: all of it
    near_y: wp.float64
    source: wp.float64  # metres: largest rounding error of the source's heights
    enough: wp.float64  # metres: errors below this are not refined further
    detailed: wp.int32  # 1: the surface has displacement layers, see cbt_terrain/field/detail.py, or finer tiles
    max_detail: wp.float64  # metres: their largest magnitude
    has_finer: wp.int32  # 1: some squares have finer tiles
    finer: wp.array(dtype=PackedTiles)  # ... [1]
    max_change: wp.float64  # metres: largest magnitude of all layers and of the finer tiles' change
    detail: wp.array(dtype=wp.vec2f)  # ... for each depth: largest distance from a leaf, largest climb of its edges
    masked: wp.int32  # number of layers with a mask; their tables follow, for 1 of 255
    mask_max: wp.array(dtype=wp.uint8)  # ... maximum of each mask: of cells, of 2 x 2 cells and so on
    mask_first: wp.array(dtype=wp.int64)  # ... first entry of each level, and the number of entries
    mask_top: wp.int32  # ... last level
    border_depth: wp.int32  # depth of the deepest leaves with triangles across the raster's border
    bicubic: wp.int32  # 1: the surface is bicubic, and the hierarchy that of kernels/bicubic/patches.py
    is_raised: wp.int32  # 1: stored errors are deliberately larger than the surface's, also inside cells
    base: wp.array(dtype=wp.int64)  # first entry of each group of depths, of the cells and of the curvatures
    pages: wp.array(dtype=wp.int32)  # ... pages in a row
    cell_base: wp.int64  # first entry of the raster's cells in the errors
    cell_pages: wp.int32
    cell_columns: wp.int32  # ... number of cells
    cell_rows: wp.int32
    cell_group: wp.int32
    curvature_group: wp.int32  # group of the errors that halve below the cells: for a bilinear surface the cells'
    table: wp.array(dtype=wp.float32)  # metres: 256 values a group
    error: wp.array(dtype=wp.uint8)
    error_places: wp.array(dtype=wp.int32)  # ... `places` of their pages, see `stored_entry`
    range_first: wp.array(dtype=wp.int64)  # `base` and `pages` of the ranges
    range_pages: wp.array(dtype=wp.int32)
    range_cells: wp.int64  # first entry of the raster's cells, for a bicubic surface
    ranges: wp.array(dtype=wp.uint16)
    range_places: wp.array(dtype=wp.int32)
    samples: Samples
