# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that change a whole error hierarchy: for leaves that are drawn finer than they are, and for a surface that is
off the one that was measured."""

import warp as wp

from .hierarchy import largest_below, round_up
from .layout import Depth, diamond, entry, holds


@wp.kernel
def raise_errors(offset: int, finer: Depth, own: Depth, errors: wp.array(dtype=wp.float32)):
    """Diamonds take the largest error of their children: one bisection more."""
    p = diamond(own, offset + wp.tid())
    if holds(own, p):
        errors[entry(own, p[0], p[1])] = largest_below(errors, finer, own, p)


@wp.func
def largest_about(values: wp.array(dtype=wp.float32), cells: Depth, p: wp.vec2i) -> wp.float32:
    """Largest value of a cell and of the four that share a side with it."""
    largest = values[entry(cells, p[0], p[1])]
    for k in range(4):
        step = 2 * (k & 1) - 1
        q = wp.vec2i(p[0] + wp.where(k < 2, step, 0), p[1] + wp.where(k < 2, 0, step))
        if holds(cells, q):
            largest = wp.max(largest, values[entry(cells, q[0], q[1])])
    return largest


@wp.kernel
def raise_cells(
    offset: int,
    before: Depth,
    old: wp.array(dtype=wp.float32),
    own: Depth,
    part: wp.float32,
    errors: wp.array(dtype=wp.float32),
):
    """Cells of the raster take `part` of the largest of themselves and the four beside them: what is below them."""
    p = diamond(own, offset + wp.tid())
    errors[entry(own, p[0], p[1])] = largest_about(old, before, p) * part


@wp.kernel
def cover_sides(offset: int, below: Depth, own: Depth, errors: wp.array(dtype=wp.float32)):
    """A cell's own error is not below that of the four diamonds on its sides: half the larger bend (at `below`)."""
    p = diamond(own, offset + wp.tid())
    at = entry(own, p[0], p[1])
    errors[at] = wp.max(errors[at], largest_about(errors, below, p) * wp.float32(0.5))


@wp.kernel
def add_errors(
    offset: int,
    finer: Depth,
    own: Depth,
    plain: wp.array(dtype=wp.float32),
    off: wp.array(dtype=wp.float32),
    errors: wp.array(dtype=wp.float32),
):
    """`off` is the largest of the children, the error `plain` and `off`, and not below the children's."""
    p = diamond(own, offset + wp.tid())
    if holds(own, p):
        at = entry(own, p[0], p[1])
        off[at] = largest_below(off, finer, own, p)
        raised = round_up(wp.float64(plain[at]) + wp.float64(off[at]))
        errors[at] = wp.max(raised, largest_below(errors, finer, own, p))
