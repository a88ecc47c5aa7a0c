# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the ranges of heights: for every diamond above the raster's cells, two uint16 that enclose its surface.

A height is `base + q * step`; the lower number is rounded down and the upper one up, so the range encloses. `ranges`
are flat: lower and upper of one diamond lie side by side, diamonds in the order of `cbt_terrain/field/lattice.py`.
"""

import warp as wp

from .hierarchy import side_point
from .layout import Depth, entry

wp.set_module_options({"enable_backward": False})


@wp.func
def quantise_down(z: wp.float64, base: wp.float64, step: wp.float64, per_step: wp.float64):
    """Largest q in 0 .. 65535 with base + q * step <= z; z is not below base."""
    q = wp.clamp(wp.int32((z - base) * per_step), 0, 65535)
    while q > 0 and base + wp.float64(q) * step > z:
        q = q - 1
    return wp.uint16(q)


@wp.func
def quantise_up(z: wp.float64, base: wp.float64, step: wp.float64, per_step: wp.float64):
    """A small q in 0 .. 65535 with base + q * step >= z; z is not above base + 65535 * step."""
    q = wp.clamp(wp.int32((z - base) * per_step), 0, 65535)
    while q < 65535 and base + wp.float64(q) * step < z:
        q = q + 1
    return wp.uint16(q)


@wp.func
def column_range(h: wp.array(dtype=wp.float32), x: int, width: int, y: int, height: int):
    """Lowest and highest sample of column x in the rows within two of y, or the nearest to it."""
    z = h[wp.min(y, height - 1) * width + x]
    low = z
    high = z
    for k in range(1, 3):
        south = h[wp.clamp(y - k, 0, height - 1) * width + x]
        north = h[wp.min(y + k, height - 1) * width + x]
        low = wp.min(low, wp.min(south, north))
        high = wp.max(high, wp.max(south, north))
    return wp.vec2(low, high)


@wp.kernel
def finest_ranges(
    offset: int,
    h: wp.array(dtype=wp.float32),
    width: int,
    height: int,
    columns: int,
    base: wp.float64,
    step: wp.float64,
    own: Depth,
    ranges: wp.array(dtype=wp.uint16),
):
    """Row `offset + tid` of vertices 0 .. `columns`: diamonds about those with x + y odd, from all samples within two.

    That is one cell more than the cells that meet there, so that it also encloses the diamonds below the raster, which
    reach over into the next cell.
    """
    y = offset + wp.tid()
    per_step = wp.float64(1.0) / step
    # A window of five columns moves along the row; beyond an end of the raster the last column counts again.
    a = column_range(h, 0, width, y, height)
    b = a
    c = a
    d = a
    e = column_range(h, 1, width, y, height)
    for x in range(columns + 1):
        a = b
        b = c
        c = d
        d = e
        if x + 2 < width:
            e = column_range(h, x + 2, width, y, height)
        if ((x + y) & 1) == 1:
            low = wp.min(wp.min(wp.min(a[0], b[0]), wp.min(c[0], d[0])), e[0])
            high = wp.max(wp.max(wp.max(a[1], b[1]), wp.max(c[1], d[1])), e[1])
            at = wp.int64(2) * entry(own, x, y)
            ranges[at] = quantise_down(wp.float64(low), base, step, per_step)
            ranges[at + wp.int64(1)] = quantise_up(wp.float64(high), base, step, per_step)


@wp.func
def unite(a: wp.vec2us, ranges: wp.array(dtype=wp.uint16), index: wp.int64):
    """The range `a` widened to that of the diamond at an entry."""
    at = wp.int64(2) * index
    return wp.vec2us(wp.min(a[0], ranges[at]), wp.max(a[1], ranges[at + wp.int64(1)]))


@wp.kernel
def patches_around(
    offset: int, last: int, columns: int, rows: int, cells: Depth, own: Depth, ranges: wp.array(dtype=wp.uint16)
):
    """Row `offset + tid` of vertices 0 .. `last`: diamonds about those with x + y odd, from all cells within two."""
    y = offset + wp.tid()
    for x in range(1 - (y & 1), last + 1, 2):
        r = wp.vec2us(wp.uint16(65535), wp.uint16(0))
        for cy in range(wp.max(y - 2, 0), wp.min(y + 2, rows)):
            for cx in range(wp.max(x - 2, 0), wp.min(x + 2, columns)):
                r = unite(r, ranges, entry(cells, cx, cy))
        at = wp.int64(2) * entry(own, x, y)
        ranges[at] = r[0]
        ranges[at + wp.int64(1)] = r[1]


@wp.kernel
def centre_ranges(
    offset: int, columns: int, east: int, north: int, finer: Depth, own: Depth, ranges: wp.array(dtype=wp.uint16)
):
    """Cell centres: the union of their four children, the middles of the cell's sides, up to (`east`, `north`)."""
    t = offset + wp.tid()
    cy = t / columns
    cx = t - cy * columns
    r = wp.vec2us(wp.uint16(65535), wp.uint16(0))
    for k in range(4):
        x = 2 * cx + 1
        y = 2 * cy + 1
        if k < 2:
            x += 2 * k - 1
        else:
            y += 2 * k - 5
        if x <= east and y <= north:
            r = unite(r, ranges, entry(finer, x, y))
    at = wp.int64(2) * entry(own, cx, cy)
    ranges[at] = r[0]
    ranges[at + wp.int64(1)] = r[1]


@wp.kernel
def side_ranges(offset: int, columns: int, rows: int, finer: Depth, own: Depth, ranges: wp.array(dtype=wp.uint16)):
    """Side middles: the union of their up to four children, the centres of the `columns` x `rows` cells around them."""
    t = offset + wp.tid()
    p = side_point(t, columns / 2 + 1)
    if p[0] > columns:
        return
    r = wp.vec2us(wp.uint16(65535), wp.uint16(0))
    for j in range(2):
        for i in range(2):
            cx = p[0] - i
            cy = p[1] - j
            if cx >= 0 and cx < columns and cy >= 0 and cy < rows:
                r = unite(r, ranges, entry(finer, cx, cy))
    at = wp.int64(2) * entry(own, p[0], p[1])
    ranges[at] = r[0]
    ranges[at + wp.int64(1)] = r[1]
