# SPDX-License-Identifier: GPL-3.0-or-later
"""kernels/unchecked.py in Warp alone: what each of its snippets stands for, index checks and all."""

from typing import Any

import warp as wp


@wp.func
def item_at(a: wp.array(dtype=Any), i: Any):
    return a[i]


@wp.func
def put(a: wp.array(dtype=Any), i: Any, value: Any):
    a[i] = value


@wp.func
def prefetch(a: wp.array(dtype=Any), i: wp.int64):
    pass


@wp.func
def copy_items(source: wp.array(dtype=Any), first: wp.int64, count: wp.int32, out: wp.array(dtype=Any), at: Any):
    for k in range(count):
        n = wp.int64(wp.where(wp.int64(at) <= first, k, count - 1 - k))  # the parts may overlap
        out[wp.int64(at) + n] = source[first + n]


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
def look_up(  # noqa: F811 (an overload)
    places: wp.array(dtype=wp.int32),
    row: wp.int32,
    count: wp.int32,
    numbers: wp.array(dtype=wp.int32),
    first: wp.int32,
    out: wp.array(dtype=wp.vec2i),
    at: wp.int32,
):
    for k in range(count / 2):
        o = row + 2 * k
        out[at + k] = wp.vec2i(numbers[first + places[o]], numbers[first + places[o + 1]])


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
        down = wp.max(bits - 1, 0)
        x = apex[0] + ((leg[0] * (left[0] >> down) + leg[1] * (right[0] >> down)) >> 1)
        y = apex[1] + ((leg[0] * (left[1] >> down) + leg[1] * (right[1] >> down)) >> 1)
        out[at + wp.int64(k)] = wp.vec2i(x, y)


@wp.func
def count_same_vec3s(
    a: wp.array(dtype=wp.vec3f), i: wp.int32, b: wp.array(dtype=wp.vec3f), j: wp.int32, most: wp.int32
) -> wp.int32:
    k = wp.int32(0)
    same = wp.bool(True)
    while k < most and same:
        p = a[i + k]
        q = b[j + k]
        for c in range(3):
            same = same and wp.cast(p[c], wp.int32) == wp.cast(q[c], wp.int32)
        if same:
            k += 1
    return k


@wp.func
def count_same_floats(
    a: wp.array(dtype=wp.float32), i: wp.int32, b: wp.array(dtype=wp.float32), j: wp.int32, most: wp.int32
) -> wp.int32:
    k = wp.int32(0)
    same = wp.bool(True)
    while k < most and same:
        same = a[i + k] == b[j + k]
        if same:
            k += 1
    return k
