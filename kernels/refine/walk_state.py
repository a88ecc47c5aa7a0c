# SPDX-License-Identifier: GPL-3.0-or-later
"""The state of one slice of the walk: its part of the curve, its stacks, and the arrays that it writes."""

import warp as wp

from .block import BlockTable
from .interval import LodInterval, MeasuredDiamond

STACK = wp.constant(64)  # entries of a slice's stacks and of its arrays by depth: more than the deepest tree has levels


@wp.struct
class Written:
    """Numbers of leaves, vertices and edges that a slice has written."""

    leaves: wp.int64
    vertices: wp.int64
    edges: wp.int64


@wp.struct
class Walk:
    """One slice of the curve, the arrays that it writes and its limits. It knows nothing of the last frame."""

    first_cell: wp.uint64  # slice [first_cell, end_cell) of deepest cells, all squares in a row
    end_cell: wp.uint64
    cell_bits: wp.int32  # deepest cells in a square: 2**cell_bits
    max_depth: wp.int32  # at this depth all triangles are leaves
    leaf_capacity: wp.int64  # leaves and new vertices for which this slice has entries
    leaf_limit: wp.int64  # a walk with more leaves may end early
    leaf_base: wp.int64  # first entry of this slice in `code` and `point`
    slot: wp.int32  # number of the slice: its row of stacks, sides and counts
    grid: wp.int32  # 1: several squares, borders are tracked
    code: wp.array(dtype=wp.uint16)  # words of leaves, see curve.py
    point: wp.array(dtype=wp.vec2i)  # new vertices, lattice units
    stack: wp.array(dtype=wp.vec4i)  # apex (x, y) and right corner (x, y) of each triangle on the stack
    aside: wp.array(dtype=wp.int32)  # ... its state, depth and interval, see `enter`
    intervals: wp.array(dtype=LodInterval)  # by depth: below the last measured diamond that was split
    diamonds: wp.array(dtype=MeasuredDiamond)  # ... and the last measured diamond
    blocks: BlockTable
    sides: wp.array(dtype=wp.int32)  # per square: edges taken left, below, given right, above
    counts: wp.array(dtype=wp.int64)  # per slice: leaves, vertices, edges, and 1 if a leaf is too coarse at max_depth
    ends: wp.array(dtype=wp.uint64)  # per slice: the cell after its last leaf


@wp.struct
class Square:
    """A root square, as the walk enters it."""

    number: wp.int32
    column: wp.int32
    row: wp.int32
    corner: wp.vec2i  # south-west corner, lattice units
    side: wp.int32  # lattice units
    base: wp.uint64  # its first deepest cell, all squares in a row
    start: wp.uint64  # the first of its cells, from 0, that is in the slice


@wp.struct
class Cursor:
    """Position of the walk: a triangle, and the interval for it."""

    left: wp.vec2i  # corners, lattice units
    apex: wp.vec2i
    right: wp.vec2i
    cell: wp.uint64  # its first deepest cell, in the square
    state: wp.int32  # of the curve
    depth: wp.int32
    interval_index: wp.int32  # index in `Walk.intervals` of the interval for it
    top: wp.int32  # triangles on the stack; -1: the slice or the square has ended
