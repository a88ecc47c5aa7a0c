# SPDX-License-Identifier: GPL-3.0-or-later
"""A block: a triangle bisected evenly, n times, whose leaves are written from a table instead of walked.

Where only edge lengths ask, bands of equal depth surround the eye: of a million leaves over a plain two in three lie
in blocks.
"""

import warp as wp

from ..unchecked import copy_codes, item_at, place_legs

MAX_BISECTIONS = wp.constant(8)


@wp.struct
class Blocks:
    """For a state of the curve s and n bisections, entry 6 n + s: where its leaves and new vertices stand."""

    first_leaf: wp.array(dtype=wp.int32)
    first_vertex: wp.array(dtype=wp.int32)
    vertices: wp.array(dtype=wp.int32)  # new vertices of the block
    code: wp.array(dtype=wp.uint16)  # a leaf's state
    # a new vertex from the apex, in 2^ceil(n / 2)-ths of the legs towards left and right
    leg: wp.array(dtype=wp.vec2i)


@wp.func
def new_vertices(blocks: Blocks, state: wp.int32, bisections: wp.int32) -> wp.int32:
    """How many vertices a block makes."""
    return item_at(blocks.vertices, 6 * bisections + state)


@wp.func
def write_block(
    blocks: Blocks,
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
    """The words of a block's leaves, each with the bits `extra`, and its new vertices, in the order of the curve."""
    entry = 6 * bisections + state
    first = item_at(blocks.first_leaf, entry)
    copy_codes(blocks.code, wp.int64(first), 1 << bisections, extra, code, first_code)
    first = item_at(blocks.first_vertex, entry)
    count = item_at(blocks.vertices, entry)
    bits = (bisections + 1) >> 1
    place_legs(blocks.leg, first, count, apex, left - apex, right - apex, bits, point, first_point)
