# SPDX-License-Identifier: GPL-3.0-or-later
"""Drainage of a raster: receivers, also out of depressions and over flats, and an order of samples.

One byte for each sample is its receiver among the eight neighbours, 3 * (dy + 1) + dx + 1, and 4 for a root. `base`
marks outlets: holes, and the raster's border, so that every sample with a receiver has eight neighbours. Depressions
drain over the lowest passes between their basins (Cordonnier, Bovy and Braun 2019, "A versatile, linear complexity
algorithm for flow routing in topographies with depressions", section 2). Here Kruskal's algorithm links basins by
reversing the flow in a basin's tree, so that no graph is built. All steps but the sort are linear.

The arrays d (DrainageArrays) have an entry for each sample, row by row: `h`, heights in metres; `base`, 1 at outlets;
`to`, receivers; `label`, basins; `donors`, numbers of neighbours that drain into a sample; `order`, samples, donors
before receivers.
"""

import warp as wp

from ..field.noise import scramble
from .rows import (
    DrainageArrays,
    count_donors_of_row,
    find_receivers_of_row,
    label_samples,
    list_passes_of_row,
    next_pit,
    passes_of_row,
    sort_passes_from_bottom,
    walk_downstream,
)

ROOT = wp.constant(wp.uint8(4))
# Added to the receiver of a flat's sample that is in the queue of the first pass.
WAITING = wp.constant(wp.uint8(16))


@wp.struct
class ReceiverNoise:
    """Noise in the choice of receivers: slopes times 1 - jitter / 2 .. 1 + jitter / 2, which breaks straight lines.

    It is a function of the position in the whole raster.
    """

    jitter: wp.float32  # width of the range of these factors
    seed: wp.uint32
    row: wp.int32  # of the first sample in the whole raster
    column: wp.int32


@wp.func
def towards(i: wp.int32, k: wp.int32, width: wp.int32) -> wp.int32:
    """Return the neighbour of sample i in direction k = 3 * (dy + 1) + dx + 1, with `width` samples in a row."""
    return i + (k / 3 - 1) * width + (k % 3 - 1)


@wp.func
def axis(k: wp.int32) -> wp.int32:
    """Return the axis of direction k, the index of its weight in a Grid: 0 east-west, 1 north-south, 2 diagonal."""
    return wp.where(k % 2 == 0, 2, wp.where(k == 3 or k == 5, 0, 1))


@wp.func
def straight_first(q: wp.int32) -> wp.int32:
    """Return the q-th direction (q = 0 .. 7) of an order that has the four along the axes first."""
    return wp.where(q < 4, 2 * q + 1, wp.where(q < 6, 2 * (q - 4), 2 * (q - 3)))


@wp.kernel
def find_receivers(offset: int, d: DrainageArrays, inverse_distance: wp.vec3f, noise: ReceiverNoise):
    """Write the D8 receiver of each sample of row `offset + tid`; ROOT if no neighbour is lower, and at outlets.

    A receiver is a direction, 3 * (dy + 1) + dx + 1, to the neighbour of the steepest descent (O'Callaghan and Mark
    1984). The raster's border is ROOT, too. inverse_distance: 1 / distance of the neighbours east-west, north-south and
    diagonally, 1/m. noise: random factors on the slopes, which break straight lines.
    """
    y = offset + wp.tid()
    first = y * d.grid.width
    if y == 0 or y == d.grid.height - 1:  # the border
        for i in range(first, first + d.grid.width):
            d.to[i] = ROOT
    else:
        d.to[first] = ROOT
        d.to[first + d.grid.width - 1] = ROOT
        row_hash = scramble(wp.uint32(noise.row + y) + noise.seed) + wp.uint32(noise.column)
        # The factors are 256 numbers with a mean of 1, in steps of jitter / 256 from 1 - jitter 255 / 512 on.
        min_factor = wp.float32(1.0) - noise.jitter * wp.float32(0.498046875)
        factor_step = noise.jitter * wp.float32(0.00390625)
        find_receivers_of_row(d, y, inverse_distance, min_factor, factor_step, row_hash)


@wp.func
def route_flats(d: DrainageArrays, end: wp.int32):
    """Route level samples without a receiver towards the samples in the queue, along shortest paths (breadth first).

    The queue is the first `end` entries of `order`; samples that are routed join it. Samples of `base` are never
    routed. The marks WAITING of queued samples are removed.
    """
    next_entry = wp.int32(0)
    while next_entry < end:
        i = d.order[next_entry]
        next_entry += 1
        if d.to[i] >= WAITING:
            d.to[i] = d.to[i] - WAITING
        for q in range(8):
            k = straight_first(q)
            j = towards(i, k, d.grid.width)
            if d.to[j] == ROOT and d.base[j] == wp.uint8(0) and d.h[j] == d.h[i]:  # level, without a receiver
                d.to[j] = wp.uint8(8 - k)
                d.order[end] = j
                end += 1


@wp.kernel
def cross_flats(d: DrainageArrays, pits: wp.array(dtype=wp.int32)):
    """Drain flats to their nearest outlet, serially; a flat without one drains to its first sample, a pit.

    Overwrites `order`, the queue; the receivers of the samples that begin it have WAITING added until their turn.
    pits[0] becomes the number of pits. They get the labels 2, 3 .. in the order of samples: 0 means "none yet", 1 an
    outlet.
    """
    n = d.grid.width * d.grid.height
    end = wp.int32(0)
    # Samples without a receiver that touch a level one that drains begin the queue; `next_pit` finds all without one.
    i = next_pit(d, 0)
    while i < n:
        is_routed = wp.int32(0)
        for q in range(8):
            k = straight_first(q)
            j = towards(i, k, d.grid.width)
            drains = (d.to[j] < WAITING and d.to[j] != ROOT) or d.base[j] != wp.uint8(0)
            if is_routed == 0 and drains and d.h[j] == d.h[i]:
                is_routed = 1
                d.to[i] = wp.uint8(k) + WAITING
                d.order[end] = i
                end += 1
        i = next_pit(d, i + 1)
    route_flats(d, end)
    count = wp.int32(0)
    # Samples that flow to a pit already have a receiver when the scan reaches them.
    i = next_pit(d, 0)
    while i < n:
        d.base[i] = wp.uint8(1)  # for this call, so that nothing gives it a receiver
        d.order[0] = i
        route_flats(d, wp.int32(1))
        d.base[i] = wp.uint8(0)
        d.label[i] = count + 2
        count += 1
        i = next_pit(d, i + 1)
    pits[0] = count


@wp.kernel
def label_basins(offset: int, block: int, d: DrainageArrays):
    """Label the samples of block `offset + tid` with the number of the pit downstream; 1 if that is an outlet (`base`).

    block: samples of a block. A label of 0 means that a sample has none yet. A thread may write labels of other blocks;
    all write the same, since a sample has one root.
    """
    first = (offset + wp.tid()) * block
    label_samples(d, first, wp.min(first + block, d.grid.width * d.grid.height))


@wp.kernel
def find_passes(
    offset: int,
    emit: int,
    d: DrainageArrays,
    start: wp.array(dtype=wp.int64),
    edge: wp.array(dtype=wp.int32),
):
    """Count or list the passes of row `offset + tid`: pairs of neighbours in different basins, in directions 5 .. 8.

    Those are the next sample in the row and three in the next row, so each pair is met once. emit: 0 to write their
    number to start[row]; 1 to list them from entry start[row] on. `start` then has the number of passes of all rows
    before each row and, as its last entry, of all. edge: 4 * sample + direction - 5. The last row is left out, as both
    ends of its passes are outlets.
    """
    y = offset + wp.tid()
    if emit == 0:
        start[y] = wp.int64(passes_of_row(d, y))
    elif start[y + 1] > start[y]:
        list_passes_of_row(d, y, start[y], edge)


@wp.kernel
def sort_passes(
    count: int,
    d: DrainageArrays,
    edge: wp.array(dtype=wp.int32),
    scratch: wp.array(dtype=wp.int32),
    upper_halves: wp.array(dtype=wp.uint16),
    starts: wp.array(dtype=wp.int32),
):
    """Sort `count` passes stably by their heights, the lowest first, serially.

    edge: 4 * sample + direction - 5 of each, sorted in place. scratch, upper_halves [count], starts [2 * 65536] zeros:
    scratch of a radix sort.
    """
    sort_passes_from_bottom(d, count, edge, scratch, upper_halves, starts)


@wp.func
def representative(up: wp.array(dtype=wp.int32), a: wp.int32) -> wp.int32:
    """Return the representative of the set that basin `a` is in (union-find with path halving).

    up: parent of each basin; the path from `a` is shortened in it.
    """
    while up[a] != a:
        up[a] = up[up[a]]
        a = up[a]
    return a


@wp.func
def redirect_basin(to: wp.array(dtype=wp.uint8), i: wp.int32, k: wp.int32, width: wp.int32):
    """Make sample i drain in direction k, and reverse the old path from i to its root.

    So the whole basin of that root drains through i. to: directions of the receivers. width: samples in a row.
    """
    sample = wp.int32(i)
    new = wp.int32(k)
    is_going_on = wp.int32(1)
    while is_going_on == 1:
        old = wp.int32(to[sample])
        to[sample] = wp.uint8(new)
        if old == 4:  # ROOT
            is_going_on = 0
        else:
            sample = towards(sample, old, width)
            new = 8 - old


@wp.kernel
def link_basins(count: int, pits: int, d: DrainageArrays, edge: wp.array(dtype=wp.int32), up: wp.array(dtype=wp.int32)):
    """Link basins over the passes in ascending order, serially: one of two unlinked basins drains over the pass.

    The basins of `base`, label 1, never drain elsewhere. count: number of passes. edge: 4 * sample + direction - 5 of
    each pass, ascending by height. up [pits + 2]: parent of each basin in the sets of linked basins; at first itself.
    """
    outside = wp.int32(1)  # label of all samples that drain to an outlet
    num_unlinked = wp.int32(pits)
    p = wp.int32(0)
    while p < count and num_unlinked > 0:
        i = edge[p] / 4
        k = 5 + edge[p] % 4
        j = towards(i, k, d.grid.width)
        a = representative(up, d.label[i])
        b = representative(up, d.label[j])
        if a != b:
            num_unlinked -= 1
            # The set of `outside` keeps its number, so that one comparison identifies it.
            if a == outside:
                redirect_basin(d.to, j, 8 - k, d.grid.width)
                up[b] = a
            else:
                redirect_basin(d.to, i, k, d.grid.width)
                up[a] = b
        p += 1


@wp.func
def donors_at(d: DrainageArrays, x: wp.int32, y: wp.int32) -> wp.uint8:
    """Return the number of donors of a sample on the border: neighbours that drain into it.

    x, y: its column and row.
    """
    count = wp.int32(0)
    for k in range(9):
        xx = x + k % 3 - 1
        yy = y + k / 3 - 1
        if k != 4 and xx >= 0 and xx < d.grid.width and yy >= 0 and yy < d.grid.height:
            if d.to[yy * d.grid.width + xx] == wp.uint8(8 - k):  # it drains into the sample
                count += 1
    return wp.uint8(count)


@wp.kernel
def count_donors(offset: int, d: DrainageArrays):
    """Count the donors of each sample of row `offset + tid`: neighbours that drain into it."""
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
def order_downstream(d: DrainageArrays):
    """Order all samples, donors before receivers, serially (Zhou, Wei and Fu 2019).

    From each sample without donors it walks down until it meets one whose other donors are not yet in the order; the
    last of them goes on from there. Overwrites `donors`. `area`: first the weights of samples, then their sums over all
    upstream samples; if it is empty, no sums are computed.
    """
    walk_downstream(d)
