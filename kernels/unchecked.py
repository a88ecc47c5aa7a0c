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
def byte_at(a: wp.array(dtype=wp.uint8), i: wp.int64) -> wp.uint8: ...


@wp.func_native("return a.data[i];")
def pair_at(a: wp.array(dtype=wp.vec2i), i: wp.int64) -> wp.vec2i: ...


@wp.func_native("__builtin_prefetch(a.data + i);")
def prefetch_byte(a: wp.array(dtype=wp.uint8), i: wp.int64): ...


@wp.func_native("__builtin_prefetch(a.data + i);")
def prefetch_code(a: wp.array(dtype=wp.uint16), i: wp.int64): ...


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


# The walk's stacks and leaves, and where the arrays hold a diamond: 3 to 5 % of a walk.


@wp.func_native("a.data[i] = value;")
def put_code(a: wp.array(dtype=wp.uint16), i: wp.int64, value: wp.uint16): ...


@wp.func_native("a.data[i] = value;")
def put_corners(a: wp.array(dtype=wp.vec4i), i: wp.int32, value: wp.vec4i): ...


@wp.func_native("return a.data[i];")
def corners_at(a: wp.array(dtype=wp.vec4i), i: wp.int32) -> wp.vec4i: ...


@wp.func_native("return a.data[i];")
def number_at(a: wp.array(dtype=wp.int32), i: wp.int32) -> wp.int32: ...


@wp.func_native("a.data[i] = value;")
def put_cell(a: wp.array(dtype=wp.int64), i: wp.int64, value: wp.uint64): ...


@wp.func_native("return a.data[i];")
def entry_at(a: wp.array(dtype=wp.int64), i: wp.int32) -> wp.int64: ...


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


# Rows of an even block (kernels/refine/block.py): milliseconds for 1 M leaves of one edge length 3.2, in Warp 7.6; for
# 500,000 in a tree of depth 32 1.3 and 4.2.


@wp.func_native(
    "const wp::uint16* from = table.data + first; wp::uint16* __restrict to = out.data + at; "
    "for (int k = 0; k < count; ++k) to[k] = from[k] | extra;"
)
def copy_codes(
    table: wp.array(dtype=wp.uint16),
    first: wp.int64,
    count: wp.int32,
    extra: wp.uint16,
    out: wp.array(dtype=wp.uint16),
    at: wp.int64,
): ...


@wp.func_native(
    "const int* leg = (const int*)(legs.data + first); int* __restrict to = (int*)(out.data + at); "
    "for (int k = 0; k < count; ++k) { "
    "to[2 * k] = apex[0] + ((leg[2 * k] * left[0] + leg[2 * k + 1] * right[0]) >> bits); "
    "to[2 * k + 1] = apex[1] + ((leg[2 * k] * left[1] + leg[2 * k + 1] * right[1]) >> bits); }"
)
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
): ...


@wp.func_native("wp::int64* __restrict to = cells.data + at; for (int k = 0; k < count; ++k) to[k] = first + k * step;")
def number_cells(cells: wp.array(dtype=wp.int64), at: wp.int64, count: wp.int32, first: wp.uint64, step: wp.uint64): ...


# What the last frame has written of a subtree (kernels/refine/coherence.py): a tenth of a flight's walk for one error.


@wp.func_native(
    "const wp::int64* from = (const wp::int64*)(points.data + first); "
    "wp::int64* __restrict to = (wp::int64*)(out.data + at); "
    "for (int k = 0; k < count; ++k) to[k] = from[k];"
)
def copy_points(
    points: wp.array(dtype=wp.vec2i), first: wp.int64, count: wp.int32, out: wp.array(dtype=wp.vec2i), at: wp.int64
): ...


@wp.func_native(
    "const wp::int64* from = cells.data + first; wp::int64* __restrict to = out.data + at; "
    "for (int k = 0; k < count; ++k) to[k] = from[k];"
)
def copy_cells(
    cells: wp.array(dtype=wp.int64), first: wp.int64, count: wp.int32, out: wp.array(dtype=wp.int64), at: wp.int64
): ...


@wp.func_native(
    "const float* from = (const float*)(vectors.data + first); float* __restrict to = (float*)(out.data + at); "
    "for (int k = 0; k < 3 * count; ++k) to[k] = from[k];"
)
def copy_vec3s(
    vectors: wp.array(dtype=wp.vec3f), first: wp.int64, count: wp.int32, out: wp.array(dtype=wp.vec3f), at: wp.int32
): ...


@wp.func_native(
    "const float* from = (const float*)(vectors.data + first); float* __restrict to = (float*)(out.data + at); "
    "for (int k = 0; k < 2 * count; ++k) to[k] = from[k];"
)
def copy_vec2s(
    vectors: wp.array(dtype=wp.vec2f), first: wp.int64, count: wp.int32, out: wp.array(dtype=wp.vec2f), at: wp.int32
): ...


# What a cut asks of every triangle (kernels/mesh/cut.py): half the time of the plain loop.


@wp.func_native(
    "const int* v = corner_verts.data + 3 * t; return (near.data[v[0]] | near.data[v[1]] | near.data[v[2]]) != 0;"
)
def has_near_corner(near: wp.array(dtype=wp.uint8), corner_verts: wp.array(dtype=wp.int32), t: wp.int32) -> wp.bool: ...
