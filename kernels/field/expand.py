# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that move the error hierarchy up by one bisection: errors of leaves that are drawn finer than they are."""

import warp as wp

from .hierarchy import around, beside, round_up, side_point
from .layout import Depth, entry

wp.set_module_options({"enable_backward": False})


@wp.kernel
def raise_centres(offset: int, columns: int, finer: Depth, own: Depth, errors: wp.array(dtype=wp.float32)):
    """Cell centres take the largest value of their four children."""
    t = offset + wp.tid()
    cy = t / columns
    cx = t - cy * columns
    errors[entry(own, cx, cy)] = beside(errors, finer, cx, cy)


@wp.kernel
def raise_sides(offset: int, columns: int, rows: int, finer: Depth, own: Depth, errors: wp.array(dtype=wp.float32)):
    """Side middles take the largest value of their up to four children."""
    t = offset + wp.tid()
    p = side_point(t, columns / 2 + 1)
    if p[0] <= columns:
        errors[entry(own, p[0], p[1])] = around(errors, finer, p[0], p[1], columns, rows)


@wp.kernel
def raise_cells(
    offset: int,
    columns: int,
    rows: int,
    before: Depth,
    old: wp.array(dtype=wp.float32),
    own: Depth,
    part: wp.float32,
    errors: wp.array(dtype=wp.float32),
):
    """Cells of the raster take `part` of the largest of themselves and the four beside them: what is below them."""
    t = offset + wp.tid()
    cy = t / columns
    cx = t - cy * columns
    largest = old[entry(before, cx, cy)]
    if cx > 0:
        largest = wp.max(largest, old[entry(before, cx - 1, cy)])
    if cx < columns - 1:
        largest = wp.max(largest, old[entry(before, cx + 1, cy)])
    if cy > 0:
        largest = wp.max(largest, old[entry(before, cx, cy - 1)])
    if cy < rows - 1:
        largest = wp.max(largest, old[entry(before, cx, cy + 1)])
    errors[entry(own, cx, cy)] = largest * part


@wp.kernel
def add_centres(
    offset: int,
    columns: int,
    finer: Depth,
    own: Depth,
    plain: wp.array(dtype=wp.float32),
    off: wp.array(dtype=wp.float32),
    errors: wp.array(dtype=wp.float32),
):
    """Cell centres: `off` is the largest of the children, the error `plain` and `off`, and not below the children's."""
    t = offset + wp.tid()
    cy = t / columns
    cx = t - cy * columns
    at = entry(own, cx, cy)
    off[at] = beside(off, finer, cx, cy)
    errors[at] = wp.max(round_up(wp.float64(plain[at]) + wp.float64(off[at])), beside(errors, finer, cx, cy))


@wp.kernel
def add_sides(
    offset: int,
    columns: int,
    rows: int,
    finer: Depth,
    own: Depth,
    plain: wp.array(dtype=wp.float32),
    off: wp.array(dtype=wp.float32),
    errors: wp.array(dtype=wp.float32),
):
    """Side middles: the same."""
    t = offset + wp.tid()
    p = side_point(t, columns / 2 + 1)
    if p[0] <= columns:
        at = entry(own, p[0], p[1])
        off[at] = around(off, finer, p[0], p[1], columns, rows)
        below = around(errors, finer, p[0], p[1], columns, rows)
        errors[at] = wp.max(round_up(wp.float64(plain[at]) + wp.float64(off[at])), below)
