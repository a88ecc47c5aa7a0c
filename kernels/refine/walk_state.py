# SPDX-License-Identifier: GPL-3.0-or-later
"""What a slice of the walk is given: its part of the curve, its stacks, and where it writes."""

import warp as wp

from .band import Band
from .block import Blocks
from .coherence import Motion, Subtree
from .runs import Run

STACK = wp.constant(64)  # entries of a walk's stacks: more than the deepest tree has levels


@wp.struct
class Written:
    """How much a slice has written."""

    leaves: wp.int64
    vertices: wp.int64
    edges: wp.int64


@wp.struct
class Keeper:
    """What a slice takes from the last frame's lists, and what it keeps for the next frame: see kept.py."""

    next: wp.int64  # entry of the subtree of the last frame that the curve comes to next
    cell: wp.uint64  # its own
    depth: wp.int32
    leaves: wp.int32
    count: wp.int64  # subtrees kept
    end: wp.uint64  # the cell where the subtree ends that is open
    before: Written  # what there was when it was opened
    stopped: wp.int32  # 1: a leaf of it, or if none is open of any, is too coarse and as deep as leaves may be
    stopped_before: wp.int32  # ... when it was opened
    point_runs: wp.int64  # of points that were taken
    taken: wp.int64  # leaves
    sizes: wp.vec3i  # leaves, vertices and edges of the subtree that was taken last


@wp.struct
class Walk:
    """Where one slice of the curve writes, and how far it may."""

    first_cell: wp.uint64  # slice [first_cell, end_cell) of deepest cells, all squares in a row
    end_cell: wp.uint64
    cell_bits: wp.int32  # deepest cells in a square: 2**cell_bits
    max_depth: wp.int32
    leaf_capacity: wp.int64
    leaf_limit: wp.int64  # the walk may end as soon as it has more
    leaf_base: wp.int64  # where this slice's part of the arrays begins
    slot: wp.int32  # row of stacks, sides and counts
    grid: wp.int32  # 1: several squares, borders are tracked
    code: wp.array(dtype=wp.uint16)
    point: wp.array(dtype=wp.vec2i)
    cell: wp.array(dtype=wp.int64)  # leaves' first deepest cells, all squares in a row: the tree
    stack: wp.array(dtype=wp.vec4i)
    aside: wp.array(dtype=wp.int32)
    bands: wp.array(dtype=Band)
    blocks: Blocks
    sides: wp.array(dtype=wp.int32)  # per square: edges taken left, below, given right, above
    counts: wp.array(dtype=wp.int64)  # per slice: leaves, vertices, edges, and whether a leaf was stopped
    # Coherence from frame to frame: see kernels/refine/kept.py.
    slack: wp.float64  # the part by which spans of a pixel may change before what a band says is in doubt
    keeper: wp.array(dtype=Keeper)  # per slice
    kept: wp.array(dtype=Subtree)  # each slot's list from entry slot * room on
    kept_counts: wp.array(dtype=wp.int64)
    room: wp.int64  # of each slot's list; 0: nothing is kept
    point_runs: wp.array(dtype=Run)  # of points that were taken: lists as those of `kept`
    point_run_counts: wp.array(dtype=wp.int64)
    taken: wp.array(dtype=wp.int64)  # per slice: leaves that were taken
    motion: Motion  # of the view since the last frame
    last_kept: wp.array(dtype=Subtree)  # as above, of the last frame
    last_counts: wp.array(dtype=wp.int64)
    last_room: wp.int64
    last_slots: wp.int32  # 0: nothing of it holds
    last_code: wp.array(dtype=wp.uint16)  # what it has written
    last_point: wp.array(dtype=wp.vec2i)
    last_cell: wp.array(dtype=wp.int64)


@wp.struct
class Square:
    """A root square, as the walk enters it."""

    number: wp.int32
    column: wp.int32
    row: wp.int32
    corner: wp.vec2i
    side: wp.int32  # lattice units
    base: wp.uint64  # its first deepest cell, all squares in a row
    start: wp.uint64  # the first of its cells, from 0, that is in the slice


@wp.struct
class Cursor:
    """Where the walk stands: a triangle, and the band that holds there."""

    left: wp.vec2i
    apex: wp.vec2i
    right: wp.vec2i
    cell: wp.uint64  # its first deepest cell, in the square
    state: wp.int32  # of the curve
    depth: wp.int32
    held: wp.int32  # entry of the band
    top: wp.int32  # triangles that are put aside; -1: the slice or the square has ended
