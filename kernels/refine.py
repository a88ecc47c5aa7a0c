# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement: one walk over the diamonds in curve order.

Child 0 of a triangle (left, apex, right) is (left, middle, apex), child 1 is (apex, middle, right): depth-first order
is the Sierpinski curve, so consecutive leaves share an edge. A leaf is entered and left through known edges; whether
its third edge was passed before is carried down the walk in a state of three bits. The walk writes one word a leaf and
one point a new vertex, all that the welding needs, and the leaves' bits of the tree.

Root squares are walked row by row, each a closed curve from its upper left corner, counter-clockwise along its border:
left side down, bottom right, right side up, top left. So a side that a square shares with an earlier one is passed in
the opposite direction, last edge first.
"""

import warp as wp

from .criterion import Asked, Domain, excess, measure

wp.set_module_options({"enable_backward": False})

# A leaf's word of 16 bits: state, parity of the depth, role of the third edge on the square's border, flags, depth.
STATE = wp.constant(7)
PARITY = wp.constant(3)  # shifts
BORDER = wp.constant(4)
FIRST = wp.constant(7)  # the square's first leaf
CORNER = wp.constant(8)  # ... whose entry edge ends on the corner that the square below has made
DEPTH_SHIFT = wp.constant(9)
LAST = wp.constant(15)  # the square's last leaf

# Types of passage: entered by a leg and left by a leg, by hypotenuse and leg, by leg and hypotenuse. A state is a type
# and, as its lowest bit, whether the third edge is old.
LEG_LEG = wp.constant(0)
HYP_LEG = wp.constant(2)
LEG_HYP = wp.constant(4)

# Roles of a third edge on the border of its square.
INNER = wp.constant(0)  # not on a side that is shared with another square
TAKE_LEFT = wp.constant(1)  # the square to the left has made it
TAKE_BELOW = wp.constant(2)
GIVE_RIGHT = wp.constant(3)  # the square to the right will take it
GIVE_ABOVE = wp.constant(4)
TO_CORNER = wp.constant(5)  # a new edge to a vertex that the square below has made


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
    slot: wp.int32  # row of stacks, counts and bounds
    grid: wp.int32  # 1: several squares, borders are tracked
    code: wp.array(dtype=wp.uint16)
    point: wp.array(dtype=wp.vec2i)
    word_index: wp.array(dtype=wp.int64)
    word_bits: wp.array(dtype=wp.uint64)
    stack: wp.array(dtype=wp.vec4i)
    states: wp.array(dtype=wp.int32)
    sides: wp.array(dtype=wp.int32)  # per square: edges taken left, below, given right, above
    counts: wp.array(dtype=wp.int64)  # per slice: leaves, vertices, edges, words
    bounds: wp.array(dtype=wp.float64)  # per slice: largest of all that `measure` returns


@wp.func
def left_state(state: wp.int32) -> wp.int32:
    """State of child 0."""
    old = state & 1
    s = HYP_LEG + old
    if state >= LEG_HYP:
        s = HYP_LEG
    elif state >= HYP_LEG:
        s = LEG_LEG + old
    return s


@wp.func
def right_state(state: wp.int32, heap: wp.uint64) -> wp.int32:
    """State of child 1."""
    old = state & 1
    s = LEG_HYP + old
    if state >= LEG_HYP:
        s = LEG_LEG + old
    elif state >= HYP_LEG:
        s = LEG_HYP + 1
        if (heap & (heap - wp.uint64(1))) == wp.uint64(0):
            s = LEG_HYP  # the curve starts on the border: the other half of its entry edge was never passed
    return s


@wp.func
def border_role(
    p: wp.vec2i,
    q: wp.vec2i,
    corner: wp.vec2i,
    side: wp.int32,
    column: wp.int32,
    row: wp.int32,
    columns: wp.int32,
    rows: wp.int32,
):
    """Role of the third edge p - q of a leaf in the square at `corner`."""
    role = INNER
    if p[0] == q[0]:
        if p[0] == corner[0]:
            if column > 0:
                role = TAKE_LEFT
            elif row > 0 and wp.min(p[1], q[1]) == corner[1]:
                role = TO_CORNER
        elif p[0] == corner[0] + side and column < columns - 1:
            role = GIVE_RIGHT
    elif p[1] == q[1]:
        if p[1] == corner[1] and row > 0:
            role = TAKE_BELOW
        elif p[1] == corner[1] + side and row < rows - 1:
            role = GIVE_ABOVE
    return role


@wp.kernel
def walk(domain: Domain, asked: Asked, w: Walk):
    """Refine the leaves whose first deepest cell lies in the slice; what does not fit is counted all the same."""
    columns = domain.columns
    side = wp.int32(1) << domain.unit_bits
    cells = wp.uint64(1) << wp.uint64(w.cell_bits)
    leaves = wp.int64(0)
    vertices = wp.int64(0)
    edges = wp.int64(0)
    words = wp.int64(0)
    word = wp.int64(-1)
    bits = wp.uint64(0)
    worst_error = wp.float64(0.0)
    worst_total = wp.float64(0.0)
    worst_edge = wp.float64(0.0)
    worst_area = wp.float64(0.0)
    worst_metres = wp.float64(0.0)
    worst_total_metres = wp.float64(0.0)
    place = w.slot * 64
    square = wp.int32(w.first_cell >> wp.uint64(w.cell_bits))
    start = w.first_cell & (cells - wp.uint64(1))
    while (wp.uint64(square) << wp.uint64(w.cell_bits)) < w.end_cell and leaves <= w.leaf_limit:
        row = square / columns
        column = square - row * columns
        corner = wp.vec2i(column << domain.unit_bits, row << domain.unit_bits)
        square_cell = wp.uint64(square) << wp.uint64(w.cell_bits)
        # Descend to the leaf that holds cell `start`, then go on along the curve.
        heap = wp.uint64(1)
        depth = wp.int32(0)
        state = wp.int32(0)
        left = wp.vec2i(0, 0)
        apex = wp.vec2i(0, 0)
        right = wp.vec2i(0, 0)
        inside = wp.int32(1)
        while inside == 1 and leaves <= w.leaf_limit:
            split = wp.int32(0)
            middle = wp.vec2i((left[0] + right[0]) >> 1, (left[1] + right[1]) >> 1)
            error_px2 = wp.float64(0.0)
            total_px2 = wp.float64(0.0)
            edge_px2 = wp.float64(0.0)
            area_px2 = wp.float64(0.0)
            metres = wp.float64(0.0)
            total_metres = wp.float64(0.0)
            if depth == 0:
                split = 1
            else:
                error_px2, total_px2, edge_px2, area_px2, metres, total_metres = measure(
                    domain, asked, middle[0], middle[1], depth
                )
                if depth < w.max_depth and excess(asked, error_px2, edge_px2, area_px2, metres) > asked.limit:
                    split = 1
            if split == 1:
                bit = (start >> wp.uint64(w.cell_bits - depth - 1)) & wp.uint64(1)
                if depth == 0:
                    w.stack[place] = wp.vec4i(corner[0] + side, corner[1] + side, corner[0], corner[1] + side)
                    w.states[place] = HYP_LEG
                    left = wp.vec2i(corner[0], corner[1] + side)
                    apex = corner
                    right = wp.vec2i(corner[0] + side, corner[1])
                    state = LEG_HYP
                    if bit == wp.uint64(1):
                        left = right
                        apex = wp.vec2i(corner[0] + side, corner[1] + side)
                        right = wp.vec2i(corner[0], corner[1] + side)
                        state = HYP_LEG
                else:
                    if bit == wp.uint64(0):
                        w.stack[place + depth] = wp.vec4i(middle[0], middle[1], right[0], right[1])
                        w.states[place + depth] = right_state(state, heap)
                        state = left_state(state)
                        right = apex
                    else:
                        left = apex
                        state = right_state(state, heap)
                    apex = middle
                heap = (heap << wp.uint64(1)) | bit
                depth += 1
            else:
                cell = (heap << wp.uint64(w.cell_bits - depth)) - cells
                if cell >= start:
                    worst_error = wp.max(worst_error, error_px2)
                    worst_total = wp.max(worst_total, total_px2)
                    worst_edge = wp.max(worst_edge, edge_px2)
                    worst_area = wp.max(worst_area, area_px2)
                    worst_metres = wp.max(worst_metres, metres)
                    worst_total_metres = wp.max(worst_total_metres, total_metres)
                    room = wp.int32(0)
                    if leaves < w.leaf_capacity:
                        room = 1
                    code = (
                        wp.uint32(state)
                        | (wp.uint32(depth & 1) << wp.uint32(PARITY))
                        | (wp.uint32(depth) << wp.uint32(DEPTH_SHIFT))
                    )
                    passage = state & 6
                    if cell == wp.uint64(0):  # the curve enters the square through the upper end of its left side
                        code = code | (wp.uint32(1) << wp.uint32(FIRST))
                        end = apex
                        if passage == HYP_LEG:
                            end = right
                        if column > 0:
                            w.sides[4 * square] = w.sides[4 * square] + 1
                        else:
                            edges += wp.int64(1)
                            if room == 1:
                                w.point[w.leaf_base + vertices] = left
                            vertices += wp.int64(1)
                            if row > 0 and end[1] == corner[1]:
                                code = code | (wp.uint32(1) << wp.uint32(CORNER))
                            else:
                                if room == 1:
                                    w.point[w.leaf_base + vertices] = end
                                vertices += wp.int64(1)
                    if (state & 1) == 0:
                        # the third edge: left - apex, apex - right or right - left; its far end is the new vertex
                        p = apex
                        q = right
                        if passage == HYP_LEG:
                            p = left
                            q = apex
                        elif passage == LEG_LEG:
                            p = left
                        role = INNER
                        if w.grid == 1:
                            role = border_role(p, q, corner, side, column, row, columns, domain.rows)
                            if role != INNER and role != TO_CORNER:
                                w.sides[4 * square + role - 1] = w.sides[4 * square + role - 1] + 1
                        code = code | (wp.uint32(role) << wp.uint32(BORDER))
                        if role != TAKE_LEFT and role != TAKE_BELOW:
                            edges += wp.int64(1)
                            if role != TO_CORNER:
                                if room == 1:
                                    w.point[w.leaf_base + vertices] = q
                                vertices += wp.int64(1)
                    edges += wp.int64(1)  # the edge through which the curve leaves
                    if (heap & (heap + wp.uint64(1))) == wp.uint64(0):
                        code = code | (wp.uint32(1) << wp.uint32(LAST))
                        if row < domain.rows - 1:
                            w.sides[4 * square + 3] = w.sides[4 * square + 3] + 1
                    at = square_cell + cell
                    if wp.int64(at >> wp.uint64(6)) != word:
                        if word >= wp.int64(0) and room == 1:
                            w.word_index[w.leaf_base + words] = word
                            w.word_bits[w.leaf_base + words] = bits
                            words += wp.int64(1)
                        word = wp.int64(at >> wp.uint64(6))
                        bits = wp.uint64(0)
                    bits = bits | (wp.uint64(1) << (at & wp.uint64(63)))
                    if room == 1:
                        w.code[w.leaf_base + leaves] = wp.uint16(code)
                    leaves += wp.int64(1)
                # Climb to the next triangle that was put aside.
                while (heap & wp.uint64(1)) == wp.uint64(1) and depth > 0:
                    heap = heap >> wp.uint64(1)
                    depth -= 1
                if depth == 0:
                    inside = 0
                else:
                    heap += wp.uint64(1)
                    left = right
                    aside = w.stack[place + depth - 1]
                    state = w.states[place + depth - 1]
                    apex = wp.vec2i(aside[0], aside[1])
                    right = wp.vec2i(aside[2], aside[3])
                    start = (heap << wp.uint64(w.cell_bits - depth)) - cells
                    if square_cell + start >= w.end_cell:
                        inside = 0
        square += 1
        start = wp.uint64(0)
    if word >= wp.int64(0) and leaves <= w.leaf_capacity:
        w.word_index[w.leaf_base + words] = word
        w.word_bits[w.leaf_base + words] = bits
        words += wp.int64(1)
    c = 4 * w.slot
    w.counts[c] = leaves
    w.counts[c + 1] = vertices
    w.counts[c + 2] = edges
    w.counts[c + 3] = words
    b = 6 * w.slot
    w.bounds[b] = worst_error
    w.bounds[b + 1] = worst_total
    w.bounds[b + 2] = worst_edge
    w.bounds[b + 3] = worst_area
    w.bounds[b + 4] = worst_metres
    w.bounds[b + 5] = worst_total_metres


@wp.kernel
def count(domain: Domain, asked: Asked, w: Walk):
    """Only count the leaves, all squares, and stop soon after `leaf_limit`."""
    side = wp.int32(1) << domain.unit_bits
    leaves = wp.int64(0)
    place = w.slot * 64
    squares = domain.columns * domain.rows
    for square in range(squares):
        row = square / domain.columns
        column = square - row * domain.columns
        x = column << domain.unit_bits
        y = row << domain.unit_bits
        for root in range(2):
            left = wp.vec2i(x, y + side)
            apex = wp.vec2i(x, y)
            right = wp.vec2i(x + side, y)
            if root == 1:
                left = right
                apex = wp.vec2i(x + side, y + side)
                right = wp.vec2i(x, y + side)
            top = wp.int32(0)
            depth = wp.int32(1)
            inside = wp.int32(1)
            while inside == 1 and leaves <= w.leaf_limit:
                middle = wp.vec2i((left[0] + right[0]) >> 1, (left[1] + right[1]) >> 1)
                split = wp.int32(0)
                if depth < w.max_depth:
                    error_px2, total_px2, edge_px2, area_px2, metres, total_metres = measure(
                        domain, asked, middle[0], middle[1], depth
                    )
                    if excess(asked, error_px2, edge_px2, area_px2, metres) > asked.limit:
                        split = 1
                if split == 1:
                    w.stack[place + top] = wp.vec4i(middle[0], middle[1], right[0], right[1])
                    w.states[place + top] = depth + 1
                    top += 1
                    right = apex
                    apex = middle
                    depth += 1
                else:
                    leaves += wp.int64(1)
                    if top == 0:
                        inside = 0
                    else:
                        top -= 1
                        left = right
                        aside = w.stack[place + top]
                        apex = wp.vec2i(aside[0], aside[1])
                        right = wp.vec2i(aside[2], aside[3])
                        depth = w.states[place + top]
    w.counts[4 * w.slot] = leaves
