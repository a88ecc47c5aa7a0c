# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the ranges of heights: two uint16 that enclose every diamond of cells of 4 x 4 samples and more.

A diamond is the pair of triangles that share a longest edge; its *box* contains them and all diamonds below.

A height, in metres before vertical scaling, is `base + q * step`; the lower number is rounded down and the upper one
up, so the range encloses. `ranges` are flat: lower and upper of a diamond are adjacent, diamonds in the order of
`cbt_terrain/field/lattice.py`.

REACH: half of the side of the box of a finest diamond, in samples.
"""

import warp as wp

from ..unchecked import item_at, put
from .codes import Samples
from .layout import Depth, child, diamond, entry, holds

# Samples from the middle of a side of 4 x 4 cells to the border of its diamond's box; a snippet of C depends on it.
REACH = wp.constant(4)


@wp.func
def quantise_down(z: wp.float64, base: wp.float64, step: wp.float64, per_step: wp.float64):
    """Return the largest code q in 0 .. 65535 with base + q step <= z, or, by rounding, the one below it.

    z is not below base. per_step: 1 / step.
    """
    q = wp.clamp(wp.int32((z - base) * per_step), 0, 65535)
    # The loop is rarely needed. The test before it keeps the compiler from running several of its steps at once.
    if q > 0 and base + wp.float64(q) * step > z:
        while q > 0 and base + wp.float64(q) * step > z:
            q = q - 1
    return wp.uint16(q)


@wp.func
def quantise_up(z: wp.float64, base: wp.float64, step: wp.float64, per_step: wp.float64):
    """Return the smallest code q in 0 .. 65535 with base + q step >= z, or, by rounding, the one above it.

    z is not above base + 65535 step. per_step: 1 / step.
    """
    q = wp.clamp(wp.int32((z - base) * per_step), 0, 65535)
    q = wp.min(q + wp.where(base + wp.float64(q) * step < z, 1, 0), 65535)
    if q < 65535 and base + wp.float64(q) * step < z:  # rarely, as in `quantise_down`
        while q < 65535 and base + wp.float64(q) * step < z:
            q = q + 1
    return wp.uint16(q)


@wp.func_native("""
    typedef float lanes __attribute__((vector_size(16)));
    const float* rows = raster.floats.data + (long long)south * raster.columns;
    lanes lows = lanes{} + __builtin_inff(), highs = -lows;
    for (int j = south; j <= north; ++j, rows += raster.columns) {
        lanes z;
        if (west >= 0 && west + 4 <= raster.columns)
            __builtin_memcpy(&z, rows + west, sizeof(z));
        else
            for (int i = 0; i < 4; ++i)
                z[i] = rows[wp::max(0, wp::min(west + i, raster.columns - 1))];
        lows = z < lows ? z : lows;
        highs = z > highs ? z : highs;
    }
    return wp::vec4f(lows[0], highs[0], wp::min(wp::min(lows[0], lows[1]), wp::min(lows[2], lows[3])),
                     wp::max(wp::max(highs[0], highs[1]), wp::max(highs[2], highs[3])));
""")
def limits_of_columns(raster: Samples, west: int, south: int, north: int) -> wp.vec4f:
    """Return the lowest and the highest sample of column `west`, and those of REACH columns from there on.

    south, north: first and last row. A column beyond the border has the samples of the border.
    """
    ...


@wp.kernel
def finest_ranges(
    offset: int,
    raster: Samples,
    west: int,
    south: int,
    base: wp.float64,
    step: wp.float64,
    finest: Depth,
    ranges: wp.array(dtype=wp.uint16),
):
    """Compute ranges in row `2 * (offset + tid)` of samples: of diamonds around the middles of sides of 4 x 4 cells.

    A range covers all samples in the diamond's box, or the nearest to a box beyond the raster. The box contains the
    diamond's descendants, of which some extend into the next cells. Code q stands for base + q step metres. west,
    south: columns and rows of `raster` before the first vertex. finest: layout of `ranges`.
    """
    y = offset + wp.tid()
    per_step = wp.float64(1.0) / step
    first_row = wp.clamp(south + 2 * y - REACH, 0, raster.rows - 1)
    last_row = wp.clamp(south + 2 * y + REACH, 0, raster.rows - 1)
    # A box has 2 REACH + 1 columns: two strips of REACH, and the first column of a third. The next box, REACH columns
    # further on, begins with the second strip. Of a strip [0] and [1] are the lowest and the highest sample of its
    # first column, [2] and [3] those of all.
    strip1 = wp.vec4f()
    strip2 = wp.vec4f()
    first_x = 1 - (y & 1)  # diamonds are where x + y is odd
    for x in range(first_x - REACH, finest.columns + 1, 2):  # x counts every other sample
        strip3 = limits_of_columns(raster, west + 2 * x + REACH, first_row, last_row)
        if x >= first_x:  # the two rounds before only fill strips
            low = wp.min(wp.min(strip1[2], strip2[2]), strip3[0])
            high = wp.max(wp.max(strip1[3], strip2[3]), strip3[1])
            lower_index = wp.int64(2) * entry(finest, x, y)
            put(ranges, lower_index, quantise_down(wp.float64(low), base, step, per_step))
            put(ranges, lower_index + wp.int64(1), quantise_up(wp.float64(high), base, step, per_step))
        strip1 = strip2
        strip2 = strip3


@wp.func
def unite(a: wp.vec2us, ranges: wp.array(dtype=wp.uint16), index: wp.int64):
    """Return the union of range a (lower and upper code) and that of the diamond at an index of `ranges`."""
    lower_index = wp.int64(2) * index
    return wp.vec2us(
        wp.min(a[0], item_at(ranges, lower_index)), wp.max(a[1], item_at(ranges, lower_index + wp.int64(1)))
    )


@wp.kernel
def patches_around(
    offset: int, columns: int, rows: int, cells: Depth, finest: Depth, ranges: wp.array(dtype=wp.uint16)
):
    """Compute the ranges of the finest diamonds in row `offset + tid` from the cells within REACH of each.

    It is for bicubic surfaces, whose cells have ranges. A row is two samples apart from the next; diamonds are where x
    + y is odd. columns, rows: cells of the raster. cells, finest: layouts of both in `ranges`.
    """
    y = offset + wp.tid()
    for x in range(1 - (y & 1), finest.columns + 1, 2):
        r = wp.vec2us(wp.uint16(65535), wp.uint16(0))
        for cy in range(wp.max(2 * y - REACH, 0), wp.min(2 * y + REACH, rows)):
            for cx in range(wp.max(2 * x - REACH, 0), wp.min(2 * x + REACH, columns)):
                r = unite(r, ranges, entry(cells, cx, cy))
        lower_index = wp.int64(2) * entry(finest, x, y)
        put(ranges, lower_index, r[0])
        put(ranges, lower_index + wp.int64(1), r[1])


@wp.kernel
def unite_children(offset: wp.int64, finer: Depth, coarser: Depth, ranges: wp.array(dtype=wp.uint16)):
    """Write the range of diamond `offset + tid` to `ranges`: the union of those of its up to four children.

    Without children it is empty, (65535, 0). finer, coarser: layouts of the depths of the children and of the diamond.
    """
    p = diamond(coarser, offset + wp.int64(wp.tid()))
    if holds(coarser, p):
        r = wp.vec2us(wp.uint16(65535), wp.uint16(0))
        for k in range(4):
            c = child(coarser, p, k)
            if holds(finer, c):
                r = unite(r, ranges, entry(finer, c[0], c[1]))
        lower_index = wp.int64(2) * entry(coarser, p[0], p[1])
        put(ranges, lower_index, r[0])
        put(ranges, lower_index + wp.int64(1), r[1])
