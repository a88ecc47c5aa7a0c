# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that move the error hierarchy up by one bisection: errors of leaves that are drawn finer than they are."""

import warp as wp

from .hierarchy import around, side_point

wp.set_module_options({"enable_backward": False})


@wp.kernel
def raise_centres(offset: int, columns: int, finer: wp.array(dtype=wp.float32), errors: wp.array(dtype=wp.float32)):
    """Cell centres take the largest value of their four children."""
    t = offset + wp.tid()
    cy = t / columns
    cx = t - cy * columns
    below = 2 * cy * (columns + 1) + cx
    beside = below + columns + 1
    across = wp.max(finer[below], finer[below + 2 * (columns + 1)])
    errors[t] = wp.max(across, wp.max(finer[beside], finer[beside + 1]))


@wp.kernel
def raise_sides(
    offset: int, columns: int, rows: int, finer: wp.array(dtype=wp.float32), errors: wp.array(dtype=wp.float32)
):
    """Side middles take the largest value of their up to four children."""
    t = offset + wp.tid()
    p = side_point(t, columns / 2 + 1)
    if p[0] <= columns:
        errors[t] = around(finer, p[0], p[1], columns, rows)


@wp.kernel
def raise_cells(
    offset: int, columns: int, rows: int, old: wp.array(dtype=wp.float32), errors: wp.array(dtype=wp.float32)
):
    """Cells of the raster take a quarter of the largest of themselves and their neighbours: two bisections below."""
    t = offset + wp.tid()
    cy = t / columns
    cx = t - cy * columns
    largest = old[t]
    if cx > 0:
        largest = wp.max(largest, old[t - 1])
    if cx < columns - 1:
        largest = wp.max(largest, old[t + 1])
    if cy > 0:
        largest = wp.max(largest, old[t - columns])
    if cy < rows - 1:
        largest = wp.max(largest, old[t + columns])
    errors[t] = largest * wp.float32(0.25)
