# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels of the concurrent binary tree: the sum reduction above the words of the bitfield that changed."""

import warp as wp

wp.set_module_options({"enable_backward": False})

# Index of the word that ends a stream: no word of a bitfield has it.
END_INDEX = 2**63 - 1
END = wp.constant(wp.int64(END_INDEX))


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
):
    """Merge two streams of nonzero words, each ascending and ended by `END`, and sum again above the words that differ.

    One serial thread; the counters above 64 blocks are touched once, when the merge has passed their last changed word.
    """
    one = wp.int64(1)
    i = wp.int64(0)
    j = wp.int64(0)
    changed = wp.int64(0)
    block = wp.int64(0)
    block_delta = wp.int32(0)
    group_delta = wp.int64(0)
    running = wp.bool(True)
    while running:
        # The words that stay are most of them.
        while new_index[i] == old_index[j] and new_bits[i] == old_bits[j] and new_index[i] != END:
            i += one
            j += one
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
