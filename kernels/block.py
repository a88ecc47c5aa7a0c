# SPDX-License-Identifier: GPL-3.0-or-later
"""A block: a triangle bisected evenly, n times, whose leaves are written from a table instead of walked.

Where only edge lengths ask, nearly every leaf lies in one: bands of equal depth surround the eye.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

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
def write_leaves(
    blocks: Blocks,
    entry: wp.int32,
    count: wp.int32,
    extra: wp.uint16,
    code: wp.array(dtype=wp.uint16),
    at: wp.int64,
):
    """The words of `count` leaves, each with the bits `extra`."""
    first = blocks.first_leaf[entry]
    for k in range(count):
        code[at + wp.int64(k)] = blocks.code[first + k] | extra


@wp.func
def write_vertices(
    blocks: Blocks,
    entry: wp.int32,
    bits: wp.int32,
    apex: wp.vec2i,
    to_left: wp.vec2i,
    to_right: wp.vec2i,
    point: wp.array(dtype=wp.vec2i),
    at: wp.int64,
):
    """The block's new vertices, in the order of the curve."""
    first = blocks.first_vertex[entry]
    for k in range(blocks.vertices[entry]):
        leg = blocks.leg[first + k]
        x = apex[0] + ((leg[0] * to_left[0] + leg[1] * to_right[0]) >> bits)
        y = apex[1] + ((leg[0] * to_left[1] + leg[1] * to_right[1]) >> bits)
        point[at + wp.int64(k)] = wp.vec2i(x, y)


@wp.func
def write_words(
    word: wp.int64,
    step: wp.int64,
    bits: wp.uint64,
    count: wp.int32,
    word_index: wp.array(dtype=wp.int64),
    word_bits: wp.array(dtype=wp.uint64),
    at: wp.int64,
):
    """`count` words of the tree, `step` apart, all with the same bits."""
    for k in range(count):
        word_index[at + wp.int64(k)] = word + wp.int64(k) * step
        word_bits[at + wp.int64(k)] = bits
