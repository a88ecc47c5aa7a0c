# SPDX-License-Identifier: GPL-3.0-or-later
"""The walk through a subtree on level ground, where only edge lengths ask and no error is news.

A loop of its own for what is most of a plain: a diamond is not measured but where its footprint leaves a doubt, and
nothing is remembered for its other triangle. Nanoseconds a leaf with it and without, over flat ground: 10 and 39 at
50,000 leaves, 3 and 13.5 at 1 M; without shapes 14 and 4.
"""

import warp as wp

from ..unchecked import (
    corners_at,
    limits_at,
    number_at,
    number_cells,
    place_starts,
    put,
    put_cell,
    put_code,
    put_corners,
    put_pair,
)
from .band import BELOW
from .block import MAX_BISECTIONS, new_vertices, write_block
from .curve import HYP_LEG, leaf_word, left_state, right_state
from .diamond import Asked, Domain, diamond_at, finest, larger, sizes, too_coarse
from .footprint import Heights, Plan, heights_between, most_below, put_limits, spans
from .shape import MAX_SHAPE, write_shape
from .walk_state import STACK, Walk, Written

wp.set_module_options({"enable_backward": False})

# Instead of being split as a triangle of the walk: its leaves come from a table.
SHAPE = wp.constant(2)
BLOCK = wp.constant(3)
INSIDE = wp.constant(wp.uint64(1))  # a cell other than the square's first


@wp.func
def put_leaf(w: Walk, leaf: wp.int64, vertex: wp.int64, word: wp.uint32, apex: wp.vec2i, right: wp.vec2i):
    """Write a leaf's word and its new vertex, which stays only if it is new."""
    put_code(w.code, w.leaf_base + leaf, wp.uint16(word))
    new = wp.where((word & wp.uint32(6)) == wp.uint32(HYP_LEG), apex, right)
    put_pair(w.point, w.leaf_base + vertex, new)


@wp.func
def splits_at(plan: Plan, heights: Heights, limit: wp.vec3d, climb: wp.float64, x: wp.int32, y: wp.int32):
    """Whether the diamond split at (x, y) is, and whether that is certain: 0 or 1."""
    least, most = spans(plan, heights, x, y, limit[0])
    split = wp.int32(most < limit[1])
    return split, split | wp.int32(least >= limit[2] + climb)


@wp.func
def shape_below(
    plan: Plan,
    heights: Heights,
    limits: wp.array(dtype=wp.vec3d),
    limit: wp.int32,
    climb: wp.float64,
    bisections: wp.int32,
    left_x: wp.int32,
    left_y: wp.int32,
    apex_x: wp.int32,
    apex_y: wp.int32,
    right_x: wp.int32,
    right_y: wp.int32,
):
    """The shape of a triangle that is split, and whether it is certain: 0 or 1.

    limit: entry of the triangle's own. bisections: how many there are below it at most, from 1 to MAX_SHAPE.
    """
    shape = wp.int32(0)
    sure = wp.int32(1)
    if bisections > 1:
        own = limits_at(limits, limit + 1)
        split_0, sure_0 = splits_at(plan, heights, own, climb, (left_x + apex_x) >> 1, (left_y + apex_y) >> 1)
        split_1, sure_1 = splits_at(plan, heights, own, climb, (apex_x + right_x) >> 1, (apex_y + right_y) >> 1)
        shape = split_0 | (split_1 << 1)
        sure = sure_0 & sure_1
        if bisections > 2:
            x = (left_x + right_x) >> 1
            y = (left_y + right_y) >> 1
            own = limits_at(limits, limit + 2)
            split_00, sure_00 = splits_at(plan, heights, own, climb, (left_x + x) >> 1, (left_y + y) >> 1)
            # Child 1 of child 0 and child 0 of child 1 are one diamond.
            split_01, sure_01 = splits_at(plan, heights, own, climb, (apex_x + x) >> 1, (apex_y + y) >> 1)
            split_11, sure_11 = splits_at(plan, heights, own, climb, (x + right_x) >> 1, (y + right_y) >> 1)
            below_0 = (split_00 << 2) | (split_01 << 3)
            below_1 = (split_01 << 4) | (split_11 << 5)
            shape = shape | (below_0 * split_0) | (below_1 * split_1)
            sure = sure & sure_00 & sure_01 & sure_11
    return shape, sure


@wp.func
def walk_level_ground(
    domain: Domain,
    asked: Asked,
    w: Walk,
    plan: Plan,
    n: Written,
    longest_px2: wp.float64,
    largest_px2: wp.float64,
    first_cell: wp.uint64,
    left: wp.vec2i,
    apex: wp.vec2i,
    right: wp.vec2i,
    first_state: wp.int32,
    first_depth: wp.int32,
    leaf_depth: wp.int32,
    bottom: wp.int32,
):
    """Refine a triangle whose leaves are in the slice, neither the square's first nor its last, and share nothing with
    other squares.

    longest_px2, largest_px2: maxima so far. first_cell: of all squares in a row. leaf_depth: from it on nothing is
    split or a new maximum. bottom: the stacks' first free entry. Returns what is written then, and the maxima.
    """
    x = (left[0] + right[0]) >> 1
    y = (left[1] + right[1]) >> 1
    ground = diamond_at(domain, x, y, first_depth)
    heights = heights_between(asked, plan, ground.low[2], ground.high[2])
    climb2 = ground.rise * ground.rise
    limits = w.slot * STACK
    climb = climb2 * put_limits(domain, asked, longest_px2, largest_px2, w.max_depth, w.limits, limits)
    leaves = n.leaves
    vertices = n.vertices
    cell = first_cell
    depth = first_depth
    state = first_state
    ends = wp.min(leaf_depth, w.max_depth + 1)  # from this depth on there are only leaves, and no new maxima
    left_x = left[0]
    left_y = left[1]
    apex_x = apex[0]
    apex_y = apex[1]
    right_x = right[0]
    right_y = right[1]
    top = bottom
    inside = wp.int32(1)
    while inside == 1 and leaves <= w.leaf_limit:
        split = wp.int32(0)
        shape = wp.int32(0)
        x = (left_x + right_x) >> 1
        y = (left_y + right_y) >> 1
        if depth < ends:
            limit = limits_at(w.limits, limits + depth)
            least, most = spans(plan, heights, x, y, limit[0])
            if most < limit[1]:
                split = 1
            elif not least >= limit[2] + climb:
                d = diamond_at(domain, x, y, depth)
                pixel2 = finest(asked, d, 1)
                long2, legs2 = sizes(asked, domain.unit_bits, depth)
                long2 += d.rise * d.rise
                legs2 += d.rise * d.rise
                split = wp.int32(depth < w.max_depth and too_coarse(asked, pixel2, wp.float64(0.0), long2, legs2))
                near2 = pixel2 * BELOW
                if split == 0 and (long2 > longest_px2 * near2 or legs2 > largest_px2 * near2):
                    longest_px2 = larger(longest_px2, long2 / pixel2)
                    largest_px2 = larger(largest_px2, legs2 / pixel2)
                    climbs = put_limits(domain, asked, longest_px2, largest_px2, w.max_depth, w.limits, limits)
                    climb = climb2 * climbs
            if split == 1:
                while ends > depth + 1 and least >= limits_at(w.limits, limits + ends - 1)[2] + climb:
                    ends -= 1
                if ends <= depth + MAX_SHAPE:
                    shape, sure = shape_below(
                        plan, heights, w.limits, limits + depth, climb, ends - depth,
                        left_x, left_y, apex_x, apex_y, right_x, right_y,
                    )  # fmt: skip
                    if sure == 1:
                        split = SHAPE
                elif ends <= w.max_depth and ends - depth <= MAX_BISECTIONS:
                    if most_below(plan, heights, x, y, limit[0]) < limits_at(w.limits, limits + ends - 1)[1]:
                        split = BLOCK
        if split == 1:
            depth += 1
            put_corners(w.stack, top, wp.vec4i(x, y, right_x, right_y))
            put(w.aside, wp.int64(top), right_state(state, INSIDE) | (depth << 3) | (ends << 9))
            top += 1
            state = left_state(state)
            right_x = apex_x
            right_y = apex_y
            apex_x = x
            apex_y = y
        else:
            size = wp.uint64(1) << wp.uint64(w.cell_bits - depth)
            if split == BLOCK:
                levels = ends - depth
                even = wp.int64(1) << wp.int64(levels)
                if leaves + even <= w.leaf_capacity:
                    write_block(
                        w.blocks,
                        state,
                        levels,
                        wp.vec2i(left_x, left_y),
                        wp.vec2i(apex_x, apex_y),
                        wp.vec2i(right_x, right_y),
                        wp.uint16(leaf_word(0, ends)),
                        w.code,
                        w.leaf_base + leaves,
                        w.point,
                        w.leaf_base + vertices,
                    )
                    number_cells(w.cell, w.leaf_base + leaves, 1 << levels, cell, size >> wp.uint64(levels))
                leaves += even
                vertices += wp.int64(new_vertices(w.blocks, state, levels))
            elif split == SHAPE:
                entry = 6 * shape + state
                if leaves < w.leaf_capacity:
                    starts = number_at(w.shapes.starts, entry)
                    place_starts(w.cell, w.leaf_base + leaves, cell, w.cell_bits - depth, starts)
                    write_shape(
                        w.shapes,
                        entry,
                        depth,
                        wp.vec2i(left_x, left_y),
                        wp.vec2i(apex_x, apex_y),
                        wp.vec2i(right_x, right_y),
                        w.code,
                        w.leaf_base + leaves,
                        w.point,
                        w.leaf_base + vertices,
                    )
                leaves += wp.int64(number_at(w.shapes.leaves, entry))
                vertices += wp.int64(number_at(w.shapes.vertices, entry))
            else:
                if leaves < w.leaf_capacity:
                    corner = wp.vec2i(apex_x, apex_y)
                    put_leaf(w, leaves, vertices, leaf_word(state, depth), corner, wp.vec2i(right_x, right_y))
                    put_cell(w.cell, w.leaf_base + leaves, cell)
                vertices += wp.int64(1 - (state & 1))
                leaves += wp.int64(1)
            cell += size
            if top == bottom:
                inside = 0
            else:
                top -= 1
                left_x = right_x
                left_y = right_y
                corners = corners_at(w.stack, top)
                apex_x = corners[0]
                apex_y = corners[1]
                right_x = corners[2]
                right_y = corners[3]
                put_aside = number_at(w.aside, top)
                state = put_aside & 7
                depth = (put_aside >> 3) & 63
                ends = put_aside >> 9
    after = Written()
    after.leaves = leaves
    after.vertices = vertices
    after.edges = n.edges + (leaves - n.leaves) + (vertices - n.vertices)
    return after, longest_px2, largest_px2
