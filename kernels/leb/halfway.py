# SPDX-License-Identifier: GPL-3.0-or-later
"""Middles of edges, in lattice units."""

import warp as wp


@wp.func
def halfway(a: wp.int32, b: wp.int32) -> wp.int32:
    """Return half the sum of two coordinates, 0 .. 2^30, rounded down. The sum may need 32 bits, so it is unsigned."""
    return wp.int32((wp.uint32(a) + wp.uint32(b)) >> wp.uint32(1))


@wp.func
def middle_between(p: wp.vec2i, q: wp.vec2i) -> wp.vec2i:
    """Return the middle of the edge between two vertices."""
    return wp.vec2i(halfway(p[0], q[0]), halfway(p[1], q[1]))
