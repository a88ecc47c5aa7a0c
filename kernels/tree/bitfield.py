# SPDX-License-Identifier: GPL-3.0-or-later
"""The bitfield of a concurrent binary tree, stored by use, and the sum reduction above it (Dupuy 2020, section 3).

The paper's bitfield has a bit for each *deepest cell*, a node of the deepest level; they are numbered along the curve,
from 0. A leaf sets the bit of its first cell. At depth 40 that is 128 GiB. Here the bits are the leaves of a tree of
64-bit words with a fan-out of 64: a word of level L stands for 64^(L + 1) cells, each of its bits for a part of 64^L
cells, and a bit is set if a leaf begins in its part. A leaf of 2^j cells always sets the first bit of its part on level
j // 6, so a word whose first bit alone is set says no more than the bit above it, and is not stored: every stored word
has two bits or more, and there are fewer words than leaves.

The words below a word lie together in a *page* of 64, which is taken from a pool when the first is stored. Beside each
word stands a mask of the bits below which a word is stored, and its counter: the leaves that begin in the word, without
the first, which the bit above it counts. So a counter is a population count and a sum over a page, and a slot that
stores no word adds 0 to it. `t` is the tree's Bitfield.
"""

import warp as wp

from ..unchecked import item_at
from .atomic import compare_exchange, fetch_add, highest_bit, lowest_bit

# Of a tree. Its heap ids have 63 bits, so an order about one has a bit more (kernels/refine/split_merge.py).
MAX_DEPTH = 62
WORD_BITS = wp.constant(6)  # log2 of the bits of a word
ROOT = wp.constant(64)  # slot of the highest word; page 0 stays empty, and words without a page refer to it
CHANGED = wp.constant(-1)  # in place of a counter that has to be summed again
LEVEL_SHIFT = wp.constant(28)  # of a word's level in the list of changed words
# Entries of `state`.
PAGES_USED = wp.constant(0)
NUM_CHANGED = wp.constant(1)  # words in the list
IS_FULL = wp.constant(2)  # 1: a page was needed and the pool had none; repeat the kernel with a larger pool
DIFFERS = wp.constant(3)  # 1: `set_leaves` has changed a bit
REPEATS = wp.constant(4)  # 1: the kernel is repeated, so bits may be its own

ONE = wp.constant(wp.uint64(1))
ALL_BITS = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))


@wp.struct
class Bitfield:
    """The words of a tree. Slot s of page p is entry 64 p + s of the first four arrays."""

    words: wp.array(dtype=wp.uint64)
    stored: wp.array(dtype=wp.uint64)  # bits of a word below which a word is stored
    counts: wp.array(dtype=wp.int32)  # a word's counter: its leaves less 1; or CHANGED
    pages: wp.array(dtype=wp.int32)  # page of the words below a word; 0: none
    changed: wp.array(dtype=wp.int32)  # list of the words to be summed again: level << LEVEL_SHIFT | slot
    state: wp.array(dtype=wp.int32)  # entries PAGES_USED .. REPEATS
    num_pages: wp.int32  # pages in the pool
    max_depth: wp.int32  # depth of the deepest cells
    top: wp.int32  # level of the highest word


@wp.struct
class TreeLeaf:
    """A leaf of the tree."""

    number: wp.int32  # along the curve, from 0
    cell: wp.uint64  # its first deepest cell
    depth: wp.int32


@wp.struct
class SameLeaves:
    """A node whose leaves are those that the tree has already."""

    first: wp.int64  # entry of its first leaf's code
    count: wp.int32
    depth: wp.int32  # of the node, counted as the depths in codes are


@wp.func
def cells_of_bit(level: wp.int32) -> wp.uint64:
    """Return the number of deepest cells that one bit of a word of this level covers."""
    return ONE << wp.uint64(WORD_BITS * level)


@wp.func
def bit_of(cell: wp.uint64, level: wp.int32) -> wp.int32:
    """Return which bit (0 .. 63) of its word of a level covers a deepest cell."""
    return wp.int32((cell >> wp.uint64(WORD_BITS * level)) & wp.uint64(63))


@wp.func
def bits_below(bit: wp.int32) -> wp.uint64:
    """Return the mask with the bits below `bit` (0 .. 64) set."""
    mask = ALL_BITS
    if bit < 64:
        mask = (ONE << wp.uint64(bit)) - ONE
    return mask


@wp.func
def mark_changed(t: Bitfield, slot: wp.int32, level: wp.int32):
    """List a word whose counter has to be summed again, once, whichever thread comes first. level: the word's level.

    The counter is CHANGED from then on, which shows that the word is listed.
    """
    count = t.counts[slot]
    if count != CHANGED:
        if compare_exchange(t.counts, slot, count, CHANGED) == count:  # no other thread was first
            t.changed[fetch_add(t.state, NUM_CHANGED, 1)] = (level << LEVEL_SHIFT) | slot


@wp.func
def page_below(t: Bitfield, slot: wp.int32) -> wp.int32:
    """Return the page of the words below the word in `slot`; allocate one if it has none.

    The result is 0 if the pool is full, which sets `state[IS_FULL]`. Of threads that allocate one at once the first
    wins; the others' pages stay unused.
    """
    page = item_at(t.pages, slot)
    if page == 0:
        page = fetch_add(t.state, PAGES_USED, 1)
        if page < t.num_pages:  # the pool had one
            page_of_other_thread = compare_exchange(t.pages, slot, 0, page)
            if page_of_other_thread != 0:  # another thread was first
                page = page_of_other_thread
        else:
            t.state[IS_FULL] = 1
            page = 0
    return page


# Queries


@wp.func_native(
    "const int* more = counts.data + first; for (;; bits &= bits - 1) { int bit = __builtin_ctzll(bits); "
    "if (number <= more[bit]) return number << 6 | bit; number -= 1 + more[bit]; }"
)
def select_bit(bits: wp.uint64, counts: wp.array(dtype=wp.int32), first: wp.int32, number: wp.int32) -> wp.int64:
    """Return the bit of a word that holds leaf `number`, and the leaf's number within it, as number << 6 | bit.

    bits: the word. number: leaf, counted in the word from 0. counts[first + k]: number of leaves of bit k, less 1.
    """
    ...


@wp.func_native(
    "int sum = __builtin_popcountll(bits & ((1ull << bit) - 1)); "
    "if (first) for (int k = 0; k < bit; ++k) sum += counts.data[first + k]; return sum;"
)
def count_before(bits: wp.uint64, counts: wp.array(dtype=wp.int32), first: wp.int32, bit: wp.int32) -> wp.int32:
    """Return the number of leaves in a word before `bit`.

    bits: the word. first: its page in `counts`, 0 if it has no words below.
    """
    ...


@wp.func
def leaf_of_bit(t: Bitfield, slot: wp.int32, level: wp.int32, bit: wp.int32, cell: wp.uint64, number: wp.int32):
    """Return the leaf that begins at a bit of a word; it ends at the word's next set bit, or at the word's end.

    slot, level: the word's slot and level. cell: the leaf's first deepest cell. number: the leaf's number.
    """
    # The highest word may use fewer than 64 bits. lowest_bit: 64 for no bit, and log2 of a leaf's size in bits.
    next_bit = wp.min(lowest_bit(t.words[slot] & ~bits_below(bit + 1)), 1 << wp.min(t.max_depth - WORD_BITS * level, 6))
    leaf = TreeLeaf()
    leaf.number = number
    leaf.cell = cell
    leaf.depth = t.max_depth - WORD_BITS * level - lowest_bit(wp.uint64(next_bit - bit))
    return leaf


@wp.func
def decode_leaf(t: Bitfield, number: wp.int32) -> TreeLeaf:
    """Return leaf `number`, counted along the curve from 0. The search descends by the counters, in O(depth).

    Changed words must have been summed again (reduction.py), and `number` is below that of all leaves.
    """
    slot = wp.int32(ROOT)
    level = t.top
    cell = wp.uint64(0)
    number_inside = number  # leaf's number in the word
    bit = wp.int32(0)
    goes_deeper = wp.bool(True)
    while goes_deeper:
        below = 64 * item_at(t.pages, slot)
        packed = select_bit(item_at(t.words, slot), t.counts, below, number_inside)
        bit = wp.int32(packed & wp.int64(63))
        number_inside = wp.int32(packed >> wp.int64(6))
        cell = cell + (wp.uint64(bit) << wp.uint64(WORD_BITS * level))
        goes_deeper = ((item_at(t.stored, slot) >> wp.uint64(bit)) & ONE) == ONE
        if goes_deeper:
            slot = below + bit
            level -= 1
    return leaf_of_bit(t, slot, level, bit, cell, number)


@wp.func
def leaf_at(t: Bitfield, cell: wp.uint64) -> TreeLeaf:
    """Return the leaf that contains a deepest cell.

    The search descends to the last set bit at or before the cell, in O(depth). Changed words must have been summed
    again (reduction.py).
    """
    slot = wp.int32(ROOT)
    level = t.top
    number = wp.int32(0)
    bit = wp.int32(0)
    goes_deeper = wp.bool(True)
    while goes_deeper:
        below = 64 * item_at(t.pages, slot)
        bits = item_at(t.words, slot)
        cell_bit = bit_of(cell, level)
        bit = highest_bit(bits & bits_below(cell_bit + 1))
        number += count_before(bits, t.counts, below, bit)
        goes_deeper = bit == cell_bit and ((item_at(t.stored, slot) >> wp.uint64(bit)) & ONE) == ONE
        if goes_deeper:
            slot = below + bit
            level -= 1
    shift = wp.uint64(wp.min(WORD_BITS * (level + 1), 63))  # above all cells at the highest word
    first = ((cell >> shift) << shift) + (wp.uint64(bit) << wp.uint64(WORD_BITS * level))
    return leaf_of_bit(t, slot, level, bit, first, number)


@wp.func
def heap_id_of(t: Bitfield, leaf: TreeLeaf) -> wp.uint64:
    """Return the heap id of a leaf: 1 is the root, n has the children 2n and 2n + 1."""
    return ((ONE << wp.uint64(t.max_depth)) + leaf.cell) >> wp.uint64(t.max_depth - leaf.depth)


@wp.func
def is_leaf(t: Bitfield, heap_id: wp.uint64) -> wp.bool:
    """Return whether the node `heap_id` is a leaf: neither split nor below a leaf."""
    shift = wp.uint64(t.max_depth - highest_bit(heap_id))
    return heap_id_of(t, leaf_at(t, (heap_id << shift) - (ONE << wp.uint64(t.max_depth)))) == heap_id
