# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that change a whole error hierarchy: for leaves that are drawn finer, and for another surface."""

import warp as wp

from .hierarchy import largest_below, round_up
from .layout import Depth, diamond, entry, holds


@wp.kernel
def raise_errors(offset: int, finer: Depth, coarser: Depth, errors: wp.array(dtype=wp.float32)):
    """Raise errors of diamonds of depth `coarser` to those of their children, for leaves drawn one level finer.

    The thread works on diamond `offset + tid`.
    """
    p = diamond(coarser, offset + wp.tid())
    if holds(coarser, p):
        errors[entry(coarser, p[0], p[1])] = largest_below(errors, finer, coarser, p)


@wp.func
def largest_about(values: wp.array(dtype=wp.float32), cells: Depth, p: wp.vec2i) -> wp.float32:
    """Return the largest value of cell p and of the diamonds on its four sides. values: of all depths."""
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
    old_cells: Depth,
    old: wp.array(dtype=wp.float32),
    cells: Depth,
    part: wp.float32,
    errors: wp.array(dtype=wp.float32),
):
    """Set cells to `part` of the largest old value of themselves and their four neighbours: the error below them.

    old_cells: layout of the array `old`. part: factor by which an error falls in the bisections, 1/4 or 1/2.
    """
    p = diamond(cells, offset + wp.tid())
    errors[entry(cells, p[0], p[1])] = largest_about(old, old_cells, p) * part


@wp.kernel
def cover_sides(offset: int, curvatures: Depth, cells: Depth, errors: wp.array(dtype=wp.float32)):
    """Raise the error of cell `offset + tid` to half the largest curvature of itself and its sides.

    So the error also bounds triangles that meet on the cell's sides.
    """
    p = diamond(cells, offset + wp.tid())
    at = entry(cells, p[0], p[1])
    errors[at] = wp.max(errors[at], largest_about(errors, curvatures, p) * wp.float32(0.5))


@wp.kernel
def add_errors(
    offset: int,
    finer: Depth,
    coarser: Depth,
    plain: wp.array(dtype=wp.float32),
    off: wp.array(dtype=wp.float32),
    errors: wp.array(dtype=wp.float32),
):
    """Compute errors of diamonds on another surface: those on the bilinear one plus the distance between both.

    plain: errors on the bilinear surface, metres. off: largest distance of the two surfaces, metres; it becomes the
    largest of the children. An error is the sum, and at least the children's.
    """
    p = diamond(coarser, offset + wp.tid())
    if holds(coarser, p):
        at = entry(coarser, p[0], p[1])
        off[at] = largest_below(off, finer, coarser, p)
        raised = round_up(wp.float64(plain[at]) + wp.float64(off[at]))
        errors[at] = wp.max(raised, largest_below(errors, finer, coarser, p))
