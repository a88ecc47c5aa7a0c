# SPDX-License-Identifier: GPL-3.0-or-later
"""The height field, its lattice and its place, as the walk and the displacement read them."""

import warp as wp

from .codes import Samples


@wp.struct
class Domain:
    """Memory is shared with the height field; `cbt_terrain/refine/refinement.py` fills the rest."""

    columns: wp.int32
    rows: wp.int32
    levels: wp.int32  # a root square has 2**levels raster cells a side
    unit_bits: wp.int32  # and 2**unit_bits lattice units
    east: wp.int32  # lattice units at which the raster ends before the lattice does, or the largest int32
    north: wp.int32
    unit_x: wp.float64  # metres of a lattice unit
    unit_y: wp.float64
    west: wp.float64  # metres, x of lattice coordinate 0
    south: wp.float64
    height_scale: wp.float64
    height_offset: wp.float64
    range_base: wp.float64
    range_step: wp.float64
    error_scale: wp.float64  # magnitude of height_scale
    rounding: wp.float64  # metres: what float32 heights may be off
    lean: wp.float64  # ... and what plane coordinates add, metres a metre of the range of heights in a diamond's box
    most_lean: wp.float64  # ... metres, at most
    source: wp.float64  # metres: what the source's own heights may be off
    enough: wp.float64  # metres of own error from which on nothing is gained
    detailed: wp.int32  # 1: a detail is added to the surface, see cbt_terrain/field/detail.py
    detail_most: wp.float64  # metres that it rises or falls, at most
    detail: wp.array(dtype=wp.vec2f)  # ... and for each depth: what a leaf misses of it, and what its edges climb
    masked: wp.int32  # parts of it with a mask; their tables follow, for one of 255 parts of the mask
    mask_most: wp.array(dtype=wp.uint8)  # ... the most of each mask: of cells, of 2 x 2 cells and so on
    mask_first: wp.array(dtype=wp.int64)  # where those of each level begin, and how many there are
    mask_top: wp.int32  # the last level
    detail_rim: wp.int32  # deepest leaves whose triangles may reach over the raster's rim
    bicubic: wp.int32  # 1: the surface is bicubic, and the hierarchy that of kernels/bicubic/patches.py
    is_raised: wp.int32  # 1: stored errors are more than those of the surface on purpose, also inside cells
    base: wp.array(dtype=wp.int64)  # of each group of depths, the cells and the bends: its first entry
    pages: wp.array(dtype=wp.int32)  # ... and pages in a row
    cell_base: wp.int64  # the same of the raster's cells
    cell_pages: wp.int32
    cell_columns: wp.int32  # ... and how many there are
    cell_rows: wp.int32
    cell_group: wp.int32
    bend_group: wp.int32  # of what errors below the cells begin with: of a bilinear surface the cells' own
    table: wp.array(dtype=wp.float32)  # metres: 256 values a group
    error: wp.array(dtype=wp.uint8)
    range_first: wp.array(dtype=wp.int64)  # as `base` and `pages`, of the ranges
    range_pages: wp.array(dtype=wp.int32)
    range_cells: wp.int64  # of a bicubic surface: the first of the raster's cells
    ranges: wp.array(dtype=wp.uint16)
    samples: Samples
