# SPDX-License-Identifier: GPL-3.0-or-later
"""The fit of a raster with finer tiles (field/finer.py): their change is added to the fitted heights of the raster.

A fit moves and measures the raster's surface alone. The distance of a triangle is then the sum of two: that of its
fitted heights from the raster's surface, measured, and the stored error of the change over it.

Of the domain d: a root square has 2^levels cells and 2^unit_bits lattice units a side, and a raster cell has
2^finer[0].bits finer cells a side.
"""

import warp as wp

from ..field.domain import Domain
from ..field.finer import finer_at, tile_at
from ..field.layout import Depth, entry
from ..leb.halfway import middle_between
from ..refine.stored_errors import detail_missed, is_beyond
from ..unchecked import item_at, put
from .facet import surface_height
from .raising import raise_ancestors


@wp.func
def change_at(d: Domain, x: wp.int32, y: wp.int32) -> wp.float64:
    """Return the height of the finer tile above the raster's surface at lattice point (x, y), metres before scaling.

    It is 0 outside tiles. Points beyond the border have the value at the border.
    """
    change = wp.float64(0.0)
    if d.has_finer == 1:
        x = wp.min(x, d.east)
        y = wp.min(y, d.north)
        shift = d.unit_bits - d.levels - d.finer[0].bits
        i = x >> shift
        j = y >> shift
        tile = tile_at(d.finer[0], i, j)
        if tile >= 0:
            per_unit = wp.float64(1.0) / wp.float64(wp.int32(1) << shift)  # exact: a power of two
            s = wp.float64(x - (i << shift)) * per_unit
            t = wp.float64(y - (j << shift)) * per_unit
            change = finer_at(d.finer[0], tile, i, j, s, t)[0] - surface_height(d, x, y)
    return change


@wp.func
def missed_change(d: Domain, left: wp.vec2i, right: wp.vec2i, level: wp.int32) -> wp.float64:
    """Return the stored error of the change over a triangle, metres after vertical scaling.

    left, right: ends of its longest edge, lattice units. level: of the triangle.
    """
    missed = wp.float64(0.0)
    if d.has_finer == 1:
        middle = middle_between(left, right)
        if not is_beyond(d, middle[0], middle[1], level):  # the raster's border
            # The triangle is the leaf, so both depths are its level.
            missed = wp.float64(detail_missed(d, middle[0], middle[1], level, level)) * d.error_scale
    return missed


@wp.func
def in_tile(d: Domain, i: wp.int32, j: wp.int32) -> wp.bool:
    """Return whether a finer tile holds raster cell (i, j)."""
    is_held = wp.bool(False)
    if d.has_finer == 1:
        is_held = tile_at(d.finer[0], i << d.finer[0].bits, j << d.finer[0].bits) >= 0
    return is_held


@wp.kernel
def restore_in_tiles(
    offset: int, d: Domain, cells: Depth, errors: wp.array(dtype=wp.float32), out: wp.array(dtype=wp.float32)
):
    """Raise errors `out` of cells of row `offset + tid` to `errors`, where a finer tile holds the cell.

    A fit rounds the errors that its walk reads to the nearest code. In tiles the walk must split whatever a mesh
    without a fit splits, so there they must not be below the stored ones. errors: stored errors of the cells. out:
    those that the walk reads. Both are metres before scaling. cells: layout of both.
    """
    j = offset + wp.tid()
    for i in range(cells.columns):
        if in_tile(d, i, j):
            k = entry(cells, i, j)
            put(out, k, wp.max(item_at(out, k), item_at(errors, k)))


@wp.kernel
def raise_to_cells(
    d: Domain,
    cells: Depth,
    cell_codes: wp.array(dtype=wp.uint8),
    codes: wp.array(dtype=wp.uint8),
    stack: wp.array(dtype=wp.vec3i),
):
    """Raise the codes of all cells to `cell_codes`, and those of their ancestors, so that errors stay nested.

    One thread. cells: layout of `cell_codes`. codes: of the errors of all diamonds. stack: scratch.
    """
    bits = d.unit_bits - d.levels
    half = 1 << (bits - 1)  # a cell's diamond is split in its middle, at depth 2 * levels + 1
    for j in range(cells.rows):
        for i in range(cells.columns):
            code = wp.int32(item_at(cell_codes, entry(cells, i, j)))
            raise_ancestors(d, (i << bits) + half, (j << bits) + half, 2 * d.levels + 1, code, codes, stack)
