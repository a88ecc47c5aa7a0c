# SPDX-License-Identifier: GPL-3.0-or-later
"""kernels/unchecked.py in Warp alone: what each of its snippets stands for, index checks and all."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def height_at(a: wp.array(dtype=wp.float32), i: wp.int64) -> wp.float32:
    return a[i]


@wp.func
def code_at(a: wp.array(dtype=wp.uint16), i: wp.int64) -> wp.uint16:
    return a[i]


@wp.func
def pair_at(a: wp.array(dtype=wp.vec2i), i: wp.int64) -> wp.vec2i:
    return a[i]


@wp.func
def prefetch(a: wp.array(dtype=wp.float32), i: wp.int64):
    pass


@wp.func
def prefetch_range(a: wp.array(dtype=wp.uint16), i: wp.int64):
    pass


@wp.func
def put_code(a: wp.array(dtype=wp.uint16), i: wp.int64, value: wp.uint16):
    a[i] = value


@wp.func
def put_corners(a: wp.array(dtype=wp.vec4i), i: wp.int32, value: wp.vec4i):
    a[i] = value


@wp.func
def corners_at(a: wp.array(dtype=wp.vec4i), i: wp.int32) -> wp.vec4i:
    return a[i]


@wp.func
def number_at(a: wp.array(dtype=wp.int32), i: wp.int32) -> wp.int32:
    return a[i]


@wp.func
def limits_at(a: wp.array(dtype=wp.vec3d), i: wp.int32) -> wp.vec3d:
    return a[i]


@wp.func
def put_word(
    index: wp.array(dtype=wp.int64), bits: wp.array(dtype=wp.uint64), i: wp.int64, word: wp.int64, value: wp.uint64
):
    index[i] = word
    bits[i] = value


@wp.func
def entry_at(a: wp.array(dtype=wp.int64), i: wp.int32) -> wp.int64:
    return a[i]


@wp.func
def put(a: wp.array(dtype=wp.int32), i: wp.int64, value: wp.int32):
    a[i] = value


@wp.func
def put_pair(a: wp.array(dtype=wp.vec2i), i: wp.int64, value: wp.vec2i):
    a[i] = value


@wp.func
def packed_at(a: wp.array(dtype=wp.vec2i), i: wp.int64) -> wp.int64:
    return (wp.int64(a[i][0]) & wp.int64(0xFFFFFFFF)) | (wp.int64(a[i][1]) << wp.int64(32))


@wp.func
def put_packed(a: wp.array(dtype=wp.vec2i), i: wp.int64, pair: wp.int64):
    a[i] = wp.vec2i(wp.int32(pair), wp.int32(pair >> wp.int64(32)))


@wp.func
def put_vec3(a: wp.array(dtype=wp.vec3f), i: wp.int32, value: wp.vec3f):
    a[i] = value


@wp.func
def put_vec2(a: wp.array(dtype=wp.vec2f), i: wp.int32, value: wp.vec2f):
    a[i] = value


@wp.func
def number_row(out: wp.array(dtype=wp.int32), at: wp.int32, count: wp.int32, first: wp.int32, step: wp.int32):
    for k in range(count):
        out[at + k] = first + step * k


@wp.func
def look_up(
    places: wp.array(dtype=wp.int32),
    row: wp.int32,
    count: wp.int32,
    numbers: wp.array(dtype=wp.int32),
    first: wp.int32,
    out: wp.array(dtype=wp.int32),
    at: wp.int32,
):
    for k in range(count):
        out[at + k] = numbers[first + places[row + k]]


@wp.func
def look_up_pairs(
    places: wp.array(dtype=wp.int32),
    count: wp.int32,
    numbers: wp.array(dtype=wp.int32),
    first: wp.int32,
    out: wp.array(dtype=wp.vec2i),
    at: wp.int32,
):
    for k in range(count):
        out[at + k] = wp.vec2i(numbers[first + places[2 * k]], numbers[first + places[2 * k + 1]])


@wp.func
def copy_codes(
    table: wp.array(dtype=wp.uint16),
    first: wp.int64,
    count: wp.int32,
    extra: wp.uint16,
    out: wp.array(dtype=wp.uint16),
    at: wp.int64,
):
    for k in range(count):
        out[at + wp.int64(k)] = table[first + wp.int64(k)] | extra


@wp.func
def place_legs(
    legs: wp.array(dtype=wp.vec2i),
    first: wp.int32,
    count: wp.int32,
    apex: wp.vec2i,
    left: wp.vec2i,
    right: wp.vec2i,
    bits: wp.int32,
    out: wp.array(dtype=wp.vec2i),
    at: wp.int64,
):
    for k in range(count):
        leg = legs[first + k]
        x = apex[0] + ((leg[0] * left[0] + leg[1] * right[0]) >> bits)
        y = apex[1] + ((leg[0] * left[1] + leg[1] * right[1]) >> bits)
        out[at + wp.int64(k)] = wp.vec2i(x, y)


@wp.func
def put_eight(
    table: wp.array(dtype=wp.uint16),
    first: wp.int32,
    flip: wp.uint16,
    more: wp.uint16,
    out: wp.array(dtype=wp.uint16),
    at: wp.int64,
):
    for k in range(8):
        out[at + wp.int64(k)] = (table[first + wp.int32(k)] ^ flip) + more


@wp.func
def place_eight(
    legs: wp.array(dtype=wp.vec2i),
    first: wp.int32,
    apex: wp.vec2i,
    left: wp.vec2i,
    right: wp.vec2i,
    out: wp.array(dtype=wp.vec2i),
    at: wp.int64,
):
    place_legs(legs, first, 8, apex, left, right, 2, out, at)


@wp.func
def number_starts(
    indices: wp.array(dtype=wp.int64),
    words: wp.array(dtype=wp.uint64),
    at: wp.int64,
    first: wp.int64,
    size_bits: wp.int32,
    starts: wp.int32,
) -> wp.int32:
    n = wp.int32(0)
    bits = wp.uint64(0)
    k = wp.int32(0)
    while k < 8:
        cell = k << (size_bits - 3)
        after = (k + 1) << (size_bits - 3)
        if (starts >> k) & 1 == 1:
            bits = bits | (wp.uint64(1) << wp.uint64(cell & 63))
        if (after >> 6) > (cell >> 6):
            indices[at + wp.int64(n)] = first + wp.int64(cell >> 6)
            words[at + wp.int64(n)] = wp.where(size_bits < 9, bits, wp.uint64(1))
            if bits != wp.uint64(0):
                n += 1
            bits = wp.uint64(0)
        k += 1
    return n


@wp.func
def spread_starts(starts: wp.int32, size_bits: wp.int32) -> wp.uint64:
    bits = wp.uint64(0)
    for k in range(8):
        if (starts >> wp.int32(k)) & 1 == 1:
            bits = bits | (wp.uint64(1) << wp.uint64((k << size_bits) >> 3))
    return bits


@wp.func
def copy_points(
    points: wp.array(dtype=wp.vec2i), first: wp.int64, count: wp.int32, out: wp.array(dtype=wp.vec2i), at: wp.int64
):
    for k in range(count):
        out[at + wp.int64(k)] = points[first + wp.int64(k)]


@wp.func
def copy_vec3s(
    vectors: wp.array(dtype=wp.vec3f), first: wp.int64, count: wp.int32, out: wp.array(dtype=wp.vec3f), at: wp.int32
):
    for k in range(count):
        out[at + k] = vectors[first + wp.int64(k)]


@wp.func
def copy_vec2s(
    vectors: wp.array(dtype=wp.vec2f), first: wp.int64, count: wp.int32, out: wp.array(dtype=wp.vec2f), at: wp.int32
):
    for k in range(count):
        out[at + k] = vectors[first + wp.int64(k)]


@wp.func
def copy_words(
    indices: wp.array(dtype=wp.int64),
    words: wp.array(dtype=wp.uint64),
    first: wp.int64,
    count: wp.int32,
    out: wp.array(dtype=wp.int64),
    out_bits: wp.array(dtype=wp.uint64),
    at: wp.int64,
):
    for k in range(count):
        out[at + wp.int64(k)] = indices[first + wp.int64(k)]
        out_bits[at + wp.int64(k)] = words[first + wp.int64(k)]


@wp.func
def count_same_words(
    indices: wp.array(dtype=wp.int64),
    words: wp.array(dtype=wp.uint64),
    i: wp.int64,
    stop: wp.int64,
    old_indices: wp.array(dtype=wp.int64),
    old_words: wp.array(dtype=wp.uint64),
    j: wp.int64,
    end: wp.int64,
) -> wp.int64:
    k = wp.int64(0)
    while i + k != stop and indices[i + k] == old_indices[j + k] and indices[i + k] != end:
        if words[i + k] != old_words[j + k]:
            break
        k += wp.int64(1)
    return k


@wp.func
def number_words(
    indices: wp.array(dtype=wp.int64),
    words: wp.array(dtype=wp.uint64),
    at: wp.int64,
    count: wp.int32,
    first: wp.int64,
    step: wp.int64,
    bits: wp.uint64,
):
    for k in range(count):
        indices[at + wp.int64(k)] = first + wp.int64(k) * step
        words[at + wp.int64(k)] = bits
