# SPDX-License-Identifier: GPL-3.0-or-later
"""A shape: a triangle bisected up to three times, unevenly, whose leaves are written from a table without a branch.

Its number has a bit for each bisection below the first: those of child 0 and child 1, then those of their children.
Whatever is written of it is eight entries long; what is beyond its leaves, the next ones overwrite.
"""

import warp as wp

from ..unchecked import place_eight, put_eight
from .curve import DEPTH_SHIFT, PARITY

wp.set_module_options({"enable_backward": False})

MAX_SHAPE = wp.constant(3)  # bisections
LEAVES = wp.constant(8)  # at most, and room for them after the last one


@wp.struct
class Shapes:
    """Entry 6 * shape + state of the curve, of `code` and `leg` eight."""

    leaves: wp.array(dtype=wp.int32)
    vertices: wp.array(dtype=wp.int32)  # new ones
    starts: wp.array(dtype=wp.int32)  # bit k: a leaf begins with the k-th eighth of the triangle
    code: wp.array(dtype=wp.uint16)  # words of the leaves below a triangle of depth 0
    leg: wp.array(dtype=wp.vec2i)  # new vertices from the apex, in quarters of the legs towards left and right


@wp.func
def write_shape(
    shapes: Shapes,
    entry: wp.int32,
    depth: wp.int32,
    left: wp.vec2i,
    apex: wp.vec2i,
    right: wp.vec2i,
    code: wp.array(dtype=wp.uint16),
    first_code: wp.int64,
    point: wp.array(dtype=wp.vec2i),
    first_point: wp.int64,
):
    """The words of a shape's leaves and its new vertices, in the order of the curve. depth: of the triangle."""
    parity = wp.uint16((depth & 1) << PARITY)
    put_eight(shapes.code, 8 * entry, parity, wp.uint16(depth << DEPTH_SHIFT), code, first_code)
    place_eight(shapes.leg, 8 * entry, apex, left - apex, right - apex, point, first_point)
