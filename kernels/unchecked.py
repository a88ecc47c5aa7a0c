# SPDX-License-Identifier: GPL-3.0-or-later
"""Snippets of C for the loops that every triangle passes; tests/kernels/checked.py says in Warp what each stands for.

Milliseconds for 1 M triangles on one core, with them and in Warp alone: weld 8.4 and 15.9, displace 7.0 and 16.9,
meshlets 7.0 and 30.0.
"""

import warp as wp

# Loads and stores. `a[i]` in Warp tests for a negative index and multiplies by a stride that is read from the array:
# half of the welding's time.


@wp.func_native("return a.data[i];")
def height_at(a: wp.array(dtype=wp.float32), i: wp.int64) -> wp.float32: ...


@wp.func_native("return a.data[i];")
def code_at(a: wp.array(dtype=wp.uint16), i: wp.int64) -> wp.uint16: ...


@wp.func_native("return a.data[i];")
def pair_at(a: wp.array(dtype=wp.vec2i), i: wp.int64) -> wp.vec2i: ...


@wp.func_native("__builtin_prefetch(a.data + i);")
def prefetch_range(a: wp.array(dtype=wp.uint16), i: wp.int64): ...


@wp.func_native("a.data[i] = value;")
def put(a: wp.array(dtype=wp.int32), i: wp.int64, value: wp.int32): ...


@wp.func_native("a.data[i] = value;")
def put_pair(a: wp.array(dtype=wp.vec2i), i: wp.int64, value: wp.vec2i): ...


@wp.func_native("return *(wp::int64*)(a.data + i);")
def packed_at(a: wp.array(dtype=wp.vec2i), i: wp.int64) -> wp.int64: ...


@wp.func_native("*(wp::int64*)(a.data + i) = pair;")
def put_packed(a: wp.array(dtype=wp.vec2i), i: wp.int64, pair: wp.int64): ...


@wp.func_native("a.data[i] = value;")
def put_vec3(a: wp.array(dtype=wp.vec3f), i: wp.int32, value: wp.vec3f): ...


@wp.func_native("a.data[i] = value;")
def put_vec2(a: wp.array(dtype=wp.vec2f), i: wp.int32, value: wp.vec2f): ...


# Vertices in curve order jump over the raster: without this each waits for memory, 17.4 ms instead of 8.3.


@wp.func_native("__builtin_prefetch(a.data + i);")
def prefetch(a: wp.array(dtype=wp.float32), i: wp.int64): ...


# Rows. Warp's loops are not vectorised or unrolled: 11.9 ms for the meshlets of 1 M triangles even with the loads and
# stores above, 7.0 ms with these.


@wp.func_native("int* __restrict row = out.data + at; for (int k = 0; k < count; ++k) row[k] = first + step * k;")
def number_row(out: wp.array(dtype=wp.int32), at: wp.int32, count: wp.int32, first: wp.int32, step: wp.int32): ...


@wp.func_native(
    "const int *place = places.data + row, *number = numbers.data + first; "
    "int* __restrict to = out.data + at; "
    "for (int k = 0; k < count; ++k) to[k] = number[place[k]];"
)
def look_up(
    places: wp.array(dtype=wp.int32),
    row: wp.int32,
    count: wp.int32,
    numbers: wp.array(dtype=wp.int32),
    first: wp.int32,
    out: wp.array(dtype=wp.int32),
    at: wp.int32,
): ...


@wp.func_native(
    "const int *place = places.data, *number = numbers.data + first; "
    "int* __restrict to = (int*)(out.data + at); "
    "for (int k = 0; k < 2 * count; ++k) to[k] = number[place[k]];"
)
def look_up_pairs(
    places: wp.array(dtype=wp.int32),
    count: wp.int32,
    numbers: wp.array(dtype=wp.int32),
    first: wp.int32,
    out: wp.array(dtype=wp.vec2i),
    at: wp.int32,
): ...
