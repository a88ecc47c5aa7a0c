# SPDX-License-Identifier: GPL-3.0-or-later
"""The sum reduction: the counters of changed words, from the lowest level up.

`words`, `stored`, `counts` and `pages` of the bitfield t have an entry for each slot: a word of 64 bits, the mask of
its bits below which there is another word, the number of leaves in it less 1, and the page of 64 slots that holds the
words below. `changed` lists the changed words as level << LEVEL_SHIFT | slot, and state[NUM_CHANGED] is their number.
"""

import warp as wp

from .atomic import count_bits
from .bitfield import LEVEL_SHIFT, NUM_CHANGED, ONE, ROOT, Bitfield


@wp.func_native("int sum = 0; for (int k = 0; k < 64; ++k) sum += counts.data[first + k]; return sum;")
def sum_page(counts: wp.array(dtype=wp.int32), first: wp.int32) -> wp.int32:
    """Return the sum of the 64 counters of a page, from counts[first] on."""
    ...


@wp.func_native(
    "wp::uint64 stored = 0; for (int k = 0; k < 64; ++k) stored |= (wp::uint64)(words.data[first + k] != 0) << k; "
    "return stored;"
)
def stored_words(words: wp.array(dtype=wp.uint64), first: wp.int32) -> wp.uint64:
    """Return a bit for each of the 64 words of a page, from words[first] on: 1 if the word is not 0."""
    ...


@wp.func
def sum_word(t: Bitfield, slot: wp.int32):
    """Update the number of leaves and the mask of the word in `slot` from the words below; free it if it has one leaf.

    t.stored: which bits of the word have a word below. A word with only its first bit set has one leaf.
    """
    bits = t.words[slot]
    below = 64 * t.pages[slot]
    t.stored[slot] = stored_words(t.words, below)
    t.counts[slot] = count_bits(bits) - 1 + sum_page(t.counts, below)
    if bits == ONE and slot != ROOT:
        t.words[slot] = wp.uint64(0)
        t.pages[slot] = 0


@wp.kernel
def reduce_level(offset: wp.int32, t: Bitfield, level: wp.int32):
    """Sum entry `offset + tid` of the list of changed words again if it is of this level.

    Lower levels are summed before, by earlier launches. The caller empties the list at the end.
    """
    entry = t.changed[offset + wp.tid()]
    if wp.int32(wp.uint32(entry) >> wp.uint32(LEVEL_SHIFT)) == level:
        sum_word(t, entry & ((1 << LEVEL_SHIFT) - 1))


@wp.kernel
def reduce_words(t: Bitfield):
    """Sum all changed words again, level by level, on one thread, and empty their list: for few words."""
    for level in range(t.top + 1):
        for k in range(t.state[NUM_CHANGED]):
            entry = t.changed[k]
            if wp.int32(wp.uint32(entry) >> wp.uint32(LEVEL_SHIFT)) == level:
                sum_word(t, entry & ((1 << LEVEL_SHIFT) - 1))
    t.state[NUM_CHANGED] = 0
