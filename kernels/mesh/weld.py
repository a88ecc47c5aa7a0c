# SPDX-License-Identifier: GPL-3.0-or-later
"""Welding without hashing: leaves in curve order to shared vertices, corners and edges.

Along the curve the mesh is a strip with a left and a right border. The front is the edge through which the next leaf is
entered: one vertex on each border. A leaf keeps one end of the front (the pivot) and moves the other: either to a new
vertex, which leaves an open edge on that border's stack, or over the edge on top of that stack, which it closes. So
every vertex and every edge gets its number once. Edges on the sides that two root squares share are kept per side
instead, since the later square passes them last edge first.

Slices of the curve are welded side by side, each from exact bases (weld_state.py), and joined afterwards (join.py).

`w`: the arrays of all slices. `slot`: the slice's row in them. `leaves`: number of its leaves. `b`: its first numbers.
`first_state`: its first entry in `state`. `s`: its strip (front and next free numbers). `code`: a leaf's word: whether
its third edge is old (1 bit), its passage (2 bits: by leg or hypotenuse the curve enters it, and leaves it), the
depth's parity, the third edge's role on a shared side, flags for the first and the last leaf of a square, and the
depth. Imports are elements of earlier slices, numbered from -1 down. An edge's level is the depth of triangles whose
longest edge it is; both of its leaves must agree on it, else the slice is torn.

`s.front0`, `s.front1`: left and right vertex of the front. `s.next0`, `s.next1`: next free entries of the two stacks in
`w.stack`. Capital names after `first_state` are columns of `w.state`; those after `code >>` are positions of bits;
..._LEGS have a bit for each passage.
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
from ..unchecked import item_at, put
from .weld_border import append_above, append_right, begin_left_side, corner_below, read_side
from .weld_state import (
    END_FRONT,
    END_TOPS,
    FIRST_BEGUN,
    FIRST_LEVEL,
    FIXES,
    FRONT,
    LAST_LEVEL,
    LEFT,
    RESTARTED,
    SQUARE,
    STATE_SIZE,
    TORN,
    Base,
    Strip,
    Weld,
    add_import,
    base_of,
    check_level,
    import_open_edge,
    stack_base,
)

PASSAGE = wp.constant(6)  # bits of the passage in a leaf's word
SHAPE = wp.constant(PASSAGE | 1 << PARITY)  # ... and of the depth's parity
RARE = wp.constant((7 << 4) | (1 << 7) | (1 << 15))  # bits of BORDER, FIRST and LAST: not all are 0 in rare leaves


def by_shape(value) -> int:
    """Pack a value of two bits for each shape of a leaf (passage and parity) into one integer.

    value: function of the passage (LEG_LEG ..) and the parity (0 or 1) that returns 0 .. 3. Kernels look a value up by
    shifting the integer by the shape's bits.
    """
    shapes = [(passage, odd) for passage in (LEG_LEG, HYP_LEG, LEG_HYP) for odd in (0, 1)]
    return sum(int(value(passage, odd)) << (passage | odd << PARITY) for passage, odd in shapes)


def first_corner(passage: int, odd: int) -> int:
    """Return the corner (0 .. 2) of the stored triangle in which the front's left vertex is.

    passage: LEG_LEG, HYP_LEG or LEG_HYP. odd: parity of the depth. Corners are stored left, apex, right if it is 1,
    else right, apex, left.
    """
    return 2 if passage == HYP_LEG else 1 - odd


SIDES = wp.constant(by_shape(lambda passage, odd: 1 - odd if passage == LEG_LEG else odd))
FIRST_CORNER = wp.constant(by_shape(first_corner))
SECOND_CORNER = wp.constant(by_shape(lambda passage, odd: (first_corner(passage, odd) + 1) % 3))
THIRD_CORNER = wp.constant(by_shape(lambda passage, odd: (first_corner(passage, odd) + 2) % 3))
# Which of the three edges that the curve enters by, leaves by and passes beside are legs: a bit for each passage.
ENTRY_LEGS = wp.constant(1 << LEG_LEG | 1 << LEG_HYP)
LEAVE_LEGS = wp.constant(1 << LEG_LEG | 1 << HYP_LEG)
THIRD_LEGS = wp.constant(1 << HYP_LEG | 1 << LEG_HYP)


@wp.func
def side_of(code: wp.int32) -> wp.int32:
    """Return the side of the strip (0 left, 1 right) on which a leaf moves the front's vertex.

    code: the leaf's word. SIDES has a bit for each shape (passage and parity).
    """
    return (SIDES >> (code & SHAPE)) & 1


@wp.func
def level_of(code: wp.int32, legs: wp.int32) -> wp.int32:
    """Return the level of a leaf's edge: the depth of triangles that have it as longest edge.

    `legs`: a bit for each passage, 1 if the edge is a leg.
    """
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
    """Write triangle t: corners, edges and level.

    Its vertices are front0, front1 and far, counter-clockwise; the passage of the curve decides which is stored first.
    code: the leaf's word. side: side of the strip (0 left, 1 right) on which the front moves. entry, leave, third: the
    edges by which the curve enters and leaves, and the other one.
    """
    shape = code & SHAPE  # passage and parity, for which each table has two bits
    o0 = 3 * t + ((FIRST_CORNER >> shape) & 3)
    o1 = 3 * t + ((SECOND_CORNER >> shape) & 3)
    o2 = 3 * t + ((THIRD_CORNER >> shape) & 3)
    put(w.corner_verts, o0, front0)
    put(w.corner_verts, o1, front1)
    put(w.corner_verts, o2, far)
    put(w.corner_edges, o0, entry)
    put(w.corner_edges, o1, wp.where(side == 0, leave, third))
    put(w.corner_edges, o2, wp.where(side == 0, third, leave))
    put(w.level, t, (code >> DEPTH_SHIFT) & 63)


@wp.func
def begin_slice(w: Weld, b: Base, slot: wp.int32, leaves: wp.int32) -> Strip:
    """Return the strip before a slice's first leaf, and clear the slice's state.

    No edge is open. The front, the edge by which the curve enters a leaf, is an import from the slice before, unless a
    square begins here.
    """
    first_state = STATE_SIZE * slot
    for i in range(STATE_SIZE):
        w.state[first_state + i] = 0
    for i in range(4):  # edges of the square's four sides that earlier slices have passed
        w.state[first_state + LEFT + i] = w.before[4 * slot + i]
    s = Strip()
    s.vertex = b.vertex
    s.edge = b.edge
    s.next0 = stack_base(b.list_base, leaves, 0)
    s.next1 = stack_base(b.list_base, leaves, 1)
    # the entry below each stack looks like an import, so the inner loop never closes it
    w.stack[s.next0 - 1] = wp.vec2i(-1, -1)
    w.stack[s.next1 - 1] = wp.vec2i(-1, -1)
    code = wp.int32(w.code[w.leaf_base[slot]])
    square_begins = code >> FIRST & 1
    # The slice begins in square w.squares[slot], which `begin_square` counts if the square begins, too.
    w.state[first_state + SQUARE] = w.squares[slot] - square_begins
    w.state[first_state + FIRST_BEGUN] = w.squares[slot] + 1 - square_begins
    if square_begins == 0:
        s.front0 = add_import(w, b, first_state, FRONT, 0)
        s.front1 = add_import(w, b, first_state, FRONT, 1)
        s.entry = add_import(w, b, first_state, FRONT, 2)
        s.level = level_of(code, ENTRY_LEGS)
    w.state[first_state + FIRST_LEVEL] = s.level
    return s


@wp.func
def begin_square(w: Weld, b: Base, slot: wp.int32, code: wp.int32, leaves: wp.int32, s: Strip) -> Strip:
    """Return the strip before a square's first leaf.

    The front is the edge by which the curve enters; no edge is open. The slice's state is that of the new square. s:
    the strip at the end of the square before, or of the slice before its first leaf.
    """
    first_state = STATE_SIZE * slot
    for i in range(4):
        w.state[first_state + LEFT + i] = 0
    w.state[first_state + SQUARE] = w.state[first_state + SQUARE] + 1
    w.state[first_state + RESTARTED] = 1
    check_level(w, first_state, 0, s.level)  # not 0: the leaves of the square before do not fill it
    s.level = level_of(code, ENTRY_LEGS)
    s.next0 = stack_base(b.list_base, leaves, 0)
    s.next1 = stack_base(b.list_base, leaves, 1)
    corner, end, entry, vertex, edge = begin_left_side(w, b, first_state, slot, code, s.level, s.vertex, s.edge)
    s.entry = entry
    s.vertex = vertex
    s.edge = edge
    # Whether the corner is on the right border of the strip. A triangle of odd depth is counter-clockwise, so the curve
    # has its left corner on its left if it enters by a leg, and on its right if by the hypotenuse. Even ones mirror it.
    mirrored = ((code & PASSAGE) == HYP_LEG) == (((code >> PARITY) & 1) == 1)
    s.front0 = wp.where(mirrored, end, corner)
    s.front1 = wp.where(mirrored, corner, end)
    return s


@wp.func
def third_edge(w: Weld, b: Base, slot: wp.int32, code: wp.int32, leaves: wp.int32, s: Strip):
    """Return (third, far, growth): the edge that the curve does not cross, its far vertex, and the growth of its stack.

    A new edge or vertex gets the next number, which the caller counts. Imports are negative numbers. code: the leaf's
    word. growth: 1 if the edge is opened, -1 if it is closed, 0 on a shared side or if an earlier slice has opened it.
    """
    first_state = STATE_SIZE * slot
    side = side_of(code)
    level = level_of(code, THIRD_LEGS)
    role = (code >> BORDER) & 7
    next_open = wp.where(side == 0, s.next0, s.next1)
    side_vertex = wp.where(side == 0, s.front0, s.front1)  # the front's vertex that this leaf moves
    third = s.edge
    far = s.vertex
    growth = wp.int32(0)
    if (code & 1) == 1:  # the curve has passed the edge before, in this square
        # The stack is empty: an earlier slice has opened the edge.
        if next_open == stack_base(b.list_base, leaves, side):
            third = import_open_edge(w, b, first_state, side, level)
            far = third
        else:
            third = w.stack[next_open - 1][0]
            far = w.stack[next_open - 1][1]
            growth = -1
    elif role == TAKE_LEFT or role == TAKE_BELOW:
        shared_edge = read_side(w, b, first_state, slot, role, level)
        third = shared_edge[0]
        far = shared_edge[1]
    elif role == GIVE_RIGHT:
        append_right(w, first_state, third, level, side_vertex, far)
    elif role == GIVE_ABOVE:
        append_above(w, first_state, third, level, side_vertex)
    else:  # new, and on no shared side
        if role == TO_CORNER:
            far = corner_below(w, b, first_state, w.state[first_state + SQUARE])
        growth = 1
    return third, far, growth


@wp.func
def note_rare(w: Weld, b: Base, slot: wp.int32, code: wp.int32, s: Strip, t: wp.int32, third: wp.int32, far: wp.int32):
    """List triangle t for `join` if it uses an import; append the edge by which the curve leaves a square to its side.

    Few leaves need either. The edge is on the upper side, for the square above. code: the leaf's word. third, far: the
    leaf's third edge and that edge's far vertex.
    """
    first_state = STATE_SIZE * slot
    if (s.front0 | s.front1 | far | s.entry | third) < 0:  # one is an import
        n = w.state[first_state + FIXES]
        w.fixes[b.list_base + n] = t
        w.state[first_state + FIXES] = n + 1
    # The last leaf of a square that has one above.
    if code >> LAST == 1 and w.state[first_state + SQUARE] < w.columns * (w.rows - 1):
        leave = s.edge + wp.where(third == s.edge, 1, 0)
        pivot = wp.where(side_of(code) == 0, s.front1, s.front0)
        # The edge's end that is first in the order left, apex, right. The far vertex is the apex, and the pivot the
        # right corner, if the leaf is entered by its hypotenuse; otherwise the far vertex is the right corner.
        begun = wp.where((code & PASSAGE) == HYP_LEG, far, pivot)
        append_above(w, first_state, leave, level_of(code, LEAVE_LEGS), begun)


@wp.func
def end_slice(w: Weld, b: Base, slot: wp.int32, leaves: wp.int32, s: Strip):
    """Store the front and the number of open edges at the end of a slice, from which the next slice imports."""
    first_state = STATE_SIZE * slot
    w.state[first_state + LAST_LEVEL] = s.level
    if s.torn != 0:
        w.state[first_state + TORN] = 1
    w.state[first_state + END_FRONT] = s.front0
    w.state[first_state + END_FRONT + 1] = s.front1
    w.state[first_state + END_FRONT + 2] = s.entry
    w.state[first_state + END_TOPS] = s.next0 - stack_base(b.list_base, leaves, 0)
    w.state[first_state + END_TOPS + 1] = s.next1 - stack_base(b.list_base, leaves, 1)


@wp.kernel
def weld(slot: wp.int32, w: Weld):
    """Weld slice `slot`: write its triangles, edges and level from its words, with imports from earlier slices.

    The inner loop writes a leaf and finds the next leaf's third edge without a branch, which could not be predicted. It
    stops before a rare leaf: the first or last of a square, on a shared side, or with an import. `w.stack` has the open
    edges of both borders as (edge, vertex where it begins). third, far: number of the leaf's third edge, and of the
    vertex to which the front moves.
    """
    b = base_of(w.counts, slot)
    leaves = wp.int32(w.counts[3 * slot])
    first = w.leaf_base[slot]
    s = begin_slice(w, b, slot, leaves)
    k = wp.int32(0)
    while k < leaves:
        code = wp.int32(item_at(w.code, first + wp.int64(k)))
        if ((code >> FIRST) & 1) == 1:  # a square begins
            s = begin_square(w, b, slot, code, leaves, s)
        side = side_of(code)
        next_open = wp.where(side == 0, s.next0, s.next1)
        side_vertex = wp.where(side == 0, s.front0, s.front1)
        third, far, growth = third_edge(w, b, slot, code, leaves, s)  # growth of the stack at `next_open`
        note_rare(w, b, slot, code, s, b.triangle + k, third, far)
        is_ordinary = wp.bool(True)
        while is_ordinary:
            # Where an edge that is closed, or the front, has another level, leaves do not fit together.
            level = level_of(code, THIRD_LEGS)
            differs = (item_at(w.stack_level, next_open - 1) ^ level) & (growth >> 31)  # 0 unless an edge is closed
            s.torn = s.torn | (s.level ^ level_of(code, ENTRY_LEGS)) | differs
            leave = s.edge + wp.where(third == s.edge, 1, 0)
            # Of the next three entries, later leaves overwrite those that are not needed.
            put(w.edges, s.edge, wp.vec2i(side_vertex, far))
            put(w.stack, next_open, wp.vec2i(third, side_vertex))
            put(w.stack_level, next_open, level)
            write_triangle(w, b.triangle + k, code, side, s.front0, s.front1, far, s.entry, third, leave)
            s.level = level_of(code, LEAVE_LEGS)
            last = code >> LAST  # 1: the square's last leaf
            s.vertex = s.vertex + wp.where(far == s.vertex, 1, 0)
            s.edge = leave + 1
            s.entry = leave
            s.next0 = s.next0 + wp.where(side == 0, growth, 0)
            s.next1 = s.next1 + wp.where(side == 0, 0, growth)
            s.front0 = wp.where(side == 0, far, s.front0)
            s.front1 = wp.where(side == 0, s.front1, far)
            put(w.edges, leave, wp.vec2i(s.front0, s.front1))
            # The next leaf. Its third edge is new, or an old one on top of the stack.
            k += 1
            code = wp.int32(item_at(w.code, first + wp.int64(k)))
            side = side_of(code)
            old = code & 1  # 1: the curve has passed the third edge before
            next_open = wp.where(side == 0, s.next0, s.next1)
            side_vertex = wp.where(side == 0, s.front0, s.front1)
            closed = item_at(w.stack, next_open - 1)
            third = wp.where(old == 1, closed[0], s.edge)
            far = wp.where(old == 1, closed[1], s.vertex)
            growth = 1 - 2 * old
            is_ordinary = k < leaves and (code & RARE) == 0 and (s.front0 | s.front1 | third | far) >= 0
        s.level = wp.where(last == 1, 0, s.level)
    end_slice(w, b, slot, leaves, s)
