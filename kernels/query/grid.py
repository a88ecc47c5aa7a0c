# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights of the surface on a grid of rows and columns, whose positions are given in cells of the raster."""

import warp as wp

from .surface import QueriedSurface, height_and_slopes, is_ground


@wp.kernel
def grid_heights(
    offset: int,
    surface: QueriedSurface,
    columns: wp.array(dtype=wp.int32),
    across: wp.array(dtype=wp.float64),
    rows: wp.array(dtype=wp.int32),
    up: wp.array(dtype=wp.float64),
    heights: wp.array(dtype=wp.float64),
    inside: wp.array(dtype=wp.bool),
):
    """Write `heights` of row `offset + tid` of a grid, and to `inside` whether there is ground. Holes have heights.

    columns, rows: cell of the raster that contains each column and row of the grid. across, up: position in that cell,
    0 .. 1. So the height at a sample of the raster or of a finer tile has the bits of that sample.
    """
    n = offset + wp.tid()
    j = rows[n]
    t = up[n]
    zero = wp.float64(0.0)
    count = columns.shape[0]
    for k in range(count):
        i = columns[k]
        s = across[k]
        g = height_and_slopes(surface, i, j, s, t)
        index = wp.int64(n) * wp.int64(count) + wp.int64(k)
        heights[index] = g[0] * surface.scale + surface.offset
        inside[index] = is_ground(surface, i, j, s == zero, t == zero)
