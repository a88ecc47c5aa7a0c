# SPDX-License-Identifier: GPL-3.0-or-later
"""Welding without hashing: leaves in curve order to shared vertices, corners and edges.

Along the curve the mesh is a strip with a left and a right border. The front is the edge through which the next leaf is
entered: one vertex on each border. A leaf keeps one end of the front (the pivot) and moves the other: either to a new
vertex, which leaves an open edge on that border's stack, or over the edge on top of that stack, which it closes. So
every vertex and every edge gets its number once. Edges on the sides that two root squares share are kept per side
instead, since the later square passes them last edge first.

Slices of the curve are welded side by side, each from exact bases (weld_state.py), and joined afterwards (join.py).
"""

import warp as wp

from ..refine.curve import (
    BORDER,
    DEPTH_SHIFT,
    FIRST,
    GIVE_ABOVE,
    GIVE_RIGHT,
    HYP_LEG,
    LAST,
    LEG_HYP,
    LEG_LEG,
    PARITY,
    TAKE_BELOW,
    TAKE_LEFT,
    TO_CORNER,
)
from ..unchecked import code_at, number_at, packed_at, put, put_packed
from .weld_border import corner_below, enter, give_above, give_right, take_side
from .weld_state import (
    END_FRONT,
    END_TOPS,
    FIRST_LEVEL,
    FIRST_OWN,
    FIXES,
    FRONT,
    LAST_LEVEL,
    LEFT,
    RESTARTED,
    SQUARE,
    STATE_SIZE,
    TORN,
    Weld,
    ask,
    ask_stack,
    base_of,
    meet,
    stack_base,
)

wp.set_module_options({"enable_backward": False})

PASSAGE = wp.constant(6)  # a leaf's word without the rest
SHAPE = wp.constant(PASSAGE | 1 << PARITY)
RARE = wp.constant((7 << 4) | (1 << 7) | (1 << 15))  # BORDER, FIRST, LAST


def by_shape(value) -> int:
    """A table of two bits for every shape, the passage and parity that a leaf's word holds, to be shifted by SHAPE."""
    shapes = [(passage, odd) for passage in (LEG_LEG, HYP_LEG, LEG_HYP) for odd in (0, 1)]
    return sum(value(passage, odd) << (passage | odd << PARITY) for passage, odd in shapes)


def first_corner(passage: int, odd: int) -> int:
    """Where the left vertex of the front is stored: left, apex, right at odd depths, and mirrored at even ones."""
    return 2 if passage == HYP_LEG else 1 - odd


SIDES = wp.constant(by_shape(lambda passage, odd: 1 - odd if passage == LEG_LEG else odd))
FIRST_CORNER = wp.constant(by_shape(first_corner))
SECOND_CORNER = wp.constant(by_shape(lambda passage, odd: (first_corner(passage, odd) + 1) % 3))
THIRD_CORNER = wp.constant(by_shape(lambda passage, odd: (first_corner(passage, odd) + 2) % 3))
# Which of the three edges that the curve enters by, leaves by and passes beside are legs: a bit for each passage.
ENTRY_LEGS = wp.constant(1 << LEG_LEG | 1 << LEG_HYP)
LEAVE_LEGS = wp.constant(1 << LEG_LEG | 1 << HYP_LEG)
THIRD_LEGS = wp.constant(1 << HYP_LEG | 1 << LEG_HYP)
# Two int32 in an int64: the low and the high one.
LOW = wp.constant(wp.int64(0xFFFFFFFF))
SIGNS = wp.constant(wp.int64(-(1 << 63) | 1 << 31))
ONE_EACH = wp.constant(wp.int64(1 << 32 | 1))


@wp.func
def packed(low: wp.int32, high: wp.int32) -> wp.int64:
    return (wp.int64(low) & LOW) | (wp.int64(high) << wp.int64(32))


@wp.func
def low_of(pair: wp.int64) -> wp.int32:
    return wp.int32(pair)


@wp.func
def high_of(pair: wp.int64) -> wp.int32:
    return wp.int32(pair >> wp.int64(32))


@wp.func
def side_of(code: wp.int32) -> wp.int32:
    """The side, 0 or 1, whose vertex of the front a leaf moves."""
    return (SIDES >> (code & SHAPE)) & 1


@wp.func
def level_of(code: wp.int32, legs: wp.int32) -> wp.int32:
    """The level of an edge of a leaf: that of the triangles whose longest edge it is. `legs`: says if it is a leg."""
    return ((code >> DEPTH_SHIFT) & 63) + ((legs >> (code & PASSAGE)) & 1)


@wp.func
def write_triangle(
    w: Weld,
    t: wp.int32,
    code: wp.int32,
    side: wp.int32,
    front0: wp.int32,
    front1: wp.int32,
    far: wp.int32,
    entry: wp.int32,
    third: wp.int32,
    leave: wp.int32,
):
    """Front and far vertex are counter-clockwise; the passage says which of them is stored first."""
    shape = code & SHAPE
    o = wp.int64(3) * wp.int64(t)
    o0 = o + wp.int64((FIRST_CORNER >> shape) & 3)
    o1 = o + wp.int64((SECOND_CORNER >> shape) & 3)
    o2 = o + wp.int64((THIRD_CORNER >> shape) & 3)
    put(w.corner_verts, o0, front0)
    put(w.corner_verts, o1, front1)
    put(w.corner_verts, o2, far)
    put(w.corner_edges, o0, entry)
    put(w.corner_edges, o1, wp.where(side == 0, leave, third))
    put(w.corner_edges, o2, wp.where(side == 0, third, leave))
    put(w.level, wp.int64(t), (code >> DEPTH_SHIFT) & 63)


@wp.kernel
def weld(slot: wp.int32, w: Weld):
    b = base_of(w.counts, slot)
    leaves = wp.int32(w.counts[3 * slot])
    leaf_base = w.leaf_base[slot]
    e = STATE_SIZE * slot
    for i in range(STATE_SIZE):
        w.state[e + i] = 0
    for i in range(4):
        w.state[e + LEFT + i] = w.before[4 * slot + i]
    vertices = b.vertex
    edges = b.edge
    # places of the next open edges of the two stacks
    bottom0 = stack_base(b.room, leaves, 0)
    bottom1 = stack_base(b.room, leaves, 1)
    next0 = bottom0
    next1 = bottom1
    # what is below looks like an import, so that no leaf closes it unseen
    w.stack[bottom0 - 1] = wp.vec2i(-1, -1)
    w.stack[bottom1 - 1] = wp.vec2i(-1, -1)
    front0 = wp.int32(0)
    front1 = wp.int32(0)
    entry = wp.int32(0)
    starts = wp.int32(w.code[leaf_base]) >> FIRST & 1
    if starts == 1:
        w.state[e + SQUARE] = w.squares[slot] - 1
        w.state[e + FIRST_OWN] = w.squares[slot]
    else:
        w.state[e + SQUARE] = w.squares[slot]
        w.state[e + FIRST_OWN] = w.squares[slot] + 1
        front0 = ask(w, b, e, FRONT, 0)
        front1 = ask(w, b, e, FRONT, 1)
        entry = ask(w, b, e, FRONT, 2)
    left_at = wp.int32(0)  # the level of the edge of leave; 0: a square begins or ends
    torn = wp.int32(0)
    k = wp.int32(0)
    while k < leaves:
        # Ordinary leaves. Pairs share a register each: the front's vertices, the stacks' next places, the next edge and
        # vertex. No branch on `new`, which no processor foresees: what is written in vain is overwritten.
        front = packed(front0, front1)
        open = packed(next0, next1)
        made = packed(edges, vertices)
        while k < leaves:
            code = wp.int32(code_at(w.code, leaf_base + wp.int64(k)))
            side = side_of(code)
            shift = wp.int64(side << 5)
            new = wp.int64(1 - (code & 1))
            at = (open >> shift) & LOW
            closed = packed_at(w.stack, at - wp.int64(1))
            across = closed ^ ((closed ^ made) & -new)  # third edge and far vertex; `where` would become a branch
            if (code & RARE) != 0 or ((front | across) & SIGNS) != wp.int64(0):
                break
            far64 = across >> wp.int64(32)
            moved64 = (front >> shift) & LOW
            edge64 = made & LOW
            leave64 = edge64 + new
            put_packed(w.edges, edge64, moved64 | (far64 << wp.int64(32)))
            put_packed(w.stack, at, (across & LOW) | (moved64 << wp.int64(32)))
            # Where an edge that is closed, or the front, has another level, leaves do not fit together.
            third_level = level_of(code, THIRD_LEGS)
            torn = torn | (left_at ^ level_of(code, ENTRY_LEGS))
            torn = torn | ((number_at(w.stack_level, wp.int32(at) - 1) ^ third_level) & -(code & 1))
            put(w.stack_level, at, third_level)
            left_at = level_of(code, LEAVE_LEGS)
            write_triangle(
                w,
                b.triangle + k,
                code,
                side,
                low_of(front),
                high_of(front),
                high_of(across),
                low_of(made) - 1,
                low_of(across),
                wp.int32(leave64),
            )
            front = (front & ~(LOW << shift)) | (far64 << shift)
            put_packed(w.edges, leave64, front)
            open += (new + new - wp.int64(1)) << shift
            made += new * ONE_EACH + wp.int64(1)
            k += 1
        front0 = low_of(front)
        front1 = high_of(front)
        next0 = low_of(open)
        next1 = high_of(open)
        edges = low_of(made)
        vertices = high_of(made)
        entry = wp.where(k > 0, edges - 1, entry)
        if k < leaves:
            # The first or last of a square, on a side that squares share, or with an import.
            code = wp.int32(code_at(w.code, leaf_base + wp.int64(k)))
            passage = code & PASSAGE
            entered_at = level_of(code, ENTRY_LEGS)
            third_level = level_of(code, THIRD_LEGS)
            leave_level = level_of(code, LEAVE_LEGS)
            if ((code >> FIRST) & 1) == 1:
                for i in range(4):
                    w.state[e + LEFT + i] = 0
                w.state[e + SQUARE] = w.state[e + SQUARE] + 1
                w.state[e + RESTARTED] = 1
                next0 = bottom0
                next1 = bottom1
                corner, end, entry, vertices, edges = enter(w, b, e, slot, code, entered_at, vertices, edges)
                entered_at = 0
                front0 = corner
                front1 = end
                if (passage == HYP_LEG) == (((code >> PARITY) & 1) == 1):
                    front0 = end
                    front1 = corner
            if k == 0:
                w.state[e + FIRST_LEVEL] = entered_at
            else:
                meet(w, e, entered_at, left_at)
            side = side_of(code)
            top = wp.where(side == 0, next0, next1)
            moved = wp.where(side == 0, front0, front1)
            pivot = wp.where(side == 0, front1, front0)
            role = (code >> BORDER) & 7
            third = edges
            far = vertices
            step = wp.int32(0)
            if (code & 1) == 1:
                step = -1
                third = w.stack[top - 1][0]
                far = w.stack[top - 1][1]
                if top == wp.where(side == 0, bottom0, bottom1):
                    step = 0
                    third = ask_stack(w, b, e, side, third_level)
                    far = third
                else:
                    meet(w, e, third_level, w.stack_level[top - 1])
            elif role == TAKE_LEFT or role == TAKE_BELOW:
                taken = take_side(w, b, e, slot, role, third_level)
                third = taken[0]
                far = taken[1]
            else:
                edges += 1
                if role == TO_CORNER:
                    far = corner_below(w, b, e, w.state[e + SQUARE])
                else:
                    vertices += 1
                w.edges[third] = wp.vec2i(moved, far)
                if role == GIVE_RIGHT:
                    give_right(w, e, third, third_level, moved, far)
                elif role == GIVE_ABOVE:
                    give_above(w, e, third, third_level, moved)
                else:
                    w.stack[top] = wp.vec2i(third, moved)
                    w.stack_level[top] = third_level
                    step = 1
            leave = edges
            write_triangle(w, b.triangle + k, code, side, front0, front1, far, entry, third, leave)
            if (front0 | front1 | far | entry | third) < 0:
                n = w.state[e + FIXES]
                w.fixes[b.room + n] = b.triangle + k
                w.state[e + FIXES] = n + 1
            if ((code >> LAST) & 1) == 1 and w.state[e + SQUARE] < w.columns * (w.rows - 1):
                give_above(w, e, leave, leave_level, wp.where(passage == HYP_LEG, far, pivot))
            front0 = wp.where(side == 0, far, front0)
            front1 = wp.where(side == 0, front1, far)
            w.edges[leave] = wp.vec2i(front0, front1)
            next0 += wp.where(side == 0, step, 0)
            next1 += wp.where(side == 0, 0, step)
            edges += 1
            entry = leave
            left_at = wp.where(((code >> LAST) & 1) == 1, 0, leave_level)
            k += 1
    w.state[e + LAST_LEVEL] = left_at
    if torn != 0:
        w.state[e + TORN] = 1
    w.state[e + END_FRONT] = front0
    w.state[e + END_FRONT + 1] = front1
    w.state[e + END_FRONT + 2] = entry
    w.state[e + END_TOPS] = next0 - bottom0
    w.state[e + END_TOPS + 1] = next1 - bottom1
