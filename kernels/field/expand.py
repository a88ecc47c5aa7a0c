# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels that raise the codes of an error hierarchy, for leaves that are drawn finer.

An error is stored as a code, one byte: an entry of a table of 256 errors, of which each group of depths has one. A code
is translated from one group's table to another's by a table of 256 codes.
"""

import warp as wp

from ..unchecked import item_at, put
from .layout import Depth, child, diamond, entry, holds


@wp.kernel
def raise_codes(
    offset: wp.int64,
    finer: Depth,
    coarser: Depth,
    translated: wp.array(dtype=wp.uint8),
    codes: wp.array(dtype=wp.uint8),
):
    """Set the error code of diamond `offset + tid` of depth `coarser` to the largest code of its children, translated.

    finer, coarser: layouts of the depths of the children and of the diamond. translated: for each code the code of the
    same error or more in the table of the coarser depth.
    """
    p = diamond(coarser, offset + wp.int64(wp.tid()))
    if holds(coarser, p):
        largest = wp.uint8(0)
        for k in range(4):
            c = child(coarser, p, k)
            if holds(finer, c):
                largest = wp.max(largest, item_at(codes, entry(finer, c[0], c[1])))
        put(codes, entry(coarser, p[0], p[1]), item_at(translated, wp.int32(largest)))


@wp.kernel
def raise_cells(
    offset: wp.int64,
    band_start: wp.int64,
    old_cells: Depth,
    old: wp.array(dtype=wp.uint8),
    cells: Depth,
    translated: wp.array(dtype=wp.uint8),
    codes: wp.array(dtype=wp.uint8),
):
    """Set the error codes of cells to the largest old code of themselves and their four neighbours, translated.

    A cell's code also stands for the diamonds on its sides, one bisection deeper, and each of them is half in a
    neighbour. Therefore the neighbours' codes count. The thread works on cell `band_start + offset + tid`. band_start:
    first cell of the band of rows that is raised, counted row by row from the south. old_cells, cells: layouts of the
    arrays `old` and `codes`. translated: for each old code the code of a quarter of its error in the new table (of a
    half on a bicubic surface), rounded up.
    """
    p = diamond(cells, band_start + offset + wp.int64(wp.tid()))
    largest = item_at(old, entry(old_cells, p[0], p[1]))
    for k in range(4):
        step = 2 * (k & 1) - 1
        q = wp.vec2i(p[0] + wp.where(k < 2, step, 0), p[1] + wp.where(k < 2, 0, step))
        if holds(cells, q):
            largest = wp.max(largest, item_at(old, entry(old_cells, q[0], q[1])))
    put(codes, entry(cells, p[0], p[1]), item_at(translated, wp.int32(largest)))
