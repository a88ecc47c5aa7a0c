# SPDX-License-Identifier: GPL-3.0-or-later
"""From drainage (routing.py) to catchment areas: lakes filled, flow shared among all lower neighbours."""

import warp as wp

from .logarithm import natural_log
from .routing import ROOT, Grid, axis, towards


@wp.kernel
def fill_lakes(
    grid: Grid,
    to: wp.array(dtype=wp.uint8),
    order: wp.array(dtype=wp.int32),
    h: wp.array(dtype=wp.float32),
    filled: wp.array(dtype=wp.float32),
):
    """Serial. The least surface from which every sample drains: none lies below its receiver."""
    n = grid.width * grid.height
    for q in range(n):
        i = order[n - 1 - q]
        filled[i] = h[i]
        if to[i] != ROOT:
            filled[i] = wp.max(h[i], filled[towards(i, wp.int32(to[i]), grid.width)])


@wp.kernel
def take_in_reverse(
    offset: int,
    count: int,
    order: wp.array(dtype=wp.int32),
    filled: wp.array(dtype=wp.float32),
    key: wp.array(dtype=wp.float32),
    item: wp.array(dtype=wp.int32),
):
    """Receivers before donors, with the heights that they are to be sorted by."""
    q = offset + wp.tid()
    i = order[count - 1 - q]
    item[q] = i
    key[q] = filled[i]


@wp.func
def part(grid: Grid, filled: wp.array(dtype=wp.float32), i: wp.int32, k: wp.int32) -> wp.float64:
    """The weight of what flows from sample i in direction k, 0 for upwards."""
    fall = wp.float64(filled[i]) - wp.float64(filled[towards(i, k, grid.width)])
    return wp.max(fall, wp.float64(0.0)) * grid.share[axis(k)]


@wp.kernel
def gather_area(
    grid: Grid,
    to: wp.array(dtype=wp.uint8),
    rising: wp.array(dtype=wp.int32),
    filled: wp.array(dtype=wp.float32),
    area: wp.array(dtype=wp.float64),
):
    """Serial. From above every sample gives its area to all lower neighbours by their slopes (Quinn et al. 1991); where
    there is none, in lakes and on flats, to its receiver. `area`: each sample's own before, of all that drains through
    it after. `rising`: by the filled surface, receivers before donors where that is level."""
    n = grid.width * grid.height
    for q in range(n):
        i = rising[n - 1 - q]
        if to[i] != ROOT:
            total = wp.float64(0.0)
            for k in range(9):
                if k != 4:
                    total += part(grid, filled, i, k)
            if total > wp.float64(0.0):
                per = area[i] / total
                for k in range(9):
                    if k != 4:
                        share = part(grid, filled, i, k)
                        if share > wp.float64(0.0):
                            j = towards(i, k, grid.width)
                            area[j] = area[j] + per * share
            else:
                j = towards(i, wp.int32(to[i]), grid.width)
                area[j] = area[j] + area[i]


@wp.kernel
def level_lakes(
    grid: Grid,
    to: wp.array(dtype=wp.uint8),
    order: wp.array(dtype=wp.int32),
    h: wp.array(dtype=wp.float32),
    filled: wp.array(dtype=wp.float32),
    area: wp.array(dtype=wp.float64),
):
    """Serial. A lake is one body of water: what is below its surface has the area of where that drains to."""
    n = grid.width * grid.height
    for q in range(n):
        i = order[n - 1 - q]
        if to[i] != ROOT and filled[i] > h[i]:
            area[i] = wp.max(area[i], area[towards(i, wp.int32(to[i]), grid.width)])


@wp.kernel
def take_logarithms(offset: int, cell: wp.float64, area: wp.array(dtype=wp.float64), out: wp.array(dtype=wp.float32)):
    """Areas in samples of `cell` m^2 -> natural logarithms of m^2."""
    i = offset + wp.tid()
    out[i] = wp.float32(natural_log(area[i] * cell))
