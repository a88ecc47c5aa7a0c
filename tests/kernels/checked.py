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
def byte_at(a: wp.array(dtype=wp.uint8), i: wp.int64) -> wp.uint8:
    return a[i]


@wp.func
def pair_at(a: wp.array(dtype=wp.vec2i), i: wp.int64) -> wp.vec2i:
    return a[i]


@wp.func
def prefetch(a: wp.array(dtype=wp.float32), i: wp.int64):
    pass


@wp.func
def prefetch_byte(a: wp.array(dtype=wp.uint8), i: wp.int64):
    pass


@wp.func
def prefetch_code(a: wp.array(dtype=wp.uint16), i: wp.int64):
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
def put_cell(a: wp.array(dtype=wp.int64), i: wp.int64, value: wp.uint64):
    a[i] = wp.int64(value)


@wp.func
def number_cells(cells: wp.array(dtype=wp.int64), at: wp.int64, count: wp.int32, first: wp.uint64, step: wp.uint64):
    for k in range(count):
        cells[at + wp.int64(k)] = wp.int64(first + wp.uint64(k) * step)


@wp.func
def copy_cells(
    cells: wp.array(dtype=wp.int64), first: wp.int64, count: wp.int32, out: wp.array(dtype=wp.int64), at: wp.int64
):
    for k in range(count):
        out[at + wp.int64(k)] = cells[first + wp.int64(k)]
