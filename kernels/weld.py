# SPDX-License-Identifier: GPL-3.0-or-later
"""Welding without hashing: leaves in curve order to shared vertices, corners and edges.

Along the curve the mesh is a strip with a left and a right border. The front is the edge through which the next leaf is
entered: one vertex on each border. A leaf keeps one end of the front (the pivot) and moves the other: either to a new
vertex, which leaves an open edge on that border's stack, or over the edge on top of that stack, which it closes. So
every vertex and every edge gets its number once. Edges on the sides that two root squares share are kept per side
instead, since the later square passes them last edge first.

Slices of the curve are welded side by side. What a slice needs from earlier ones is an import: it gets the negative
number -1 - i, i being its place in the slice's list; join.py finds what each stands for.
"""

import warp as wp

from .refine import (
    BORDER,
    CORNER,
    DEPTH_SHIFT,
    FIRST,
    GIVE_ABOVE,
    GIVE_RIGHT,
    HYP_LEG,
    LAST,
    LEG_LEG,
    PARITY,
    TAKE_BELOW,
    TAKE_LEFT,
    TO_CORNER,
)

wp.set_module_options({"enable_backward": False})

# What an import asks for.
FRONT = wp.constant(0)  # value 0, 1: that vertex of the front, 2: its edge
STACK = wp.constant(1)  # + side (1 or 2): the value-th edge from the top of the stack
SIDE = wp.constant(3)  # entry `value` of the shared sides
UPPER_LEFT = wp.constant(4)  # upper left corner of square `value`
UPPER_RIGHT = wp.constant(5)

# Columns of a slice's ends.
END_FRONT, END_TOPS, END_POPS = wp.constant(0), wp.constant(3), wp.constant(5)
END_RESTARTED, END_IMPORTS, END_FIXES = wp.constant(7), wp.constant(8), wp.constant(9)
ENDS = wp.constant(10)


@wp.struct
class Weld:
    """One slice: what it reads, where its numbers begin, and what it shares."""

    columns: wp.int32
    rows: wp.int32
    leaves: wp.int32
    leaf_base: wp.int64
    triangle: wp.int32  # first triangle, vertex and edge of the slice
    vertex: wp.int32
    edge: wp.int32
    square: wp.int32  # the square in which the slice begins
    slot: wp.int32
    stack_base: wp.int32  # two stacks of stack_size entries (edge, vertex) from here
    stack_size: wp.int32
    import_base: wp.int32
    fix_base: wp.int32
    code: wp.array(dtype=wp.uint16)
    before: wp.array(dtype=wp.int32)  # [slices, 4]: edges of that square's sides passed by earlier slices
    right_base: wp.array(dtype=wp.int32)  # per square: first entry of its right side, then one past its last
    above_base: wp.array(dtype=wp.int32)
    side: wp.array(dtype=wp.vec2i)  # edges of the shared sides, each with the vertex where it was begun
    corners: wp.array(dtype=wp.int32)  # per square: upper left and upper right vertex
    stack: wp.array(dtype=wp.vec2i)
    imports: wp.array(dtype=wp.vec2i)
    fixes: wp.array(dtype=wp.int32)
    ends: wp.array(dtype=wp.int32)
    corner_verts: wp.array(dtype=wp.int32)
    corner_edges: wp.array(dtype=wp.int32)
    edges: wp.array(dtype=wp.vec2i)
    level: wp.array(dtype=wp.int32)


@wp.func
def ask(w: Weld, n: wp.int32, kind: wp.int32, value: wp.int32) -> wp.int32:
    """Write import number n and return the number that stands for it."""
    w.imports[w.import_base + n] = wp.vec2i(kind, value)
    return -1 - n


@wp.kernel
def weld(w: Weld):
    before_left = w.before[4 * w.slot]
    before_below = w.before[4 * w.slot + 1]
    before_right = w.before[4 * w.slot + 2]
    before_above = w.before[4 * w.slot + 3]
    square = w.square
    row = square / w.columns
    column = square - row * w.columns
    # edges of this square's sides passed so far
    left = before_left
    below = before_below
    right = before_right
    above = before_above
    vertices = w.vertex
    edges = w.edge
    imports = wp.int32(0)
    fixes = wp.int32(0)
    top0 = wp.int32(0)
    top1 = wp.int32(0)
    pops0 = wp.int32(0)
    pops1 = wp.int32(0)
    restarted = wp.int32(0)
    started = wp.int32(0)
    # the first square of which this slice has made the upper left corner
    first_own = square + 1
    if (w.code[w.leaf_base] >> wp.uint16(FIRST)) & wp.uint16(1) == wp.uint16(1):
        first_own = square
    front0 = wp.int32(0)
    front1 = wp.int32(0)
    entry = wp.int32(0)
    for k in range(w.leaves):
        code = wp.int32(w.code[w.leaf_base + wp.int64(k)])
        state = code & 7
        passage = state & 6
        odd = (code >> PARITY) & 1
        role = (code >> BORDER) & 7
        if ((code >> FIRST) & 1) == 1:
            if started == 1:
                square += 1
            row = square / w.columns
            column = square - row * w.columns
            left = 0
            below = 0
            right = 0
            above = 0
            top0 = 0
            top1 = 0
            restarted = 1
            # The entry edge is the first of the left side: from the upper left corner down.
            corner = wp.int32(0)
            end = wp.int32(0)
            if column > 0:
                at = w.right_base[square] - 1  # sides lie square by square: the left neighbour's last entry
                left = 1
                if square - 1 > w.square or (square - 1 == w.square and at - w.right_base[square - 1] >= before_right):
                    corner = w.corners[2 * square - 1]
                    entry = w.side[at][0]
                    end = w.side[at][1]
                else:
                    corner = ask(w, imports, UPPER_RIGHT, square - 1)
                    end = ask(w, imports + 1, SIDE, at)
                    entry = end
                    imports += 2
            else:
                corner = vertices
                vertices += 1
                if ((code >> CORNER) & 1) == 1:
                    if square - w.columns >= first_own:
                        end = w.corners[2 * (square - w.columns)]
                    else:
                        end = ask(w, imports, UPPER_LEFT, square - w.columns)
                        imports += 1
                else:
                    end = vertices
                    vertices += 1
                entry = edges
                edges += 1
                w.edges[entry] = wp.vec2i(corner, end)
                if end < 0:
                    w.fixes[w.fix_base + fixes] = -1 - entry
                    fixes += 1
            w.corners[2 * square] = corner
            corner_side = odd
            if passage != HYP_LEG:
                corner_side = 1 - odd
            front0 = corner
            front1 = end
            if corner_side == 1:
                front0 = end
                front1 = corner
        elif started == 0:
            front0 = ask(w, 0, FRONT, 0)
            front1 = ask(w, 1, FRONT, 1)
            entry = ask(w, 2, FRONT, 2)
            imports = 3
        started = 1
        # The side whose front vertex moves.
        side = odd
        if passage == LEG_LEG:
            side = 1 - odd
        moved = front0
        pivot = front1
        if side == 1:
            moved = front1
            pivot = front0
        far = wp.int32(0)
        third = wp.int32(0)
        if (state & 1) == 0:
            if role == TAKE_LEFT or role == TAKE_BELOW:
                owner = square - 1
                at = wp.int32(0)
                own = wp.int32(0)
                if role == TAKE_LEFT:
                    at = w.right_base[square] - 1 - left
                    left += 1
                    if owner > w.square or (owner == w.square and at - w.right_base[owner] >= before_right):
                        own = 1
                else:
                    owner = square - w.columns
                    at = w.above_base[owner + 1] - 1 - below
                    below += 1
                    if owner > w.square or (owner == w.square and at - w.above_base[owner] >= before_above):
                        own = 1
                if own == 1:
                    third = w.side[at][0]
                    far = w.side[at][1]
                else:
                    third = ask(w, imports, SIDE, at)
                    far = third
                    imports += 1
            else:
                third = edges
                edges += 1
                if role == TO_CORNER:
                    if square - w.columns >= first_own:
                        far = w.corners[2 * (square - w.columns)]
                    else:
                        far = ask(w, imports, UPPER_LEFT, square - w.columns)
                        imports += 1
                else:
                    far = vertices
                    vertices += 1
                w.edges[third] = wp.vec2i(moved, far)
                if moved < 0 or far < 0:
                    w.fixes[w.fix_base + fixes] = -1 - third
                    fixes += 1
                if role == GIVE_RIGHT:
                    w.side[w.right_base[square] + right] = wp.vec2i(third, moved)
                    right += 1
                    if w.right_base[square] + right == w.right_base[square + 1]:
                        w.corners[2 * square + 1] = far
                elif role == GIVE_ABOVE:
                    w.side[w.above_base[square] + above] = wp.vec2i(third, moved)
                    above += 1
                elif side == 0:
                    w.stack[w.stack_base + top0] = wp.vec2i(third, moved)
                    top0 += 1
                else:
                    w.stack[w.stack_base + w.stack_size + top1] = wp.vec2i(third, moved)
                    top1 += 1
        elif side == 0:
            if top0 > 0:
                top0 -= 1
                third = w.stack[w.stack_base + top0][0]
                far = w.stack[w.stack_base + top0][1]
            else:
                third = ask(w, imports, STACK, pops0)
                far = third
                imports += 1
                pops0 += 1
        else:
            if top1 > 0:
                top1 -= 1
                third = w.stack[w.stack_base + w.stack_size + top1][0]
                far = w.stack[w.stack_base + w.stack_size + top1][1]
            else:
                third = ask(w, imports, STACK + 1, pops1)
                far = third
                imports += 1
                pops1 += 1
        if side == 0:
            front0 = far
        else:
            front1 = far
        leave = edges
        edges += 1
        w.edges[leave] = wp.vec2i(front0, front1)
        if front0 < 0 or front1 < 0:
            w.fixes[w.fix_base + fixes] = -1 - leave
            fixes += 1
        if ((code >> LAST) & 1) == 1 and row < w.rows - 1:
            outer = pivot
            if passage == HYP_LEG:
                outer = far
            w.side[w.above_base[square] + above] = wp.vec2i(leave, outer)
            above += 1
        # Corners left, apex, right and the edges between them.
        v0 = moved
        v1 = pivot
        v2 = far
        e0 = entry
        e1 = leave
        e2 = third
        if passage == HYP_LEG:
            v1 = far
            v2 = pivot
            e0 = third
            e2 = entry
        elif passage != LEG_LEG:
            v0 = pivot
            v1 = moved
            e2 = leave
            e1 = third
        t = w.triangle + k
        o = 3 * t
        w.corner_verts[o + 1] = v1
        if odd == 1:
            w.corner_verts[o] = v0
            w.corner_verts[o + 2] = v2
            w.corner_edges[o] = e0
            w.corner_edges[o + 1] = e1
            w.corner_edges[o + 2] = e2
        else:  # every other depth is mirrored
            w.corner_verts[o] = v2
            w.corner_verts[o + 2] = v0
            w.corner_edges[o] = e1
            w.corner_edges[o + 1] = e0
            w.corner_edges[o + 2] = e2
        if v0 < 0 or v1 < 0 or v2 < 0 or e0 < 0 or e1 < 0 or e2 < 0:
            w.fixes[w.fix_base + fixes] = t
            fixes += 1
        w.level[t] = code >> DEPTH_SHIFT & 63
        entry = leave
    e = ENDS * w.slot
    w.ends[e + END_FRONT] = front0
    w.ends[e + END_FRONT + 1] = front1
    w.ends[e + END_FRONT + 2] = entry
    w.ends[e + END_TOPS] = top0
    w.ends[e + END_TOPS + 1] = top1
    w.ends[e + END_POPS] = pops0
    w.ends[e + END_POPS + 1] = pops1
    w.ends[e + END_RESTARTED] = restarted
    w.ends[e + END_IMPORTS] = imports
    w.ends[e + END_FIXES] = fixes
