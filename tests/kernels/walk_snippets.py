# SPDX-License-Identifier: GPL-3.0-or-later
"""A kernel that passes the walk's snippets: test_unchecked.py compiles it with kernels/unchecked.py and checked.py."""

import warp as wp

from ..unchecked import copy_codes, copy_items, item_at, place_legs, put


@wp.kernel
def pass_all(
    count: wp.int32,
    codes: wp.array(dtype=wp.uint16),
    numbers: wp.array(dtype=wp.int32),
    entries: wp.array(dtype=wp.int64),
    heights: wp.array(dtype=wp.float32),
    pairs: wp.array(dtype=wp.vec2i),
    corners: wp.array(dtype=wp.vec4i),
):
    """Write entries 2 * count .. 3 * count - 1 of every array one by one from those before, then further ones in rows.

    Arrays have 6 * count entries.
    """
    for k in range(count):
        to = wp.int64(2 * count + k)
        put(codes, to, item_at(codes, wp.int64(k)) + wp.uint16(k))
        put(numbers, to, item_at(numbers, k) - k)
        put(entries, to, item_at(entries, k) + wp.int64(item_at(numbers, k + 1)))
        heights[2 * count + k] = item_at(heights, wp.int64(k)) * wp.float32(k)
        put(pairs, to, item_at(pairs, wp.int64(k)) + wp.vec2i(k, -k))
        put(corners, 2 * count + k, item_at(corners, k) + wp.vec4i(k, 1, 2, -k))
    row = wp.int64(3 * count + 1)
    copy_codes(codes, wp.int64(3), count, wp.uint16(0x4000), codes, row)
    place_legs(pairs, 5, count, wp.vec2i(7, -9), wp.vec2i(-16, 4), wp.vec2i(8, 32), 3, pairs, row)
    row = wp.int64(5 * count)
    first = wp.int64(2)
    copy_codes(codes, first, count - 1, wp.uint16(0), codes, row)
    copy_items(pairs, first, count - 1, pairs, row)
    copy_items(entries, first, count - 1, entries, row)
    copy_items(entries, first, count, entries, wp.int64(1))  # parts overlap
    copy_items(entries, wp.int64(0), count, entries, first)
