# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the concurrent binary tree: the sum reduction above the cells that changed."""

import warp as wp

from ..unchecked import count_same

wp.set_module_options({"enable_backward": False})

# A stream of cells lies in parts, ascending. After each comes a link, a negative entry: ~first to the next part's first
# entry, or END; such a link is the stream's first entry if no part begins there.
END_LINK = -1
END = wp.constant(wp.int64(END_LINK))


@wp.struct
class Run:
    """What lies in one row in two streams, cells or points."""

    first: wp.int64  # entry in the new stream
    before: wp.int64  # ... and in the old one
    count: wp.int64


@wp.struct
class Runs:
    """Lists of runs, each in the order of the new stream."""

    runs: wp.array(dtype=Run)  # list k from entry k * room on
    counts: wp.array(dtype=wp.int64)
    room: wp.int64
    lists: wp.int32


@wp.func
def next_run(known: Runs, run: wp.int64):
    """The run after entry `run` (-1: the first): entry, first in the new stream (-1: there is none), and its cells."""
    i = run + wp.int64(1)
    k = wp.int32(i / known.room)
    while k < known.lists and i - wp.int64(k) * known.room >= known.counts[k]:
        k += 1
        i = wp.int64(k) * known.room
    first = wp.int64(-1)
    count = wp.int64(0)
    if k < known.lists:
        first = known.runs[i].first
        count = known.runs[i].count
    return i, first, count


@wp.func
def add_above(
    group: wp.int64,
    delta: wp.int64,
    upper_counts: wp.array(dtype=wp.int64),
    level_start: wp.array(dtype=wp.int64),
):
    """Add `delta` leaves to the counter of a group of 64 blocks and to every counter above it."""
    node = group
    for level in range(level_start.shape[0]):
        at = level_start[level] + node
        upper_counts[at] = upper_counts[at] + delta
        node = node >> wp.int64(6)


@wp.kernel
def reduce_changed(
    cells: wp.array(dtype=wp.int64),
    old_cells: wp.array(dtype=wp.int64),
    block_counts: wp.array(dtype=wp.uint16),
    upper_counts: wp.array(dtype=wp.int64),
    level_start: wp.array(dtype=wp.int64),
    changed_cells: wp.array(dtype=wp.int64),
    known: Runs,
):
    """Merge two streams of cells and sum again above those that are in one of them only.

    One serial thread; the counters above 64 blocks are touched once, when the merge has passed their last changed cell.
    Cells of a `known` run are not read: because both streams ascend, the old one is at the run's first cell there if it
    has the new one's.
    """
    one = wp.int64(1)
    i = wp.int64(0)
    j = wp.int64(0)
    changed = wp.int64(0)
    block = wp.int64(0)
    block_delta = wp.int32(0)
    group_delta = wp.int64(0)
    run, run_first, run_cells = next_run(known, wp.int64(-1))
    running = wp.bool(True)
    while running:
        # The cells that stay are most of them.
        same = count_same(cells, i, run_first, old_cells, j)
        i += same
        j += same
        a = cells[i]
        b = old_cells[j]
        if i == run_first and a == b:
            i += run_cells
            j += run_cells
            run, run_first, run_cells = next_run(known, run)
        elif a < END:
            i = ~a
        elif b < END:
            j = ~b
        else:
            running = a != END or b != END
            cell = wp.int64(wp.min(wp.uint64(a), wp.uint64(b)))  # the end comes last
            next_block = cell >> wp.int64(12)
            if next_block != block:
                if block_delta != 0:
                    block_counts[block] = wp.uint16(wp.int32(block_counts[block]) + block_delta)
                    group_delta += wp.int64(block_delta)
                    block_delta = wp.int32(0)
                if (next_block >> wp.int64(6)) != (block >> wp.int64(6)):
                    if group_delta != wp.int64(0):
                        add_above(block >> wp.int64(6), group_delta, upper_counts, level_start)
                        group_delta = wp.int64(0)
                block = next_block
            if running:
                if b == cell:
                    block_delta -= 1
                    j += one
                if a == cell:
                    block_delta += 1
                    i += one
                changed += one  # what is the same has been passed above
    changed_cells[0] = changed
