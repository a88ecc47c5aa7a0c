# SPDX-License-Identifier: GPL-3.0-or-later
"""From drainage (routing.py) to catchment areas: lakes filled, flow shared among all lower neighbours."""

import warp as wp

from .logarithm import natural_log
from .routing import ROOT, Drainage, axis, towards


@wp.kernel
def fill_lakes(d: Drainage):
    """Serial. The least surface from which every sample drains: none lies below its receiver."""
    n = d.grid.width * d.grid.height
    for q in range(n):
        i = d.order[n - 1 - q]
        d.filled[i] = d.h[i]
        if d.to[i] != ROOT:
            d.filled[i] = wp.max(d.h[i], d.filled[towards(i, wp.int32(d.to[i]), d.grid.width)])


@wp.func
def part(d: Drainage, i: wp.int32, k: wp.int32) -> wp.float64:
    """The weight of what flows from sample i in direction k, 0 for upwards."""
    fall = wp.float64(d.filled[i]) - wp.float64(d.filled[towards(i, k, d.grid.width)])
    return wp.max(fall, wp.float64(0.0)) * d.grid.share[axis(k)]


@wp.kernel
def gather_area(d: Drainage, rising: wp.array(dtype=wp.int32)):
    """Serial. From above every sample gives its area to all lower neighbours by their slopes (Quinn et al. 1991); where
    there is none, in lakes and on flats, to its receiver. `area`: each sample's own before, of all that drains through
    it after. `rising`: by the filled surface, receivers before donors where that is level."""
    n = d.grid.width * d.grid.height
    for q in range(n):
        i = rising[n - 1 - q]
        if d.to[i] != ROOT:
            total = wp.float64(0.0)
            for k in range(9):
                if k != 4:
                    total += part(d, i, k)
            if total > wp.float64(0.0):
                per = d.area[i] / total
                for k in range(9):
                    if k != 4:
                        share = part(d, i, k)
                        if share > wp.float64(0.0):
                            j = towards(i, k, d.grid.width)
                            d.area[j] = d.area[j] + per * share
            else:
                j = towards(i, wp.int32(d.to[i]), d.grid.width)
                d.area[j] = d.area[j] + d.area[i]


@wp.kernel
def level_lakes(d: Drainage):
    """Serial. A lake is one body of water: what is below its surface has the area of where that drains to."""
    n = d.grid.width * d.grid.height
    for q in range(n):
        i = d.order[n - 1 - q]
        if d.to[i] != ROOT and d.filled[i] > d.h[i]:
            d.area[i] = wp.max(d.area[i], d.area[towards(i, wp.int32(d.to[i]), d.grid.width)])


@wp.kernel
def take_logarithms(offset: int, cell: wp.float64, area: wp.array(dtype=wp.float64), out: wp.array(dtype=wp.float32)):
    """Areas in samples of `cell` m^2 -> natural logarithms of m^2."""
    i = offset + wp.tid()
    out[i] = wp.float32(natural_log(area[i] * cell))
