# SPDX-License-Identifier: GPL-3.0-or-later
"""What a slice of the walk is given: its part of the curve, its stacks, and where it writes."""

import warp as wp

from .band import Band
from .block import Blocks
from .bounds import Bounds
from .coherence import Motion, Subtree
from .shape import Shapes
from .sum_reduction import Run

wp.set_module_options({"enable_backward": False})

STACK = wp.constant(64)  # entries of a walk's stacks: more than the deepest tree has levels


@wp.struct
class Written:
    """How much a slice has written."""

    leaves: wp.int64
    vertices: wp.int64
    edges: wp.int64


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
    slot: wp.int32  # row of stacks, sides, counts and bounds
    grid: wp.int32  # 1: several squares, borders are tracked
    code: wp.array(dtype=wp.uint16)
    point: wp.array(dtype=wp.vec2i)
    cell: wp.array(dtype=wp.int64)  # leaves' first deepest cells, all squares in a row: the tree
    stack: wp.array(dtype=wp.vec4i)
    aside: wp.array(dtype=wp.int32)
    bands: wp.array(dtype=Band)
    remembered: wp.array(dtype=Band)  # of diamonds met from one triangle, for the other one
    limits: wp.array(dtype=wp.vec3d)  # from entry slot * STACK on, of each depth: kernels/refine/footprint.py
    blocks: Blocks
    shapes: Shapes
    # Coherence from frame to frame: see kernels/refine/kept.py.
    slack: wp.float64  # the part by which spans of a pixel may change before what a band says is in doubt
    kept: wp.array(dtype=Subtree)  # each slot's list from entry slot * room on
    kept_counts: wp.array(dtype=wp.int64)
    room: wp.int64  # of each slot's list
    runs: wp.array(dtype=Run)  # of leaves that were taken: lists as those of `kept`
    point_runs: wp.array(dtype=Run)  # of points
    run_counts: wp.array(dtype=wp.int64)
    point_run_counts: wp.array(dtype=wp.int64)
    motion: Motion  # of the view since the last frame
    last_kept: wp.array(dtype=Subtree)  # as above, of the last frame
    last_counts: wp.array(dtype=wp.int64)
    last_room: wp.int64
    last_slots: wp.int32  # 0: nothing of it holds
    last_code: wp.array(dtype=wp.uint16)  # what it has written
    last_point: wp.array(dtype=wp.vec2i)
    last_cell: wp.array(dtype=wp.int64)
    taken: wp.array(dtype=wp.int64)  # per slice: leaves that were taken from it
    sides: wp.array(dtype=wp.int32)  # per square: edges taken left, below, given right, above
    counts: wp.array(dtype=wp.int64)  # per slice: leaves, vertices, edges
    bounds: wp.array(
        dtype=wp.float64
    )  # per slice, the largest of any leaf: see Leaves in cbt_terrain/refine/refinement.py


@wp.func
def put_results(w: Walk, n: Written, worst: Bounds, in_pixels: wp.vec2f, in_metres: wp.vec2f):
    """What the slice has written, the maxima over its leaves, and of the leaves that have the most error its parts."""
    c = 3 * w.slot
    w.counts[c] = n.leaves
    w.counts[c + 1] = n.vertices
    w.counts[c + 2] = n.edges
    b = 10 * w.slot
    w.bounds[b] = worst.px2
    w.bounds[b + 1] = worst.total_px2
    w.bounds[b + 2] = worst.long_px2
    w.bounds[b + 3] = worst.legs_px2 * wp.float64(0.5)
    w.bounds[b + 4] = worst.metres2
    w.bounds[b + 5] = worst.total2
    w.bounds[b + 6] = wp.float64(in_pixels[0])
    w.bounds[b + 7] = wp.float64(in_pixels[1])
    w.bounds[b + 8] = wp.float64(in_metres[0])
    w.bounds[b + 9] = wp.float64(in_metres[1])
