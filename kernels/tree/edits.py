# SPDX-License-Identifier: GPL-3.0-or-later
"""Edits of single nodes.

Setting the bit of the first deepest cell of its second child splits a node, and clearing it merges the node (Dupuy
2020, section 3.3).

`words`, `stored` and `pages` of the bitfield t have an entry for each slot: a word of 64 bits, the mask of its bits
below which there is another word, and the page of 64 slots that holds those words. A word of level L has a bit for each
64^L deepest cells.
"""

import warp as wp

from .atomic import fetch_and, fetch_or, highest_bit
from .bitfield import ONE, REPEATS, ROOT, Bitfield, bit_of, cells_of_bit, mark_changed, page_below


@wp.func
def second_half(t: Bitfield, heap_id: wp.uint64) -> wp.uint64:
    """Return the first deepest cell of the second child of node `heap_id`; its bit is set if the node is split."""
    shift = wp.uint64(t.max_depth - 1 - highest_bit(heap_id))
    return ((wp.uint64(2) * heap_id + ONE) << shift) - (ONE << wp.uint64(t.max_depth))


@wp.func
def split(t: Bitfield, heap_id: wp.uint64) -> wp.bool:
    """Split node `heap_id`; return whether it was split already, by another thread or an earlier kernel.

    Threads may split one node at once, and nodes below it. If the pool of pages is full, which sets state[IS_FULL], the
    node may be split in part and the result is meaningless: repeat the kernel with a larger pool.
    """
    cell = second_half(t, heap_id)
    slot = wp.int32(ROOT)
    level = t.top
    old_bits = wp.uint64(0)
    mask = wp.uint64(0)
    goes_deeper = wp.bool(True)
    while goes_deeper:
        bit = bit_of(cell, level)
        mask = ONE << wp.uint64(bit)
        mark_changed(t, slot, level)
        # A word that was not stored stands for one leaf, which begins at its first bit: that is set with the word.
        old_bits = fetch_or(t.words, slot, mask | ONE)
        # If the cell is not the first of the bit's part, a word below has a bit for it, too.
        goes_deeper = (cell & (cells_of_bit(level) - ONE)) != wp.uint64(0)
        if goes_deeper:
            fetch_or(t.stored, slot, mask)
            page = page_below(t, slot)
            slot = 64 * page + bit
            level -= 1
            goes_deeper = page > 0  # 0: the pool is full
    # A repeated kernel finds its own bits, and has to do all its work again.
    return (old_bits & mask) != wp.uint64(0) and t.state[REPEATS] == 0


@wp.func
def merge(t: Bitfield, heap_id: wp.uint64):
    """Merge the children of node `heap_id`, which must be leaves. Several threads may merge the same node.

    Words and pages that are not needed any more are freed by the next sum reduction.
    """
    cell = second_half(t, heap_id)
    slot = wp.int32(ROOT)
    level = t.top
    while (cell & (cells_of_bit(level) - ONE)) != wp.uint64(0):  # a word below has the bit, too
        mark_changed(t, slot, level)
        slot = 64 * t.pages[slot] + bit_of(cell, level)
        level -= 1
    mark_changed(t, slot, level)
    fetch_and(t.words, slot, ~(ONE << wp.uint64(bit_of(cell, level))))


@wp.kernel
def split_leaves(offset: wp.int32, t: Bitfield, ids: wp.array(dtype=wp.uint64)):
    """Split leaf ids[offset + tid]; all leaves of a launch are different."""
    split(t, ids[offset + wp.tid()])


@wp.kernel
def merge_leaves(offset: wp.int32, t: Bitfield, ids: wp.array(dtype=wp.uint64)):
    """Merge the children of node ids[offset + tid], which must be leaves."""
    merge(t, ids[offset + wp.tid()])
