# SPDX-License-Identifier: GPL-3.0-or-later
"""Drainage areas from drainage (routing.py): filled lakes, and flow to all lower neighbours.

A sample's *receiver* is the neighbour that it drains to; the samples that drain to it are its *donors*. Of the arrays
d, [n] in rows, these are read: `h`, heights in metres; `to`, the direction of the receiver, 3 * (dy + 1) + dx + 1, or
ROOT without one; `order`, the samples, donors before receivers, so that read backwards it begins at outlets.
"""

import warp as wp

from .logarithm import natural_log
from .routing import ROOT, DrainageArrays, axis, towards
from .rows import sort_from_top


@wp.kernel
def fill_lakes(d: DrainageArrays):
    """Compute `filled`, the lowest surface from which every sample drains: no sample is below its receiver.

    One thread; it visits receivers before donors. It writes 0 for -0.
    """
    n = d.grid.width * d.grid.height
    for q in range(n):
        i = d.order[n - 1 - q]
        z = d.h[i] + wp.float32(0.0)
        if d.to[i] != ROOT:
            z = wp.max(z, d.filled[towards(i, wp.int32(d.to[i]), d.grid.width)])
        d.filled[i] = z


@wp.kernel
def sort_order(
    d: DrainageArrays,
    scratch: wp.array(dtype=wp.int32),
    upper_halves: wp.array(dtype=wp.uint16),
    starts: wp.array(dtype=wp.int32),
):
    """Sort `order` by the filled surface, the highest first, serially; level samples keep their order.

    So donors remain before receivers. scratch, upper_halves [n], starts [2 * 65536] zeros: scratch of a radix sort.
    """
    sort_from_top(d, d.grid.width * d.grid.height, d.order, scratch, upper_halves, starts)


@wp.func
def flow_weight(d: DrainageArrays, i: wp.int32, k: wp.int32) -> wp.float64:
    """Return the weight of the flow from sample i to its neighbour in direction k, 0 if that is not lower.

    It is the slope of the filled surface times the length of contour that the flow crosses: the fall in metres times
    `share`, that length over the distance of the neighbours. k: 0 .. 8, as 3 * (dy + 1) + dx + 1.
    """
    fall = wp.float64(d.filled[i]) - wp.float64(d.filled[towards(i, k, d.grid.width)])
    return wp.max(fall, wp.float64(0.0)) * d.grid.share[axis(k)]


@wp.kernel
def gather_area(d: DrainageArrays, stream: wp.float64):
    """Pass every sample's area to all lower neighbours by their slopes (Quinn et al. 1991), serially from above.

    Areas of `stream` samples or more are channels, whose water stays together (Quinn et al. 1995): they go to the
    receiver. So do those in lakes and on flats, without a lower neighbour. `area`: first the samples' weights, then the
    drainage areas. `order`: sorted by `sort_order`.
    """
    for q in range(d.grid.width * d.grid.height):
        i = d.order[q]
        if d.to[i] != ROOT:
            total = wp.float64(0.0)
            for k in range(9):
                if k != 4:  # the sample itself
                    total += flow_weight(d, i, k)
            if total > wp.float64(0.0) and d.area[i] < stream:
                area_per_weight = d.area[i] / total
                for k in range(9):
                    if k != 4:
                        weight = flow_weight(d, i, k)
                        if weight > wp.float64(0.0):
                            j = towards(i, k, d.grid.width)
                            d.area[j] = d.area[j] + area_per_weight * weight
            else:  # a channel, a lake or a flat
                j = towards(i, wp.int32(d.to[i]), d.grid.width)
                d.area[j] = d.area[j] + d.area[i]


@wp.kernel
def level_lakes(d: DrainageArrays):
    """Raise the drainage area of all samples under a lake to that of its outlet. One thread; outlets first."""
    n = d.grid.width * d.grid.height
    for q in range(n):
        i = d.order[n - 1 - q]
        if d.to[i] != ROOT and d.filled[i] > d.h[i]:  # under a lake
            d.area[i] = wp.max(d.area[i], d.area[towards(i, wp.int32(d.to[i]), d.grid.width)])


@wp.kernel
def take_logarithms(offset: int, cell: wp.float64, area: wp.array(dtype=wp.float64), out: wp.array(dtype=wp.float32)):
    """Write the natural logarithm of each drainage area in m2. area: in samples of `cell` m2."""
    i = offset + wp.tid()
    out[i] = wp.float32(natural_log(area[i] * cell))
