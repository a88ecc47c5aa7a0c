# SPDX-License-Identifier: GPL-3.0-or-later
"""Drainage of a raster: where each sample's water goes, out of depressions and over flats, and in which order.

One byte a sample holds its receiver among the eight neighbours: 3 * (dy + 1) + dx + 1, and 4 for a root. `base` marks
where water leaves: the raster's rim, so that whatever has a receiver has eight neighbours, and holes. Depressions are
left over the lowest passes between their basins: the graph of Cordonnier, Bovy and Braun (2019), "A versatile, linear
complexity algorithm for flow routing in topographies with depressions", section 2, here as a run of Kruskal's algorithm
whose links turn the flow of a basin's own tree around, so that no graph is built. All steps but the sort are linear.
"""

import warp as wp

from ..field.noise import scramble
from .rows import (
    Drainage,
    count_donors_of_row,
    find_receivers_of_row,
    label_samples,
    list_passes_of_row,
    next_pit,
    passes_of_row,
    walk_downstream,
)

ROOT = wp.constant(wp.uint8(4))
# Added to the receiver of a flat's sample that stands in the queue of the first pass.
WAITING = wp.constant(wp.uint8(16))


@wp.struct
class Draw:
    """Noise in the choice of receivers: every slope times 1 - jitter / 2 .. 1 + jitter / 2, which breaks the straight
    lines of eight directions. By the place: `row`, `column` are those of the first sample in the whole raster."""

    jitter: wp.float32
    seed: wp.uint32
    row: wp.int32
    column: wp.int32


@wp.func
def towards(i: wp.int32, k: wp.int32, width: wp.int32) -> wp.int32:
    """The neighbour of sample i in direction k."""
    return i + (k / 3 - 1) * width + (k % 3 - 1)


@wp.func
def axis(k: wp.int32) -> wp.int32:
    """Which of the three weights direction k has."""
    return wp.where(k % 2 == 0, 2, wp.where(k == 3 or k == 5, 0, 1))


@wp.func
def straight_first(q: wp.int32) -> wp.int32:
    """The eight directions, the four along the axes first: q = 0 .. 7."""
    return wp.where(q < 4, 2 * q + 1, wp.where(q < 6, 2 * (q - 4), 2 * (q - 3)))


@wp.kernel
def find_receivers(offset: int, d: Drainage, nearness: wp.vec3f, draw: Draw):
    """Row `offset + tid`: each sample's steepest way down (O'Callaghan and Mark 1984), ROOT where there is none."""
    y = offset + wp.tid()
    first = y * d.grid.width
    if y == 0 or y == d.grid.height - 1:
        for i in range(first, first + d.grid.width):
            d.to[i] = ROOT
    else:
        d.to[first] = ROOT
        d.to[first + d.grid.width - 1] = ROOT
        noise = scramble(wp.uint32(draw.row + y) + draw.seed) + wp.uint32(draw.column)
        least = wp.float32(1.0) - draw.jitter * wp.float32(0.498046875)  # the mean of 256 steps is 1
        step = draw.jitter * wp.float32(0.00390625)
        find_receivers_of_row(d, y, nearness, least, step, noise)


@wp.func
def grow(d: Drainage, end: wp.int32):
    """Level samples without a receiver flow towards those in the queue, each along one of the shortest ways. The queue
    is the first `end` of `order`."""
    at = wp.int32(0)
    while at < end:
        i = d.order[at]
        at += 1
        if d.to[i] >= WAITING:
            d.to[i] = d.to[i] - WAITING
        for q in range(8):
            k = straight_first(q)
            j = towards(i, k, d.grid.width)
            if d.to[j] == ROOT and d.base[j] == wp.uint8(0) and d.h[j] == d.h[i]:
                d.to[j] = wp.uint8(8 - k)
                d.order[end] = j
                end += 1


@wp.kernel
def cross_flats(d: Drainage, pits: wp.array(dtype=wp.int32)):
    """Serial. A flat drains to where it has an outlet, the nearest one; without one, to its first sample, a pit.

    `order` is scratch, `pits` [1] becomes the number of pits, and `label` of each its number from 2 on.
    """
    n = d.grid.width * d.grid.height
    end = wp.int32(0)
    i = next_pit(d, 0)
    while i < n:
        found = wp.int32(0)
        for q in range(8):
            k = straight_first(q)
            j = towards(i, k, d.grid.width)
            drains = (d.to[j] < WAITING and d.to[j] != ROOT) or d.base[j] != wp.uint8(0)
            if found == 0 and drains and d.h[j] == d.h[i]:
                found = 1
                d.to[i] = wp.uint8(k) + WAITING
                d.order[end] = i
                end += 1
        i = next_pit(d, i + 1)
    grow(d, end)
    count = wp.int32(0)
    # What flows to a pit has a receiver already when the scan comes to it.
    i = next_pit(d, 0)
    while i < n:
        d.base[i] = wp.uint8(1)  # while it grows, so that nothing gives it a receiver
        d.order[0] = i
        grow(d, wp.int32(1))
        d.base[i] = wp.uint8(0)
        d.label[i] = count + 2
        count += 1
        i = next_pit(d, i + 1)
    pits[0] = count


@wp.kernel
def label_basins(offset: int, block: int, d: Drainage):
    """Block `offset + tid`: the number of the pit that each sample flows to, 1 for any of `base`; 0 before.

    A thread may write labels of other blocks: all write the same, since a sample has one root.
    """
    first = (offset + wp.tid()) * block
    label_samples(d, first, wp.min(first + block, d.grid.width * d.grid.height))


@wp.kernel
def find_passes(
    offset: int,
    emit: int,
    d: Drainage,
    start: wp.array(dtype=wp.int64),
    key: wp.array(dtype=wp.float32),
    edge: wp.array(dtype=wp.int32),
):
    """Row `offset + tid`, which is not the last: its neighbours of other basins among those ahead (directions 5 - 8):
    their number into `start`, or, with `emit`, from `start` on the height of each pass and 4 * sample + direction - 5.

    Both ends of a pass in the last row are of `base`.
    """
    y = offset + wp.tid()
    if emit == 0:
        start[y] = wp.int64(passes_of_row(d, y))
    elif start[y + 1] > start[y]:
        list_passes_of_row(d, y, start[y], key, edge)


@wp.func
def representative(up: wp.array(dtype=wp.int32), a: wp.int32) -> wp.int32:
    while up[a] != a:
        up[a] = up[up[a]]
        a = up[a]
    return a


@wp.func
def turn(to: wp.array(dtype=wp.uint8), i: wp.int32, k: wp.int32, width: wp.int32):
    """Sample i flows in direction k from now on, and what it flowed to, down to the root, flows to it."""
    at = wp.int32(i)
    new = wp.int32(k)
    going = wp.int32(1)
    while going == 1:
        old = wp.int32(to[at])
        to[at] = wp.uint8(new)
        if old == 4:
            going = 0
        else:
            at = towards(at, old, width)
            new = 8 - old


@wp.kernel
def link_basins(count: int, pits: int, d: Drainage, edge: wp.array(dtype=wp.int32), up: wp.array(dtype=wp.int32)):
    """Serial. From the lowest pass on: of two basins that are not linked yet one drains over it, never that of `base`.

    `up` [pits + 2]: the sets of basins that are linked, each its own before.
    """
    outside = wp.int32(1)
    left = wp.int32(pits)
    e = wp.int32(0)
    while e < count and left > 0:
        i = edge[e] / 4
        k = 5 + edge[e] % 4
        j = towards(i, k, d.grid.width)
        a = representative(up, d.label[i])
        b = representative(up, d.label[j])
        if a != b:
            left -= 1
            # The set of `outside` keeps its number, so that one comparison knows it.
            if a == outside:
                turn(d.to, j, 8 - k, d.grid.width)
                up[b] = a
            else:
                turn(d.to, i, k, d.grid.width)
                up[a] = b
        e += 1


@wp.func
def donors_at(d: Drainage, x: wp.int32, y: wp.int32) -> wp.uint8:
    """How many neighbours flow to a sample of the rim."""
    count = wp.int32(0)
    for k in range(9):
        xx = x + k % 3 - 1
        yy = y + k / 3 - 1
        if k != 4 and xx >= 0 and xx < d.grid.width and yy >= 0 and yy < d.grid.height:
            if d.to[yy * d.grid.width + xx] == wp.uint8(8 - k):
                count += 1
    return wp.uint8(count)


@wp.kernel
def count_donors(offset: int, d: Drainage):
    """Row `offset + tid`: how many neighbours flow to each sample."""
    y = offset + wp.tid()
    if y == 0 or y == d.grid.height - 1:
        for x in range(d.grid.width):
            d.donors[y * d.grid.width + x] = donors_at(d, x, y)
    else:
        last = d.grid.width - 1
        d.donors[y * d.grid.width] = donors_at(d, 0, y)
        d.donors[y * d.grid.width + last] = donors_at(d, last, y)
        count_donors_of_row(d, y)


@wp.kernel
def order_downstream(d: Drainage):
    """Serial. All samples, each after those that flow to it (Zhou, Wei and Fu 2019): down from each spring as far as
    no other branch is missing. `donors` is used up. `area`: what each sample counts before, the sum of all that drains
    through it after."""
    walk_downstream(d)
