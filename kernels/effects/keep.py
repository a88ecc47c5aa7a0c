# SPDX-License-Identifier: GPL-3.0-or-later
"""Reuse of the last surface's values: points in both surfaces are found, and their values copied.

Vertices of both surfaces are in the order of the same curve, so that common points usually form a few long runs. A run
is (first point, first point of the last surface, count). Equality is bit by bit. `positions`: this surface's points,
metres; `last`, `last_count`: the last surface's points and their number.
"""

import warp as wp

from ..field.noise import scramble
from ..unchecked import copy_items, count_same_floats, count_same_vec3s, item_at, put

# Initial balance of `match_anywhere`, 5 for each of 51 sampled points without a match: up to 3,000 points are searched.
ALWAYS = wp.constant(256)
MAX_ITEMS = wp.constant(2147483647)  # of an array at an address: its length is not known
LOOK = wp.constant(32)  # points of both surfaces together that may be skipped to find the next run


@wp.func
def next_common(
    positions: wp.array(dtype=wp.vec3f),
    v: wp.int32,
    count: wp.int32,
    last: wp.array(dtype=wp.vec3f),
    last_v: wp.int32,
    last_count: wp.int32,
):
    """Return how many points to skip in this and in the last surface until the next ones agree.

    It is (-1, -1) if more than LOOK points in all would have to be skipped. v, last_v: current points of this and of
    the last surface. count, last_count: numbers of points.
    """
    skip = wp.vec2i(-1, -1)
    total = wp.int32(1)
    while total <= LOOK and skip[0] < 0:
        for skipped in range(total + 1):
            if skip[0] < 0 and v + skipped < count and last_v + total - skipped < last_count:
                if count_same_vec3s(positions, v + skipped, last, last_v + total - skipped, 1) == 1:
                    skip = wp.vec2i(skipped, total - skipped)
        total += 1
    return skip


@wp.kernel
def match_in_order(
    positions: wp.array(dtype=wp.vec3f),
    count: int,
    last: wp.array(dtype=wp.vec3f),
    last_count: int,
    runs: wp.array(dtype=wp.vec3i),
    found: wp.array(dtype=wp.int32),
):
    """List runs of points that this surface and the last one, of the last frame, have in the same order. One thread.

    The search stops where more than LOOK points would have to be skipped. last, last_count: the last surface's points
    and their number. runs [k]: first point, first point of the last surface, count. found [2]: number of runs, and the
    first point that `match_anywhere` still has to find.
    """
    v = wp.int32(0)
    last_v = wp.int32(0)
    k = wp.int32(0)
    has_ended = wp.int32(0)
    while v < count and has_ended == 0:
        same = count_same_vec3s(positions, v, last, last_v, wp.min(count - v, last_count - last_v))
        if same > 0:
            runs[k] = wp.vec3i(v, last_v, same)
            k += 1
        v += same
        last_v += same
        skip = next_common(positions, v, count, last, last_v, last_count)
        if skip[0] < 0:
            has_ended = 1
        else:
            v += skip[0]
            last_v += skip[1]
    found[0] = k
    found[1] = v


@wp.func
def hash_slot(p: wp.vec3f, bits: wp.int32) -> wp.int32:
    """Return the slot of a point in a hash table of 2^bits entries, by its x and y."""
    h = scramble(scramble(wp.cast(p[0], wp.uint32)) + wp.cast(p[1], wp.uint32))
    return wp.int32(h >> wp.uint32(32 - bits))


@wp.kernel
def match_anywhere(
    positions: wp.array(dtype=wp.vec3f),
    count: int,
    last: wp.array(dtype=wp.vec3f),
    last_count: int,
    bits: int,
    table: wp.array(dtype=wp.int32),
    runs: wp.array(dtype=wp.vec3i),
    found: wp.array(dtype=wp.int32),
):
    """Append runs of points that both surfaces have in any order, from point found[1] on.

    The search is left out if the last surface has less than about five eighths of these points, as after a cut to
    another view: it would cost more than it saves. Points with one hash in 64 estimate that fraction: each adds 8 - 5
    to a balance if the last surface has it, and -5 if not. The balance begins at ALWAYS, so that few points are always
    searched.

    One thread. runs [count], found (number of runs, first point to find): continued from `match_in_order`. table
    [2**bits]: scratch, -1 before. It has one point for each hash of x and y, so that a run may begin late, but none is
    wrong.
    """
    for i in range(last_count):
        slot = hash_slot(last[i], bits)
        if (slot & 63) == 0:
            put(table, wp.int64(slot), i)
    k = found[0]
    v = found[1]
    balance = wp.int32(ALWAYS)
    for i in range(v, count):
        slot = hash_slot(positions[i], bits)
        if (slot & 63) == 0:
            balance -= 5
            if item_at(table, slot) >= 0:
                balance += 8 * count_same_vec3s(positions, i, last, item_at(table, slot), 1)
    if balance < 0:  # too few common points
        return
    for i in range(last_count):
        put(table, wp.int64(hash_slot(last[i], bits)), i)
    while v < count:
        last_v = item_at(table, hash_slot(positions[v], bits))
        same = wp.int32(0)
        if last_v >= 0:
            same = count_same_vec3s(positions, v, last, last_v, wp.min(count - v, last_count - last_v))
            if same > 0:
                runs[k] = wp.vec3i(v, last_v, same)
                k += 1
        v += wp.max(same, 1)
    found[0] = k


@wp.kernel
def list_fresh(
    count: int,
    runs: wp.array(dtype=wp.vec3i),
    run_count: int,
    levels: wp.array(dtype=wp.float32),
    last_levels: wp.array(dtype=wp.float32),
    fresh: wp.array(dtype=wp.int32),
    found: wp.array(dtype=wp.int32),
):
    """List the points whose values have to be computed: those in no run, or with another level than before.

    One thread. runs: (first point, first point of the last surface, count), ascending; the first `run_count` entries.
    levels, last_levels: log2 of the samples that a pixel covers at each point, now and before. fresh: the listed
    points. found[0] becomes their number.
    """
    n = wp.int32(0)
    v = wp.int32(0)
    for k in range(run_count + 1):
        run = wp.vec3i(count, 0, 0)  # behind the last run: an empty one at the end
        if k < run_count:
            run = runs[k]
        while v < run[0]:
            fresh[n] = v
            n += 1
            v += 1
        end = v + run[2]
        while v < end:
            v += count_same_floats(levels, v, last_levels, run[1] + v - run[0], end - v)
            if v < end:
                fresh[n] = v
                n += 1
                v += 1
    found[0] = n


@wp.kernel
def move_runs(offset: int, runs: wp.array(dtype=wp.vec3i), run_count: int, quantities: wp.array2d(dtype=wp.int64)):
    """Copy the last surface's values of quantity `offset + tid` to the points of this surface that are in a run.

    runs: (first point, first point of the last surface, count), ascending; the first `run_count` entries. quantities
    [n, 3]: of each the address of the last surface's float32 values, of this surface's, and the numbers for a point.
    Both may be the same array if the runs have the same order in both surfaces: runs that move towards the beginning
    are copied first to last, then the others last to first, so that no value is overwritten before it is copied.
    """
    number = offset + wp.tid()
    last = wp.array(ptr=wp.uint64(quantities[number, 0]), shape=(MAX_ITEMS,), dtype=wp.float32)
    values = wp.array(ptr=wp.uint64(quantities[number, 1]), shape=(MAX_ITEMS,), dtype=wp.float32)
    width = quantities[number, 2]
    for k in range(2 * run_count):
        run = runs[wp.where(k < run_count, k, 2 * run_count - 1 - k)]
        if (run[0] <= run[1]) == (k < run_count):
            copy_items(last, wp.int64(run[1]) * width, run[2] * wp.int32(width), values, wp.int64(run[0]) * width)
