# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the concurrent binary tree: the sum reduction above the words of the bitfield that changed."""

import warp as wp

from .unchecked import count_same_words

wp.set_module_options({"enable_backward": False})

# A stream of words lies in parts. After each comes an entry with this index, which no word has, and for bits the first
# entry of the next part, 0 after the last; such an entry is the stream's first one if no part begins there.
END_INDEX = 2**63 - 1
END = wp.constant(wp.int64(END_INDEX))


@wp.struct
class Run:
    """What lies in one row in two streams, words or points."""

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
    """The run after entry `run` (-1: the first): entry, first word in the new stream (-1: there is none) and words."""
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
    new_index: wp.array(dtype=wp.int64),
    new_bits: wp.array(dtype=wp.uint64),
    old_index: wp.array(dtype=wp.int64),
    old_bits: wp.array(dtype=wp.uint64),
    block_counts: wp.array(dtype=wp.uint16),
    upper_counts: wp.array(dtype=wp.int64),
    level_start: wp.array(dtype=wp.int64),
    changed_words: wp.array(dtype=wp.int64),
    known: Runs,
):
    """Merge two streams of nonzero words, each ascending, and sum again above the words that differ.

    One serial thread; the counters above 64 blocks are touched once, when the merge has passed their last changed word.
    Words of a `known` run are not read: because both streams ascend, the old one is at the run's first word there if it
    has the new one's.
    """
    one = wp.int64(1)
    i = wp.int64(0)
    j = wp.int64(0)
    changed = wp.int64(0)
    block = wp.int64(0)
    block_delta = wp.int32(0)
    group_delta = wp.int64(0)
    run, run_first, run_words = next_run(known, wp.int64(-1))
    running = wp.bool(True)
    while running:
        # The words that stay are most of them.
        same = count_same_words(new_index, new_bits, i, run_first, old_index, old_bits, j, END)
        i += same
        j += same
        if i == run_first and new_index[i] == old_index[j]:
            i += run_words
            j += run_words
            run, run_first, run_words = next_run(known, run)
        elif new_index[i] == END and new_bits[i] != wp.uint64(0):
            i = wp.int64(new_bits[i])
        elif old_index[j] == END and old_bits[j] != wp.uint64(0):
            j = wp.int64(old_bits[j])
        else:
            word = wp.min(new_index[i], old_index[j])
            running = word != END
            next_block = word >> wp.int64(6)
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
                if old_index[j] == word:
                    block_delta -= wp.int32(wp.bit_count(old_bits[j]))
                    j += one
                if new_index[i] == word:
                    block_delta += wp.int32(wp.bit_count(new_bits[i]))
                    i += one
                changed += one
    changed_words[0] = changed
