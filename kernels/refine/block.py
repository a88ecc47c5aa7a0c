# SPDX-License-Identifier: GPL-3.0-or-later
"""Blocks: triangles bisected evenly n times, whose leaves are copied from a table instead of walked.

Leaves are in the order of the Sierpinski curve; a triangle's curve state (0 .. 5) says by which edges the curve enters
and leaves it (curve.py). Where edge lengths alone decide, zones of equal depth surround the eye: in a mesh of one
million leaves over a plain, two thirds of the leaves are in blocks.
"""

import warp as wp

from ..unchecked import copy_codes, item_at, place_legs

MAX_BISECTIONS = wp.constant(8)  # the table has blocks of 0 to this number of bisections


@wp.struct
class BlockTable:
    """Table of blocks: entry 6 n + s locates the leaves and new vertices for curve state s and n bisections."""

    first_leaf: wp.array(dtype=wp.int32)  # in `code`
    first_vertex: wp.array(dtype=wp.int32)  # in `leg`
    vertices: wp.array(dtype=wp.int32)  # number of new vertices of the block
    code: wp.array(dtype=wp.uint16)  # a leaf's curve state
    # A new vertex (a, b): apex + (a (left - apex) + b (right - apex)) / 2^ceil(n / 2).
    leg: wp.array(dtype=wp.vec2i)


@wp.func
def new_vertices(blocks: BlockTable, state: wp.int32, bisections: wp.int32) -> wp.int32:
    """Return the number of vertices that `bisections` even bisections add in a triangle of this curve state."""
    return item_at(blocks.vertices, 6 * bisections + state)


@wp.func
def write_block(
    blocks: BlockTable,
    state: wp.int32,
    bisections: wp.int32,
    left: wp.vec2i,
    apex: wp.vec2i,
    right: wp.vec2i,
    extra: wp.uint16,
    code: wp.array(dtype=wp.uint16),
    first_code: wp.int64,
    point: wp.array(dtype=wp.vec2i),
    first_point: wp.int64,
):
    """Write the words of a block's leaves and its new vertices, in curve order, copied from the table.

    state: the curve's state in the triangle (left, apex, right), lattice units. bisections: their number, the same for
    all leaves, at most MAX_BISECTIONS. extra: bits of each leaf's word besides its state. Words go to code[first_code]
    on, vertices to point[first_point] on. The table has vertices as offsets from the apex in fractions of the legs.
    """
    entry = 6 * bisections + state  # the table has six states for each number of bisections
    first = item_at(blocks.first_leaf, entry)
    copy_codes(blocks.code, wp.int64(first), 1 << bisections, extra, code, first_code)
    first = item_at(blocks.first_vertex, entry)
    count = item_at(blocks.vertices, entry)
    bits = (bisections + 1) >> 1  # two bisections halve the legs
    place_legs(blocks.leg, first, count, apex, left - apex, right - apex, bits, point, first_point)
