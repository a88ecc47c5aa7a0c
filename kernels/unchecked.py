# SPDX-License-Identifier: GPL-3.0-or-later
"""Snippets of C for the loops that every triangle passes; tests/kernels/checked.py says in Warp what each stands for.

Milliseconds for 1 M triangles on one core, with them and in Warp alone: weld 8.4 and 15.9, displace 7.0 and 16.9,
meshlets 7.0 and 30.0.
"""

import warp as wp

# Loads, stores and copies. `a[i]` in Warp tests for a negative index and multiplies by a stride that is read from the
# array: half of the welding's time, 3 to 5 % of a walk. Vertices in curve order jump over the raster: where nothing is
# fetched ahead each waits for memory, 17.4 ms instead of 8.3. What the last frame has written of a subtree is copied in
# rows: a tenth of a flight's walk for one error. memmove costs no more: in glibc memcpy is the same function. The loops
# declare overloads, one for each type of items and indices.
for item in (wp.uint8, wp.uint16, wp.int32, wp.int64, wp.uint64, wp.float32, wp.vec2i, wp.vec4i, wp.vec2f, wp.vec3f):

    @wp.func_native("__builtin_prefetch(a.data + i);")
    def prefetch(a: wp.array(dtype=item), i: wp.int64):
        """Start loading a[i] into the processor's cache. Nothing is read, so any index is allowed."""
        ...

    for index in (wp.int32, wp.int64):

        @wp.func_native("return a.data[i];")
        def item_at(a: wp.array(dtype=item), i: index) -> item:
            """Return a[i] without a check of the index."""
            ...

        @wp.func_native("a.data[i] = value;")
        def put(a: wp.array(dtype=item), i: index, value: item):
            """Write `value` to a[i] without a check of the index."""
            ...

        @wp.func_native("__builtin_memmove(out.data + at, source.data + first, count * sizeof(*out.data));")
        def copy_items(
            source: wp.array(dtype=item), first: wp.int64, count: wp.int32, out: wp.array(dtype=item), at: index
        ):
            """Copy `count` items from source[first] on to out[at] on. The two parts may overlap."""
            ...


# Rows. Warp's loops are not vectorised or unrolled: 11.9 ms for the meshlets of 1 M triangles even with the loads and
# stores above, 7.0 ms with these.


@wp.func_native("int* __restrict row = out.data + at; for (int k = 0; k < count; ++k) row[k] = first + step * k;")
def number_row(out: wp.array(dtype=wp.int32), at: wp.int32, count: wp.int32, first: wp.int32, step: wp.int32):
    """Write the numbers first, first + step, first + 2 step .. into `count` entries of `out` from index `at` on."""
    ...


for item in (wp.int32, wp.vec2i):

    @wp.func_native(
        "const int *place = places.data + row, *number = numbers.data + first; "
        "int* __restrict to = (int*)(out.data + at); "
        "for (int k = 0; k < count; ++k) to[k] = number[place[k]];"
    )
    def look_up(
        places: wp.array(dtype=wp.int32),
        row: wp.int32,
        count: wp.int32,
        numbers: wp.array(dtype=wp.int32),
        first: wp.int32,
        out: wp.array(dtype=item),
        at: wp.int32,
    ):
        """Write numbers[first + places[row + k]] for k < count to `out`, from entry `at` on; a vec2i takes two of them.

        places: a row of a table of indices, as of a meshlet's template. numbers: the mesh's numbers for these indices.
        """
        ...


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
):
    """Copy `count` codes from table[first] on to out[at] on, each with the bits `extra` set."""
    ...


@wp.func_native(
    "const int* leg = (const int*)(legs.data + first); int* __restrict to = (int*)(out.data + at); "
    "const int down = bits > 0 ? bits - 1 : 0, lx = left[0] >> down, ly = left[1] >> down; "
    "const int rx = right[0] >> down, ry = right[1] >> down; "
    "for (int k = 0; k < count; ++k) { "
    "to[2 * k] = apex[0] + ((leg[2 * k] * lx + leg[2 * k + 1] * rx) >> 1); "
    "to[2 * k + 1] = apex[1] + ((leg[2 * k] * ly + leg[2 * k + 1] * ry) >> 1); }"
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
):
    """Write `count` vertices to out[at] on: apex + (a left + b right) >> bits, with (a, b) from legs[first] on.

    left, right: vectors from the apex to the other two corners of the triangle, lattice units. They are multiples of
    2^(bits - 1), and are divided by it first, so that no product overflows. bits: at least 1 unless `count` is 0.
    """
    ...


# What a cut asks of every triangle (kernels/mesh/cut.py): half the time of the plain loop.


@wp.func_native(
    "const int* v = corner_verts.data + 3 * t; return (near.data[v[0]] | near.data[v[1]] | near.data[v[2]]) != 0;"
)
def has_near_corner(near: wp.array(dtype=wp.uint8), corner_verts: wp.array(dtype=wp.int32), t: wp.int32) -> wp.bool:
    """Return whether `near` is set for any of the three vertices of triangle t, which are in `corner_verts`."""
    ...


# Comparison of this surface's points and levels with the last one's (kernels/effects/keep.py).


@wp.func_native(
    "const int *p = (const int*)(a.data + i), *q = (const int*)(b.data + j); int k = 0; "
    "while (k < max_count && p[3 * k] == q[3 * k] && p[3 * k + 1] == q[3 * k + 1] && p[3 * k + 2] == q[3 * k + 2]) "
    "++k; "
    "return k;"
)
def count_same_vec3s(
    a: wp.array(dtype=wp.vec3f), i: wp.int32, b: wp.array(dtype=wp.vec3f), j: wp.int32, max_count: wp.int32
) -> wp.int32:
    """Return how many items from a[i] on are equal bit by bit to those from b[j] on, at most `max_count`."""
    ...


@wp.func_native(
    "const float *p = a.data + i, *q = b.data + j; int k = 0; while (k < max_count && p[k] == q[k]) ++k; return k;"
)
def count_same_floats(
    a: wp.array(dtype=wp.float32), i: wp.int32, b: wp.array(dtype=wp.float32), j: wp.int32, max_count: wp.int32
) -> wp.int32:
    """Return how many items from a[i] on equal those from b[j] on, at most `max_count`; NaN equals no item."""
    ...
