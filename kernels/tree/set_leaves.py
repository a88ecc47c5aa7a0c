# SPDX-License-Identifier: GPL-3.0-or-later
"""Replacement of all leaves at once, in the order of the curve, as a refinement does.

A word of the bitfield t has 64 bits; at level L each stands for 64^L deepest cells, and is set if a leaf begins there.
`words`, `stored`, `counts` and `pages` have an entry for each slot: a word, the mask of its bits below which there is
another word, its number of leaves less 1, and the page of 64 slots that holds the words below.

A *run* is the leaves of one part of the curve. Its `same` lists nodes below which the tree already has the same leaves:
their bits are copied.
"""

import warp as wp

from ..unchecked import item_at, put
from .atomic import count_bits, fetch_xor, highest_bit, lowest_bit
from .bitfield import (
    ALL_BITS,
    DIFFERS,
    MAX_DEPTH,
    ONE,
    ROOT,
    WORD_BITS,
    Bitfield,
    SameLeaves,
    bit_of,
    bits_below,
    cells_of_bit,
    mark_changed,
    page_below,
)

LEVELS = (MAX_DEPTH - 1) // 6 + 1  # of words in the deepest tree
SlotPath = wp.types.vector(length=LEVELS, dtype=wp.int32)
BitPath = wp.types.vector(length=LEVELS, dtype=wp.uint64)


@wp.struct
class LeafRun:
    """Consecutive leaves by their depths; `set_leaves` writes a run a thread."""

    codes: wp.array(dtype=wp.uint16)  # a leaf's depth is in the bits `shift` .. `shift` + 5
    first: wp.int64  # entry of the first leaf in `codes`
    count: wp.int64  # number of leaves
    shift: wp.int32
    cell_depth: wp.int32  # depth of a deepest cell: a node of depth d has 2^(cell_depth - d) of them
    start: wp.uint64  # deepest cells start .. end - 1 are those of the run
    end: wp.uint64
    same: wp.array(dtype=SameLeaves)  # nodes whose leaves are those that the tree has, ascending
    first_same: wp.int64  # entries first_same .. end_same - 1 of `same` are in the run
    end_same: wp.int64


@wp.func
def log2_size_of(run: LeafRun, k: wp.int64) -> wp.int32:
    """Return log2 of the number of deepest cells of leaf k of a run."""
    return run.cell_depth - ((wp.int32(item_at(run.codes, run.first + k)) >> run.shift) & 63)


@wp.func
def first_of_same(run: LeafRun, same: wp.int64) -> wp.int64:
    """Return the number in the run of the first leaf below node run.same[same]; `run.count` beyond the run's nodes."""
    first = run.count
    if same < run.end_same:
        first = run.same[same].first - run.first
    return first


@wp.func_native(
    "const wp::uint16* code = codes.data + first; wp::uint64 bits = 0; "
    "for (wp::int64 k = 0; k < count && bit < 64; ++k) { int size = deepest - ((code[k] >> shift) & 63); "
    "if (size < 0) break; bits |= 1ull << bit; bit += 1 << size; } return bits;"
)
def fill_word(
    codes: wp.array(dtype=wp.uint16),
    first: wp.int64,
    count: wp.int64,
    shift: wp.int32,
    deepest: wp.int32,
    bit: wp.int32,
) -> wp.uint64:
    """Return the bits that leaves set in a word from `bit` on, up to its end or the first leaf of a lower level.

    codes, first, count: the leaves; a depth is in the bits `shift` .. `shift` + 5 of a code. A leaf of depth d sets one
    bit and takes 2^(deepest - d) of them. deepest: depth of a leaf that takes one bit.
    """
    ...


@wp.func_native("""
    const wp::uint16* code = codes.data + first;
    wp::int64 k = 0;
    int filled = 0;
    bool differs = false;
    for (int slot = first_slot; bit + filled < 64 && k + 64 <= readable && !pages.data[slot]; ++slot) {
        wp::uint64 bits = 0;
        const wp::uint16* next = code + k;
        for (int at = 0; at < 64; ++next) {
            int size = deepest - ((*next >> shift) & 63);
            if (size < 0 || size > 5) goto end;
            bits |= 1ull << at;
            at += 1 << size;
        }
        const int leaves = next - code - k;
        if (k + leaves > count) goto end;
        if (words.data[slot] != bits) {
            words.data[slot] = bits;
            differs = true;
        }
        counts.data[slot] = leaves - 1;
        k += leaves;
        ++filled;
    }
end:
    if (differs) state.data[3] = 1;  // DIFFERS
    return k << 8 | filled;
""")
def fill_words(
    codes: wp.array(dtype=wp.uint16),
    first: wp.int64,
    count: wp.int64,
    readable: wp.int64,
    shift: wp.int32,
    deepest: wp.int32,
    bit: wp.int32,
    first_slot: wp.int32,
    words: wp.array(dtype=wp.uint64),
    counts: wp.array(dtype=wp.int32),
    pages: wp.array(dtype=wp.int32),
    state: wp.array(dtype=wp.int32),
) -> wp.int64:
    """Store the whole words of one level below the bits of a word from `bit` on.

    It ends at a leaf of another level, at the last leaf, and at a word with words below it, which have to be freed.
    Return the number of leaves << 8 | the number of words. codes, first, count: the leaves; a depth is in the bits
    `shift` .. `shift` + 5 of a code. readable: leaves that may be read, at least `count`; a word has up to 64, which
    are read before they are counted. deepest: depth of a leaf that takes one bit of these words. first_slot: slot of
    the first of them. words, counts, pages, state: arrays of the bitfield; state[DIFFERS] is set if a word changes.
    """
    ...


@wp.func
def fill_below(
    t: Bitfield, run: LeafRun, level: wp.int32, page: wp.int32, bit: wp.int32, k: wp.int64, next_same: wp.int64
):
    """Store the whole words below the bits of a word of `level` from `bit` on; return their leaves, and how many words.

    page: that of the words. k: leaf of the run with which they begin. next_same: leaf at which they end at the latest.
    """
    first = run.first + k
    count = next_same - k
    readable = run.count - k
    bit_depth = run.cell_depth - WORD_BITS * (level - 1)  # of a leaf that takes one bit of these words
    slot = 64 * page + bit
    packed = fill_words(
        run.codes, first, count, readable, run.shift, bit_depth, bit, slot, t.words, t.counts, t.pages, t.state
    )
    return packed >> wp.int64(8), wp.int32(packed & wp.int64(255))


@wp.func
def close_word(
    t: Bitfield,
    run: LeafRun,
    slot: wp.int32,
    level: wp.int32,
    end: wp.uint64,
    bits: wp.uint64,
    entered: wp.uint64,
    num_leaves: wp.int64,
):
    """Store `bits` as the word in `slot`, of a level, after a run has passed it.

    entered: its bits below which a word is stored; the words below other bits are freed. end: the deepest cell after
    the run's last one in the word. num_leaves: leaves of the run in the word. A word that runs share is not
    overwritten: each run flips only its bits, and the word is counted afterwards.
    """
    bit_shift = wp.uint64(WORD_BITS * level)
    word_shift = wp.uint64(wp.min(WORD_BITS * (level + 1), 63))  # above all cells at the highest word
    word_start = ((end - ONE) >> word_shift) << word_shift
    word_cells = ONE << wp.uint64(wp.min(t.max_depth, WORD_BITS * level + WORD_BITS))
    run_bits = ALL_BITS  # bits whose first cell is the run's
    old_bits = item_at(t.words, slot)
    old_stored = item_at(t.stored, slot)
    if word_start >= run.start and word_start + word_cells <= run.end:  # the whole word is the run's
        if old_bits != bits or old_stored != entered:
            put(t.words, slot, bits)
            put(t.stored, slot, entered)
            t.state[DIFFERS] = 1
        put(t.counts, slot, wp.int32(num_leaves) - 1)
    else:
        # Runs share the word.
        last_of_bit = (ONE << bit_shift) - ONE  # rounds up to the next bit's first cell
        if run.start > word_start:
            run_bits = ~bits_below(wp.int32((run.start - word_start + last_of_bit) >> bit_shift))
        if run.end < word_start + word_cells:
            run_bits = run_bits & bits_below(wp.int32((run.end - word_start + last_of_bit) >> bit_shift))
        if (((old_bits ^ bits) | (old_stored ^ entered)) & run_bits) != wp.uint64(0):
            fetch_xor(t.words, slot, (old_bits ^ bits) & run_bits)
            fetch_xor(t.stored, slot, (old_stored ^ entered) & run_bits)
            t.state[DIFFERS] = 1
        mark_changed(t, slot, level)
    freed = old_stored & ~entered & run_bits
    while freed != wp.uint64(0):
        below = 64 * t.pages[slot] + lowest_bit(freed)
        t.words[below] = wp.uint64(0)
        t.stored[below] = wp.uint64(0)
        t.counts[below] = 0
        t.pages[below] = 0  # the words below are out of reach, and their page is lost until the tree is cleared
        freed = freed & (freed - ONE)


@wp.kernel
def set_leaves(t: Bitfield, run: LeafRun):
    """Make the leaves of a run those of the tree: along the curve, down and up between the levels of words.

    Each turn stores whole words of a level, or copies the bits of a node whose leaves are the same, or fills a word up
    to its end or a smaller leaf. The kernel ends early if the pool has no page left, which sets state[IS_FULL]: clear
    the tree, and repeat with a larger pool. Words that runs share are only listed as changed, and are summed
    afterwards.
    """
    slots = SlotPath()  # of the words that are open, by level
    bits = BitPath()
    entered = BitPath()  # bits below which there are words
    before = BitPath()  # leaves of the run before the word
    level = t.top  # of the lowest open word
    slots[level] = ROOT
    cell = run.start  # first deepest cell that is not written yet
    k = wp.int64(0)  # leaf that begins there, by its number in the run
    same = run.first_same
    next_same = first_of_same(run, same)
    while k < run.count:
        log2_size = log2_size_of(run, k)
        if k == next_same:  # a node whose leaves the tree has already
            log2_size = run.cell_depth - run.same[same].depth
        num_filled = wp.int32(0)
        if level > 0 and log2_size < WORD_BITS * level and log2_size >= WORD_BITS * (level - 1):
            if (cell & (cells_of_bit(level) - ONE)) == wp.uint64(0) and k < next_same:
                # Whole words of the next level: its leaves take bits of them, and the first begins at a word's start.
                page = page_below(t, slots[level])
                if page == 0:  # the pool is full
                    return
                bit = bit_of(cell, level)
                num_leaves, num_filled = fill_below(t, run, level, page, bit, k, next_same)
                filled_bits = bits_below(bit + num_filled) & ~bits_below(bit)
                bits[level] = bits[level] | filled_bits
                entered[level] = entered[level] | filled_bits
                k += num_leaves
                cell += wp.uint64(num_filled) << wp.uint64(WORD_BITS * level)
        if num_filled == 0:
            # Down, until a leaf, or a node whose leaves are the same, is not smaller than a bit.
            while log2_size < WORD_BITS * level:
                bit = bit_of(cell, level)
                bits[level] = bits[level] | (ONE << wp.uint64(bit))
                entered[level] = entered[level] | (ONE << wp.uint64(bit))
                page = page_below(t, slots[level])
                if page == 0:  # the pool is full
                    return
                level -= 1
                slots[level] = 64 * page + bit
                bits[level] = wp.uint64(0)
                entered[level] = wp.uint64(0)
                before[level] = wp.uint64(k)
            # Along the word.
            bit = bit_of(cell, level)
            if k == next_same:
                same_bits = bits_below(bit + (1 << (log2_size - WORD_BITS * level))) & ~bits_below(bit)
                bits[level] = bits[level] | (item_at(t.words, slots[level]) & same_bits)
                entered[level] = entered[level] | (item_at(t.stored, slots[level]) & same_bits)
                cell += ONE << wp.uint64(log2_size)
                k += wp.int64(run.same[same].count)
                same += wp.int64(1)
                next_same = first_of_same(run, same)
            else:
                bit_depth = run.cell_depth - WORD_BITS * level
                word = fill_word(run.codes, run.first + k, next_same - k, run.shift, bit_depth, bit)
                bits[level] = bits[level] | word
                k += wp.int64(count_bits(word))
                cell += wp.uint64(highest_bit(word) - bit) << wp.uint64(WORD_BITS * level)
                cell += ONE << wp.uint64(log2_size_of(run, k - wp.int64(1)))
        # Up, out of the words that end here.
        while level < t.top and (cell & (cells_of_bit(level + 1) - ONE)) == wp.uint64(0):
            close_word(t, run, slots[level], level, cell, bits[level], entered[level], k - wp.int64(before[level]))
            level += 1
    while level <= t.top:
        close_word(t, run, slots[level], level, cell, bits[level], entered[level], k - wp.int64(before[level]))
        level += 1
