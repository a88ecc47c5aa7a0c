# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors that refine the borders of holes down to the raster's cells: see cbt_terrain/field/holes.py.

A diamond is the pair of triangles that share a longest edge. `kinds` are bits of the cells below a diamond: GROUND,
HOLE or both, in the order of `cbt_terrain/field/lattice.py`, and 0 where there is no entry or no raster.
"""

import warp as wp

from ..unchecked import item_at, put
from .layout import Depth, child, diamond, entry, holds

GROUND = wp.constant(wp.uint8(1))
HOLE = wp.constant(wp.uint8(2))


@wp.func
def is_whole(valid: wp.array(dtype=wp.uint8), columns: wp.int32, i: wp.int32, j: wp.int32) -> wp.bool:
    """Return whether all four samples of cell (i, j) are valid. columns: samples in a row."""
    index = wp.int64(j) * wp.int64(columns) + wp.int64(i)
    above = index + wp.int64(columns)
    one = wp.int64(1)
    south = wp.min(item_at(valid, index), item_at(valid, index + one))
    return wp.min(south, wp.min(item_at(valid, above), item_at(valid, above + one))) > wp.uint8(0)


@wp.kernel
def cell_kinds(offset: int, valid: wp.array(dtype=wp.uint8), width: int, cells: Depth, kinds: wp.array(dtype=wp.uint8)):
    """Write to `kinds` whether each cell of row `offset + tid` is GROUND, or a HOLE because a sample is invalid.

    valid: 0 for invalid samples. width: samples in a row. cells: layout of `kinds` by cells.
    """
    cy = offset + wp.tid()
    for cx in range(width - 1):
        put(kinds, entry(cells, cx, cy), wp.where(is_whole(valid, width, cx, cy), GROUND, HOLE))


@wp.kernel
def raise_borders(
    offset: wp.int64,
    longest: wp.float32,
    finer: Depth,
    coarser: Depth,
    kinds: wp.array(dtype=wp.uint8),
    errors: wp.array(dtype=wp.float32),
):
    """Write which kinds of cells are below diamond `offset + tid`; raise its error if there are both.

    The error becomes at least `longest`, the metres of the depth's longest edge, so that borders of holes are refined
    down to cells. coarser: layout of the diamonds' depth. finer: that of the next depth.
    """
    p = diamond(coarser, offset + wp.int64(wp.tid()))
    if holds(coarser, p):
        kind = wp.uint8(0)
        for k in range(4):
            c = child(coarser, p, k)
            if holds(finer, c):
                kind = kind | item_at(kinds, entry(finer, c[0], c[1]))
        index = entry(coarser, p[0], p[1])
        put(kinds, index, kind)
        if kind == GROUND | HOLE:
            put(errors, index, wp.max(item_at(errors, index), longest))
