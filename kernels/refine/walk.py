# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement: one walk over the diamonds in curve order.

Below a diamond that is split, a *band* says what is certain: between the finest and the coarsest pixel on its box lie
those of all boxes inside it (they are nested), so most diamonds are decided by a look at their error, or at nothing but
their depth. Only one that falls between is measured, and makes a narrower band for what is below it; when the curve
comes to its other triangle, it is remembered. Margins are far above rounding: the mesh is the one that measuring every
diamond gives.

The walk writes a word of 16 bits a leaf (curve.py) and one point a new vertex, all that the welding needs, and
the leaves' cells, the tree. It is one long function because its parts share so much: with what writes a leaf as a
function of its own it takes 5 % more time.
"""

import warp as wp

from ..unchecked import corners_at, number_at, number_cells, put, put_cell, put_code, put_corners, put_pair
from .band import (
    LEVEL_GROUND,
    NOT_SPLIT,
    REMEMBERED,
    band_below,
    limits_of,
    measured_at,
    nothing_certain,
    quiet,
    remembered_at,
    turning_span,
    unmeasured_below,
)
from .block import MAX_BISECTIONS, new_vertices, write_block
from .bounds import Bounds, within
from .coherence import carried
from .curve import (
    BORDER,
    CORNER,
    FIRST,
    HYP_LEG,
    INNER,
    LAST,
    LEG_HYP,
    TAKE_BELOW,
    TAKE_LEFT,
    TO_CORNER,
    border_role,
    end_of_entry,
    hypotenuse_passed,
    leaf_word,
    left_state,
    right_state,
    third_edge,
    touches_border,
)
from .diamond import (
    Asked,
    Domain,
    error_at,
    fetch_ahead,
    larger,
    leaves_tile,
    metres2_of,
    moved_at,
    smaller,
    too_coarse,
)
from .footprint import plan_of
from .framed import finest_framed
from .kept import close_subtree, keep_taken, next_kept, open_subtree, take
from .level_ground import walk_level_ground
from .walk_state import STACK, Walk, Written, put_results

wp.set_module_options({"enable_backward": False})

# Instead of being split: leaves come from a table, from the last frame, or from a walk over level ground.
BLOCK = wp.constant(2)
TAKEN = wp.constant(3)
WALKED = wp.constant(4)
# A subtree is kept from where errors are up to so many times those of its leaves; of fewer leaves rather a larger one.
# Of a flight over rough ground, 1 M leaves, 77 % are taken from the last frame at 16 times, 88 % at 8, 90 % at 6.
ERRORS_KEPT = wp.constant(wp.float64(8.0))
FEW_LEAVES = wp.constant(8)


@wp.func
def is_inside(w: Walk, cell: wp.uint64, size: wp.uint64, start: wp.uint64, at: wp.uint64) -> wp.bool:
    """Whether the leaves below a triangle are in this slice, and neither the square's first nor its last."""
    inside = cell > wp.uint64(0) and cell + size < (wp.uint64(1) << wp.uint64(w.cell_bits))
    return inside and cell >= start and at + size <= w.end_cell


@wp.func
def is_apart(left: wp.vec2i, apex: wp.vec2i, right: wp.vec2i, corner: wp.vec2i, side: wp.int32, grid: wp.int32):
    """Whether leaves below a triangle do not depend on what is around it: in a grid, away from the square's border."""
    return grid == 0 or not touches_border(left, apex, right, corner, side)


def _compiled(name: str, keeps: bool) -> wp.Kernel:
    """The walk as kernel `name`: with coherence from frame to frame; or without, an eighth faster if none is kept."""

    def walk(domain: Domain, asked: Asked, w: Walk):
        """Refine the leaves whose first deepest cell lies in the slice; what does not fit is only counted."""
        columns = domain.columns
        side = wp.int32(1) << domain.unit_bits
        cells = wp.uint64(1) << wp.uint64(w.cell_bits)
        limits = limits_of(asked, w.slack)
        plan = plan_of(domain, asked, w.max_depth)
        n = Written()
        worst = Bounds()  # maxima over the leaves
        # Own error and what resampling moved of the leaves that have the most error in metres and in pixels.
        in_metres = wp.vec2f()
        in_pixels = wp.vec2f()
        # The subtree that is open: where it ends (0: none is), what there was before it, by how much spans may change
        # in it, and what its leaves have at most: never more than the maxima so far.
        end = wp.uint64(0)
        first = Written()
        fall = wp.float64(0.0)
        rise = wp.float64(0.0)
        most = Bounds()
        most_error = wp.float32(-1.0)  # metres before scaling
        mark = wp.int32(0)  # its number: what other subtrees remember has other bounds
        count = wp.int64(0)  # subtrees that are kept
        taken = wp.int64(0)
        runs = wp.int64(0)  # of leaves that were taken
        point_runs = wp.int64(0)
        kept, kept_cell, kept_depth, kept_leaves = next_kept(w, wp.int64(-1))
        place = w.slot * STACK
        for k in range(REMEMBERED):
            w.remembered[w.slot * REMEMBERED + k].x = -1
        sides = 4 * w.slot * domain.columns * domain.rows
        square = wp.int32(w.first_cell >> wp.uint64(w.cell_bits))
        start = w.first_cell & (cells - wp.uint64(1))
        while (wp.uint64(square) << wp.uint64(w.cell_bits)) < w.end_cell and n.leaves <= w.leaf_limit:
            row = square / columns
            column = square - row * columns
            x0 = column << domain.unit_bits
            y0 = row << domain.unit_bits
            square_cell = wp.uint64(square) << wp.uint64(w.cell_bits)
            # The first of the square's two halves, the other put aside; nothing is certain of either.
            cell = wp.uint64(0)
            depth = wp.int32(1)
            state = wp.int32(LEG_HYP)
            left_x = x0
            left_y = y0 + side
            apex_x = x0
            apex_y = y0
            right_x = x0 + side
            right_y = y0
            top = wp.int32(1)
            w.stack[place] = wp.vec4i(x0 + side, y0 + side, x0, y0 + side)
            w.aside[place] = HYP_LEG | (1 << 3) | (place << 9)
            held = place  # the band that holds here
            w.bands[place] = nothing_certain()
            inside = wp.int32(1)
            while inside == 1 and n.leaves <= w.leaf_limit:
                size = wp.uint64(1) << wp.uint64(w.cell_bits - depth)
                at = square_cell + cell
                split = wp.int32(0)
                if keeps:
                    if kept_cell <= at:
                        while kept_cell < at or (kept_cell == at and kept_depth < depth):
                            kept, kept_cell, kept_depth, kept_leaves = next_kept(w, kept)
                        if kept_cell == at and kept_depth == depth:
                            subtree, holds = carried(asked, w.motion, w.last_kept[kept], w.bands[held].clear)
                            # Where one of its leaves may have the most of all, that is found out anew.
                            if holds == 1 and within(subtree.most, worst) and cell >= start and at + size <= w.end_cell:
                                split = TAKEN
                                runs, point_runs = take(w, subtree, n, runs, point_runs)
                                if end == wp.uint64(0):
                                    count = keep_taken(w, subtree, count, n)
                                else:
                                    fall = smaller(fall, subtree.fall)
                                    rise = smaller(rise, subtree.rise)
                                    # Field by field: what is assigned whole inside of branches, Warp copies after
                                    # every one of them, taken or not. That was 7 % of the walk.
                                    most.px2 = larger(most.px2, subtree.most.px2)
                                    most.total_px2 = larger(most.total_px2, subtree.most.total_px2)
                                    most.long_px2 = larger(most.long_px2, subtree.most.long_px2)
                                    most.legs_px2 = larger(most.legs_px2, subtree.most.legs_px2)
                                    most.metres2 = larger(most.metres2, subtree.most.metres2)
                                    most.total2 = larger(most.total2, subtree.most.total2)
                                n.leaves += wp.int64(subtree.leaves)
                                n.vertices += wp.int64(subtree.vertices)
                                n.edges += wp.int64(subtree.edges)
                                taken += wp.int64(subtree.leaves)
                            kept, kept_cell, kept_depth, kept_leaves = next_kept(w, kept)
                x = (left_x + right_x) >> 1
                y = (left_y + right_y) >> 1
                left = wp.vec2i(left_x, left_y)
                apex = wp.vec2i(apex_x, apex_y)
                right = wp.vec2i(right_x, right_y)
                above = w.bands[held]
                below = above.even_depth  # of the band for what is below
                if not keeps:
                    if below == LEVEL_GROUND and plan.usable == 1 and worst.long_px2 > wp.float64(0.0):
                        apart = is_apart(left, apex, right, wp.vec2i(x0, y0), side, w.grid)
                        if apart and is_inside(w, cell, size, start, at):
                            after, longest_px2, largest_px2 = walk_level_ground(
                                domain,
                                asked,
                                w,
                                plan,
                                n,
                                worst.long_px2,
                                worst.legs_px2,
                                at,
                                left,
                                apex,
                                right,
                                state,
                                depth,
                                above.leaf_depth,
                                place + top,
                            )
                            n.leaves = after.leaves
                            n.vertices = after.vertices
                            n.edges = after.edges
                            worst.long_px2 = longest_px2
                            worst.legs_px2 = largest_px2
                            split = WALKED
                error = wp.float32(0.0)  # where only depths decide, errors need not be read
                if above.even_depth == 0 and split == 0:
                    error = error_at(domain, x, y, depth)
                own = wp.float64(error) * domain.error_scale
                known = wp.int32(1)
                if split == 0:
                    if depth < w.max_depth:
                        if depth < above.split_depth or own > above.split_above:
                            split = 1
                            if above.even_depth < 0 and above.leaf_depth - depth > 3:
                                known = 0  # a narrower band may leave the depth in no doubt
                        elif own > above.leaf_up_to:
                            known = 0
                        # A subtree begins where a diamond is measured; on the way to one that is kept none does.
                        if keeps:
                            if end == wp.uint64(0):
                                if kept_cell >= at + size or kept_leaves < FEW_LEAVES:
                                    known = 0
                    if split == 0 and (depth < above.leaf_depth or not quiet(above, own, most)):
                        known = 0
                memory = wp.int32(0)
                if known == 0:
                    # It may have been measured from its other triangle: behind an edge that the curve has passed.
                    memory = w.slot * REMEMBERED + remembered_at(x, y)
                    if hypotenuse_passed(state):
                        met = w.remembered[memory]
                        if met.x == x and met.y == y and met.mark == mark:
                            known = 1
                            split = 0
                            if met.split_depth != NOT_SPLIT:
                                split = 1
                                w.bands[place + top] = met
                                held = place + top
                                below = met.even_depth
                if known == 0:
                    m = measured_at(domain, asked, x, y, depth, error, above.clear)
                    long2 = m.long2 + m.climb2
                    legs2 = m.legs2 + m.climb2
                    split = wp.int32(depth < w.max_depth and too_coarse(asked, m.pixel2, m.metres2, long2, legs2))
                    if split == 1:
                        band = band_below(domain, asked, limits, m, depth, w.max_depth, above.clear, worst)
                        if keeps:
                            span = wp.sqrt(m.pixel2)
                            # A subtree is kept from where few bisections are left.
                            few = own <= ERRORS_KEPT * band.leaf_up_to and band.leaf_depth - depth <= MAX_BISECTIONS
                            few = (few or w.max_depth - depth <= 6) and end == wp.uint64(0)
                            few = few and is_inside(w, cell, size, start, at)
                            if few and is_apart(left, apex, right, wp.vec2i(x0, y0), side, w.grid):
                                open_subtree(asked, w, count, at, depth, m)
                                end = at + size
                                first.leaves = n.leaves
                                first.vertices = n.vertices
                                first.edges = n.edges
                                fall = w.slack * span
                                rise = w.slack * span
                                most.px2 = wp.float64(0.0)
                                most.total_px2 = wp.float64(0.0)
                                most.long_px2 = wp.float64(0.0)
                                most.legs_px2 = wp.float64(0.0)
                                most.metres2 = wp.float64(0.0)
                                most.total2 = wp.float64(0.0)
                                most_error = wp.float32(-1.0)
                                mark += 1
                            if not m.metres2 > asked.limit * asked.metres2:
                                rise = smaller(rise, turning_span(limits, m) - span)
                            b = unmeasured_below(domain, asked, band, m, w.max_depth)
                            most.px2 = larger(most.px2, b.px2)
                            most.total_px2 = larger(most.total_px2, b.total_px2)
                            most.long_px2 = larger(most.long_px2, b.long_px2)
                            most.legs_px2 = larger(most.legs_px2, b.legs_px2)
                            most.metres2 = larger(most.metres2, b.metres2)
                            most.total2 = larger(most.total2, b.total2)
                            band.mark = mark
                        band.x = x
                        band.y = y
                        w.remembered[memory] = band
                        w.bands[place + top] = band
                        held = place + top
                        below = band.even_depth
                    else:
                        w.remembered[memory].split_depth = NOT_SPLIT
                        w.remembered[memory].mark = mark
                        w.remembered[memory].x = x
                        w.remembered[memory].y = y
                        if keeps:
                            if depth < w.max_depth:
                                fall = smaller(fall, wp.sqrt(m.pixel2) - turning_span(limits, m))
                        if cell >= start:
                            near2 = m.pixel2 * limits.below
                            if m.metres2 > most.px2 * near2 or m.total2 > most.total_px2 * near2:
                                seen2 = m.pixel2
                                if m.metres2 > worst.px2 * near2 or m.total2 > worst.total_px2 * near2:
                                    seen2 = finest_framed(domain, asked, m.diamond, left, right, depth, above.clear)
                                    if keeps:
                                        if above.clear == 0:  # the next frustum cuts off another part
                                            fall = wp.float64(0.0)
                                most.px2 = larger(most.px2, m.metres2 / seen2)
                                worst.px2 = larger(worst.px2, m.metres2 / seen2)
                                most.total_px2 = larger(most.total_px2, m.total2 / seen2)
                                if m.total2 / seen2 > worst.total_px2:
                                    worst.total_px2 = m.total2 / seen2
                                    in_pixels = wp.vec2f(error, m.moved)
                            if asked.measures_edges == 1:
                                if long2 > most.long_px2 * near2:
                                    most.long_px2 = larger(most.long_px2, long2 / m.pixel2)
                                    worst.long_px2 = larger(worst.long_px2, long2 / m.pixel2)
                                if legs2 > most.legs_px2 * near2:
                                    most.legs_px2 = larger(most.legs_px2, legs2 / m.pixel2)
                                    worst.legs_px2 = larger(worst.legs_px2, legs2 / m.pixel2)
                levels = below - depth
                if split == 1 and levels > 0 and levels <= MAX_BISECTIONS and is_inside(w, cell, size, start, at):
                    if is_apart(left, apex, right, wp.vec2i(x0, y0), side, w.grid):
                        even = 1 << levels
                        created = new_vertices(w.blocks, state, levels)
                        if n.leaves + wp.int64(even) <= w.leaf_capacity:
                            write_block(
                                w.blocks,
                                state,
                                levels,
                                left,
                                apex,
                                right,
                                wp.uint16(leaf_word(0, below)),
                                w.code,
                                w.leaf_base + n.leaves,
                                w.point,
                                w.leaf_base + n.vertices,
                            )
                            number_cells(w.cell, w.leaf_base + n.leaves, even, at, size >> wp.uint64(levels))
                        n.leaves += wp.int64(even)
                        n.vertices += wp.int64(created)
                        n.edges += wp.int64(even + created)
                        split = BLOCK
                if split == 1:
                    depth += 1
                    if below == 0:
                        if leaves_tile(domain, depth):  # the children's children, a step ahead: 65 ns a leaf become 60
                            fetch_ahead(domain, (left_x + x) >> 1, (left_y + y) >> 1, depth + 1)
                            fetch_ahead(domain, (apex_x + x) >> 1, (apex_y + y) >> 1, depth + 1)
                            fetch_ahead(domain, (right_x + x) >> 1, (right_y + y) >> 1, depth + 1)
                    if cell + (size >> wp.uint64(1)) > start:
                        put_corners(w.stack, place + top, wp.vec4i(x, y, right_x, right_y))
                        put(w.aside, wp.int64(place + top), right_state(state, cell) | (depth << 3) | (held << 9))
                        top += 1
                        state = left_state(state)
                        right_x = apex_x
                        right_y = apex_y
                    else:  # on the way to the slice's first cell
                        state = right_state(state, cell)
                        left_x = apex_x
                        left_y = apex_y
                        cell += size >> wp.uint64(1)
                    apex_x = x
                    apex_y = y
                else:
                    if split == 0 and cell >= start:
                        if error > most_error or domain.resampled == 1:
                            most_error = wp.max(most_error, error)
                            moved = moved_at(domain, x, y, depth)
                            metres2, total2 = metres2_of(domain, error, moved)
                            most.metres2 = larger(most.metres2, metres2)
                            most.total2 = larger(most.total2, total2)
                            worst.metres2 = larger(worst.metres2, metres2)
                            if total2 > worst.total2:
                                worst.total2 = total2
                                in_metres = wp.vec2f(error, moved)
                        room = wp.where(n.leaves < w.leaf_capacity, 1, 0)
                        code = leaf_word(state, depth)
                        if cell == wp.uint64(0):  # the curve enters the square through the upper end of its left side
                            code = code | (wp.uint32(1) << wp.uint32(FIRST))
                            ahead = end_of_entry(state, apex, right)
                            if column > 0:
                                w.sides[sides + 4 * square] = w.sides[sides + 4 * square] + 1
                            else:
                                n.edges += wp.int64(1)
                                if room == 1:
                                    w.point[w.leaf_base + n.vertices] = left
                                n.vertices += wp.int64(1)
                                if row > 0 and ahead[1] == y0:
                                    code = code | (wp.uint32(1) << wp.uint32(CORNER))
                                else:
                                    if room == 1:
                                        w.point[w.leaf_base + n.vertices] = ahead
                                    n.vertices += wp.int64(1)
                        new_edge = 1 - (state & 1)
                        new_vertex = new_edge
                        p, q = third_edge(state, left, apex, right)
                        if w.grid == 1 and new_edge == 1:
                            role = border_role(p, q, wp.vec2i(x0, y0), side, column, row, columns, domain.rows)
                            code = code | (wp.uint32(role) << wp.uint32(BORDER))
                            if role != INNER and role != TO_CORNER:
                                w.sides[sides + 4 * square + role - 1] = w.sides[sides + 4 * square + role - 1] + 1
                            if role == TAKE_LEFT or role == TAKE_BELOW:
                                new_edge = 0
                                new_vertex = 0
                            if role == TO_CORNER:
                                new_vertex = 0
                        if room == 1:
                            put_pair(w.point, w.leaf_base + n.vertices, q)  # stays only if it is new
                        n.vertices += wp.int64(new_vertex)
                        n.edges += wp.int64(new_edge + 1)  # with the edge through which the curve leaves
                        if cell + size == cells:
                            code = code | (wp.uint32(1) << wp.uint32(LAST))
                            if row < domain.rows - 1:
                                w.sides[sides + 4 * square + 3] = w.sides[sides + 4 * square + 3] + 1
                        if room == 1:
                            put_cell(w.cell, w.leaf_base + n.leaves, at)
                            put_code(w.code, w.leaf_base + n.leaves, wp.uint16(code))
                        n.leaves += wp.int64(1)
                    # On along the curve, to the next triangle that was put aside.
                    cell += size
                    if end > wp.uint64(0) and square_cell + cell >= end:
                        count = close_subtree(w, count, first, n, fall, rise, most)
                        end = wp.uint64(0)
                        mark += 1
                    if top == 0 or square_cell + cell >= w.end_cell:
                        inside = 0
                    else:
                        top -= 1
                        left_x = right_x
                        left_y = right_y
                        corners = corners_at(w.stack, place + top)
                        apex_x = corners[0]
                        apex_y = corners[1]
                        right_x = corners[2]
                        right_y = corners[3]
                        put_aside = number_at(w.aside, place + top)
                        state = put_aside & 7
                        depth = (put_aside >> 3) & 63
                        held = put_aside >> 9
            square += 1
            start = wp.uint64(0)
        if keeps:
            w.kept_counts[w.slot] = count
            w.taken[w.slot] = taken
            w.run_counts[w.slot] = runs
            w.point_run_counts[w.slot] = point_runs
        put_results(w, n, worst, in_pixels, in_metres)

    walk.__qualname__ = name
    return wp.kernel(walk)


walk = _compiled("walk", keeps=False)
keeping_walk = _compiled("keeping_walk", keeps=True)
