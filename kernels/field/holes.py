# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors that make a refinement follow the borders of holes down to the raster's cells; cbt_terrain/field/holes.py.

`kinds` are bits of what is below a diamond: GROUND, HOLE or both, in the order of `cbt_terrain/field/lattice.py`; none
where there is no entry or no raster.
"""

import warp as wp

from .hierarchy import side_point
from .layout import Depth, entry

wp.set_module_options({"enable_backward": False})

GROUND = wp.constant(wp.uint8(1))
HOLE = wp.constant(wp.uint8(2))


@wp.kernel
def cell_kinds(offset: int, valid: wp.array(dtype=wp.uint8), width: int, cells: Depth, kinds: wp.array(dtype=wp.uint8)):
    """Row `offset + tid` of the raster's cells: those with a sample that is not valid are holes."""
    cy = offset + wp.tid()
    for cx in range(width - 1):
        at = cy * width + cx
        least = wp.min(wp.min(valid[at], valid[at + 1]), wp.min(valid[at + width], valid[at + width + 1]))
        kinds[entry(cells, cx, cy)] = wp.where(least > wp.uint8(0), GROUND, HOLE)


@wp.func
def note(
    kinds: wp.array(dtype=wp.uint8),
    errors: wp.array(dtype=wp.float32),
    at: wp.int64,
    kind: wp.uint8,
    longest: wp.float32,
):
    """The kind of a diamond, and an error of `longest` metres at least if it is both."""
    kinds[at] = kind
    if kind == GROUND | HOLE:
        errors[at] = wp.max(errors[at], longest)


@wp.kernel
def raise_centres(
    offset: int,
    columns: int,
    longest: wp.float32,
    finer: Depth,
    own: Depth,
    kinds: wp.array(dtype=wp.uint8),
    errors: wp.array(dtype=wp.float32),
):
    """Cell centres, from their children: the middles of the cell's sides."""
    t = offset + wp.tid()
    cy = t / columns
    cx = t - cy * columns
    kind = kinds[entry(finer, 2 * cx + 1, 2 * cy)] | kinds[entry(finer, 2 * cx + 1, 2 * cy + 2)]
    kind = kind | kinds[entry(finer, 2 * cx, 2 * cy + 1)] | kinds[entry(finer, 2 * cx + 2, 2 * cy + 1)]
    note(kinds, errors, entry(own, cx, cy), kind, longest)


@wp.kernel
def raise_sides(
    offset: int,
    columns: int,
    rows: int,
    longest: wp.float32,
    finer: Depth,
    own: Depth,
    kinds: wp.array(dtype=wp.uint8),
    errors: wp.array(dtype=wp.float32),
):
    """Side middles, from their up to four children: the centres of the cells around them."""
    t = offset + wp.tid()
    p = side_point(t, columns / 2 + 1)
    if p[0] > columns:
        return
    kind = wp.uint8(0)
    for j in range(wp.max(p[1] - 1, 0), wp.min(p[1] + 1, rows)):
        for i in range(wp.max(p[0] - 1, 0), wp.min(p[0] + 1, columns)):
            kind = kind | kinds[entry(finer, i, j)]
    note(kinds, errors, entry(own, p[0], p[1]), kind, longest)
