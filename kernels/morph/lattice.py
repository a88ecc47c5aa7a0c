# SPDX-License-Identifier: GPL-3.0-or-later
"""Split vertices as points of the lattice: how deep their diamond is, and which edge they split.

All of it follows from the trailing zeros of a point's coordinates, in every root square alike, whose side is
2^unit_bits lattice units.
"""

import warp as wp


@wp.struct
class SplitVertex:
    """A point of the lattice and its diamond."""

    point: wp.vec2i  # lattice units
    depth: wp.int32  # of the diamond that it splits; 0: a corner of a root square
    left: wp.vec2i  # the ends of the edge that it splits, in either order
    right: wp.vec2i


@wp.func
def depth_of(unit_bits: wp.int32, p: wp.vec2i) -> wp.int32:
    """Return the depth of the diamond that is split at lattice point p; 0 for a corner of a root square.

    unit_bits: a root square has 2^unit_bits lattice units a side.
    """
    both = p[0] | p[1]
    step = both & -both  # the largest power of two of which both coordinates are multiples
    depth = wp.int32(0)
    if step > 0 and step >> unit_bits == 0:  # not a corner of a root square
        depth = 2 * (unit_bits - wp.bit_count(step - 1))
        if (p[0] & p[1] & step) != 0:  # the centre of a cell, not the middle of a side
            depth -= 1
    return depth


@wp.func
def half_edge(unit_bits: wp.int32, p: wp.vec2i, depth: wp.int32) -> wp.vec2i:
    """Return the vector from p to one end of the edge that p splits, lattice units.

    unit_bits: a root square has 2^unit_bits of them a side. depth: that of the diamond split at p, above 0.
    """
    half = wp.int32(1) << (unit_bits - ((depth + 1) >> 1))
    along = wp.vec2i(half, 0)
    if (depth & 1) == 1:
        # p is the middle of a cell. The diagonals of the four cells in a cell meet in its middle, so that one goes up
        # if its column and row are both even or both odd; that of a root square goes down.
        is_upward = depth > 1 and (((p[0] ^ p[1]) / half) & 2) == 0
        along = wp.vec2i(half, wp.where(is_upward, half, -half))
    elif (p[0] & half) == 0:  # p is the middle of a cell's western side
        along = wp.vec2i(0, half)
    return along


@wp.func
def split_vertex(unit_bits: wp.int32, p: wp.vec2i) -> SplitVertex:
    """Return lattice point p as a SplitVertex: the depth of its diamond and the ends of the edge that it splits.

    A corner of a root square has depth 0 and no ends. unit_bits: a root square has 2^unit_bits lattice units a side.
    """
    v = SplitVertex()
    v.point = p
    v.depth = depth_of(unit_bits, p)
    if v.depth > 0:
        along = half_edge(unit_bits, p, v.depth)
        v.left = p - along
        v.right = p + along
    return v


@wp.func
def diamond_above(unit_bits: wp.int32, v: SplitVertex, bisections: wp.int32) -> SplitVertex:
    """Return the ancestor of the diamond of v that is `bisections` levels above and contains the edge that v splits.

    unit_bits: a root square has 2^unit_bits lattice units a side. bisections: even, below v's depth. Each pass goes two
    levels up: of the edge's ends, one is the split vertex of a diamond two levels above, and the other one is older.
    """
    for _ in range(bisections >> 1):
        end = v.left
        if depth_of(unit_bits, end) != v.depth - 2:
            end = v.right
        v = split_vertex(unit_bits, end)
    return v
