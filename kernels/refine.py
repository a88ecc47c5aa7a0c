# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement: one walk over the diamonds in curve order.

Below a diamond that is split, a *band* says what is certain: between the finest and the coarsest pixel on its box lie
those of all boxes inside it (they are nested), so most diamonds are decided by a look at their error, or at nothing but
their depth. Only one that falls between is measured, and makes a narrower band for what is below it; when the curve
comes to its other triangle, it is remembered. Margins are far above rounding: the mesh is the one that measuring every
diamond gives.

The walk writes a word of 16 bits a leaf (kernels/curve.py) and one point a new vertex, all that the welding needs, and
the leaves' bits of the tree.
"""

import warp as wp

from .band import NOT_SPLIT, REMEMBERED, Band, leaves_below, not_split, nothing_certain, remembered_at, splits_below
from .block import MAX_BISECTIONS, new_vertices, write_block, write_words
from .criterion import (
    Asked,
    Domain,
    coarsest,
    diamond_at,
    error_at,
    fetch_ahead,
    finest,
    larger,
    leaves_tile,
    metres2_of,
    moved_at,
    own_for,
    sizes,
    smaller,
    too_coarse,
)
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
    hypotenuse_passed,
    leaf_word,
    left_state,
    right_state,
    touches_border,
)
from .unchecked import (
    corners_at,
    height_at,
    number_at,
    put,
    put_code,
    put_corners,
    put_height,
    put_pair,
    put_word,
)
from .walk_state import STACK, Walk

wp.set_module_options({"enable_backward": False})

ABOVE = wp.constant(wp.float64(1.0 + 1e-9))
BELOW = wp.constant(wp.float64(1.0 - 1e-9))


@wp.kernel
def walk(domain: Domain, asked: Asked, w: Walk):
    """Refine the leaves whose first deepest cell lies in the slice; what does not fit is only counted."""
    columns = domain.columns
    side = wp.int32(1) << domain.unit_bits
    cells = wp.uint64(1) << wp.uint64(w.cell_bits)
    leaves = wp.int64(0)
    vertices = wp.int64(0)
    edges = wp.int64(0)
    words = wp.int64(0)
    word = wp.int64(-1)
    bits = wp.uint64(0)
    # Maxima over the leaves.
    worst_px2 = wp.float64(0.0)
    worst_px = wp.float64(0.0)
    worst_total_px2 = wp.float64(0.0)
    worst_total_px = wp.float64(0.0)
    worst_long_px2 = wp.float64(0.0)
    worst_legs_px2 = wp.float64(0.0)
    worst_error = wp.float32(-1.0)  # metres before scaling
    worst_metres2 = wp.float64(0.0)
    worst_total2 = wp.float64(0.0)
    # Own error and what resampling moved of the leaves that have the most error in metres and in pixels.
    in_metres = wp.vec2f()
    in_pixels = wp.vec2f()
    error_px = wp.sqrt(asked.limit * asked.error_px2)
    metres_below = wp.sqrt(asked.limit * asked.metres2 * BELOW)
    metres_above = wp.sqrt(asked.limit * asked.metres2 * ABOVE)
    place = w.slot * STACK
    for k in range(REMEMBERED):
        w.remembered[w.slot * REMEMBERED + k].x = -1
    sides = 4 * w.slot * domain.columns * domain.rows
    square = wp.int32(w.first_cell >> wp.uint64(w.cell_bits))
    start = w.first_cell & (cells - wp.uint64(1))
    while (wp.uint64(square) << wp.uint64(w.cell_bits)) < w.end_cell and leaves <= w.leaf_limit:
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
        error = error_at(domain, x0 + (side >> 1), y0 + (side >> 1), 1)
        w.errors[place] = error
        held = place  # the band that holds here
        w.bands[place] = nothing_certain()
        inside = wp.int32(1)
        while inside == 1 and leaves <= w.leaf_limit:
            size = wp.uint64(1) << wp.uint64(w.cell_bits - depth)
            above = w.bands[held]
            x = (left_x + right_x) >> 1
            y = (left_y + right_y) >> 1
            own = wp.float64(error) * domain.error_scale
            split = wp.int32(0)
            known = wp.int32(1)
            if depth < w.max_depth:
                if depth < above.split_depth or own > above.split_above:
                    split = 1
                    if above.even_depth < 0 and above.leaf_depth - depth > 3:
                        known = 0  # a narrower band may leave the depth in no doubt
                elif own > above.leaf_up_to:
                    known = 0
            if split == 0 and (depth < above.leaf_depth or not own <= above.quiet_up_to):
                known = 0
            memory = wp.int32(0)
            below = above.even_depth  # of the band for what is below
            if known == 0:
                # The diamond may have been measured from its other triangle: behind an edge that the curve has passed.
                memory = w.slot * REMEMBERED + remembered_at(x, y)
                if hypotenuse_passed(state):
                    met = w.remembered[memory]
                    if met.x == x and met.y == y:
                        known = 1
                        split = 0
                        if met.split_depth != NOT_SPLIT:
                            split = 1
                            w.bands[place + top] = met
                            held = place + top
                            below = met.even_depth
            if known == 0:
                diamond = diamond_at(domain, x, y, depth)
                pixel2 = finest(asked, diamond, above.clear)
                moved = moved_at(domain, x, y, depth)
                metres2, total2 = metres2_of(domain, error, moved)
                long2, legs2 = sizes(asked, domain.unit_bits, depth)
                climb2 = diamond.rise * diamond.rise
                if depth < w.max_depth and too_coarse(asked, pixel2, metres2, long2 + climb2, legs2 + climb2):
                    split = 1
                    band = Band()
                    band.x = x
                    band.y = y
                    # Errors that never ask for a split: by the finest pixel below, with all that moved here.
                    fine2 = pixel2 * BELOW
                    fine = wp.sqrt(fine2)
                    rest = wp.float64(moved) * domain.error_scale + domain.rounding
                    band.leaf_up_to = own_for(smaller(error_px * fine, metres_below), rest)
                    band.quiet_up_to = smaller(own_for(worst_px * fine, rest), worst_total_px * fine - rest)
                    band.leaf_depth = leaves_below(
                        asked, depth, w.max_depth, long2, legs2, climb2, fine2, worst_long_px2, worst_legs_px2
                    )
                    # No error below asks for a split or is a new maximum: depths alone decide.
                    calm = asked.measures_edges == 1 and own <= smaller(band.leaf_up_to, band.quiet_up_to)
                    calm = calm and metres2 <= worst_metres2 and total2 <= worst_total2
                    if calm and band.leaf_depth == depth + 1:  # whatever the coarsest pixel is
                        band.split_above = wp.float64(wp.inf)
                        band.split_depth = depth + 1
                        band.even_depth = depth + 1
                        band.clear = above.clear
                    else:
                        coarse2, inside_all = coarsest(asked, diamond, above.clear)
                        coarse2 = coarse2 * ABOVE
                        band.split_above = own_for(smaller(error_px * wp.sqrt(coarse2), metres_above), domain.rounding)
                        band.split_depth = splits_below(asked, depth, w.max_depth, long2, legs2, coarse2)
                        band.clear = inside_all
                        if calm:
                            band.even_depth = wp.where(band.split_depth == band.leaf_depth, band.leaf_depth, -1)
                    w.remembered[memory] = band
                    w.bands[place + top] = band
                    held = place + top
                    below = band.even_depth
                else:
                    w.remembered[memory] = not_split(x, y)
                if split == 0 and cell >= start:
                    near2 = pixel2 * BELOW
                    if metres2 > worst_px2 * near2:
                        worst_px2 = larger(worst_px2, metres2 / pixel2)
                        worst_px = wp.sqrt(worst_px2)
                    if total2 > worst_total_px2 * near2:
                        total_px2 = total2 / pixel2
                        if total_px2 > worst_total_px2:
                            worst_total_px2 = total_px2
                            worst_total_px = wp.sqrt(worst_total_px2)
                            in_pixels = wp.vec2f(error, moved)
                    if long2 + climb2 > worst_long_px2 * near2:
                        worst_long_px2 = larger(worst_long_px2, (long2 + climb2) / pixel2)
                    if legs2 + climb2 > worst_legs_px2 * near2:
                        worst_legs_px2 = larger(worst_legs_px2, (legs2 + climb2) / pixel2)
            levels = below - depth
            if split == 1 and levels > 0 and levels <= MAX_BISECTIONS and cell > wp.uint64(0) and cell >= start:
                left = wp.vec2i(left_x, left_y)
                apex = wp.vec2i(apex_x, apex_y)
                right = wp.vec2i(right_x, right_y)
                whole = size >= wp.uint64(64) and cell + size < cells and square_cell + cell + size <= w.end_cell
                if whole and (w.grid == 0 or not touches_border(left, apex, right, wp.vec2i(x0, y0), side)):
                    count = 1 << levels
                    created = new_vertices(w.blocks, state, levels)
                    if leaves + wp.int64(count) <= w.leaf_capacity:
                        if word >= wp.int64(0):
                            put_word(w.word_index, w.word_bits, w.leaf_base + words, word, bits)
                            words += wp.int64(1)
                            word = wp.int64(-1)
                        write_block(
                            w.blocks,
                            state,
                            levels,
                            left,
                            apex,
                            right,
                            wp.uint16(leaf_word(0, below)),
                            w.code,
                            w.leaf_base + leaves,
                            w.point,
                            w.leaf_base + vertices,
                        )
                        first = w.leaf_base + words
                        words += wp.int64(
                            write_words(square_cell + cell, size, levels, w.word_index, w.word_bits, first)
                        )
                    leaves += wp.int64(count)
                    vertices += wp.int64(created)
                    edges += wp.int64(count + created)
                    split = 2
            if split == 1:
                depth += 1
                near_error = wp.float32(0.0)  # where only depths decide, errors need not be read
                next_error = wp.float32(0.0)
                if below == 0:
                    near_error = error_at(domain, (left_x + apex_x) >> 1, (left_y + apex_y) >> 1, depth)
                    next_error = error_at(domain, (apex_x + right_x) >> 1, (apex_y + right_y) >> 1, depth)
                    if leaves_tile(domain, depth):  # the children's children, a step ahead: 65 ns a leaf become 60
                        fetch_ahead(domain, (left_x + x) >> 1, (left_y + y) >> 1, depth + 1)
                        fetch_ahead(domain, (apex_x + x) >> 1, (apex_y + y) >> 1, depth + 1)
                        fetch_ahead(domain, (right_x + x) >> 1, (right_y + y) >> 1, depth + 1)
                if cell + (size >> wp.uint64(1)) > start:
                    put_corners(w.stack, place + top, wp.vec4i(x, y, right_x, right_y))
                    put(w.aside, wp.int64(place + top), right_state(state, cell) | (depth << 3) | (held << 9))
                    put_height(w.errors, place + top, next_error)
                    error = near_error
                    top += 1
                    state = left_state(state)
                    right_x = apex_x
                    right_y = apex_y
                else:  # on the way to the slice's first cell
                    state = right_state(state, cell)
                    left_x = apex_x
                    left_y = apex_y
                    error = next_error
                    cell += size >> wp.uint64(1)
                apex_x = x
                apex_y = y
            else:
                if split == 0 and cell >= start:
                    if error > worst_error or domain.resampled == 1:
                        worst_error = error
                        moved = moved_at(domain, x, y, depth)
                        metres2, total2 = metres2_of(domain, error, moved)
                        worst_metres2 = larger(worst_metres2, metres2)
                        if total2 > worst_total2:
                            worst_total2 = total2
                            in_metres = wp.vec2f(error, moved)
                    room = wp.where(leaves < w.leaf_capacity, 1, 0)
                    code = leaf_word(state, depth)
                    passage = state & 6
                    if cell == wp.uint64(0):  # the curve enters the square through the upper end of its left side
                        code = code | (wp.uint32(1) << wp.uint32(FIRST))
                        end = wp.vec2i(apex_x, apex_y)
                        if passage == HYP_LEG:
                            end = wp.vec2i(right_x, right_y)
                        if column > 0:
                            w.sides[sides + 4 * square] = w.sides[sides + 4 * square] + 1
                        else:
                            edges += wp.int64(1)
                            if room == 1:
                                w.point[w.leaf_base + vertices] = wp.vec2i(left_x, left_y)
                            vertices += wp.int64(1)
                            if row > 0 and end[1] == y0:
                                code = code | (wp.uint32(1) << wp.uint32(CORNER))
                            else:
                                if room == 1:
                                    w.point[w.leaf_base + vertices] = end
                                vertices += wp.int64(1)
                    # The third edge, if it is new: left - apex, apex - right or right - left, to the new vertex q.
                    new_edge = 1 - (state & 1)
                    new_vertex = new_edge
                    q_x = wp.where(passage == HYP_LEG, apex_x, right_x)
                    q_y = wp.where(passage == HYP_LEG, apex_y, right_y)
                    if w.grid == 1 and new_edge == 1:
                        p_x = wp.where(passage == LEG_HYP, apex_x, left_x)
                        p_y = wp.where(passage == LEG_HYP, apex_y, left_y)
                        role = border_role(
                            wp.vec2i(p_x, p_y),
                            wp.vec2i(q_x, q_y),
                            wp.vec2i(x0, y0),
                            side,
                            column,
                            row,
                            columns,
                            domain.rows,
                        )
                        code = code | (wp.uint32(role) << wp.uint32(BORDER))
                        if role != INNER and role != TO_CORNER:
                            w.sides[sides + 4 * square + role - 1] = w.sides[sides + 4 * square + role - 1] + 1
                        if role == TAKE_LEFT or role == TAKE_BELOW:
                            new_edge = 0
                            new_vertex = 0
                        if role == TO_CORNER:
                            new_vertex = 0
                    if room == 1:
                        put_pair(w.point, w.leaf_base + vertices, wp.vec2i(q_x, q_y))  # stays only if it is new
                    vertices += wp.int64(new_vertex)
                    edges += wp.int64(new_edge)
                    edges += wp.int64(1)  # the edge through which the curve leaves
                    if cell + size == cells:
                        code = code | (wp.uint32(1) << wp.uint32(LAST))
                        if row < domain.rows - 1:
                            w.sides[sides + 4 * square + 3] = w.sides[sides + 4 * square + 3] + 1
                    at = square_cell + cell
                    if wp.int64(at >> wp.uint64(6)) != word:
                        if word >= wp.int64(0) and room == 1:
                            put_word(w.word_index, w.word_bits, w.leaf_base + words, word, bits)
                            words += wp.int64(1)
                        word = wp.int64(at >> wp.uint64(6))
                        bits = wp.uint64(0)
                    bits = bits | (wp.uint64(1) << (at & wp.uint64(63)))
                    if room == 1:
                        put_code(w.code, w.leaf_base + leaves, wp.uint16(code))
                    leaves += wp.int64(1)
                # On along the curve, to the next triangle that was put aside.
                cell += size
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
                    kept = number_at(w.aside, place + top)
                    error = height_at(w.errors, wp.int64(place + top))
                    state = kept & 7
                    depth = (kept >> 3) & 63
                    held = kept >> 9
        square += 1
        start = wp.uint64(0)
    if word >= wp.int64(0) and leaves <= w.leaf_capacity:
        put_word(w.word_index, w.word_bits, w.leaf_base + words, word, bits)
        words += wp.int64(1)
    c = 4 * w.slot
    w.counts[c] = leaves
    w.counts[c + 1] = vertices
    w.counts[c + 2] = edges
    w.counts[c + 3] = words
    b = 10 * w.slot
    w.bounds[b] = worst_px2
    w.bounds[b + 1] = worst_total_px2
    w.bounds[b + 2] = worst_long_px2
    w.bounds[b + 3] = worst_legs_px2 * wp.float64(0.5)
    w.bounds[b + 4] = worst_metres2
    w.bounds[b + 5] = worst_total2
    w.bounds[b + 6] = wp.float64(in_pixels[0])
    w.bounds[b + 7] = wp.float64(in_pixels[1])
    w.bounds[b + 8] = wp.float64(in_metres[0])
    w.bounds[b + 9] = wp.float64(in_metres[1])
