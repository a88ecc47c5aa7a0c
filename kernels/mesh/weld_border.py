# SPDX-License-Identifier: GPL-3.0-or-later
"""Welding across root squares: sides that two squares share are kept per side, edge by edge.

Squares are numbered row by row. A square reads its left and lower side, last edge first, and writes its right and upper
side. An edge's level is the depth of triangles whose longest edge it is; both of its leaves must agree on it. `w`: the
arrays of all slices; `w.side_base` has the first entry of each square's right side in `w.side`, then, from `columns *
rows` on, of each upper side. `slot`: the slice's row in the arrays. `first_state`: its first entry in `Weld.state`.
`b`: its first numbers. The curve begins an edge at the end that is first in its triangle's order left, apex, right.
Capital names after `first_state` are columns of `w.state`: SQUARE is the current square, LEFT, BELOW, RIGHT and ABOVE
count the edges of its sides that were passed. `w.corners`: upper left and upper right vertex of each square.
"""

import warp as wp

from ..refine.curve import CORNER, TAKE_LEFT
from .weld_state import (
    ABOVE,
    BELOW,
    FIRST_BEGUN,
    LEFT,
    LEVEL_SHIFT,
    RIGHT,
    SIDE,
    SQUARE,
    UPPER_LEFT,
    UPPER_RIGHT,
    Base,
    Weld,
    add_import,
    check_level,
)

# Columns of `Weld.before`: edges of a side that earlier slices have made.
RIGHT_SIDE, UPPER_SIDE = wp.constant(2), wp.constant(3)


@wp.func
def is_in_slice(w: Weld, slot: wp.int32, owner: wp.int32, passed: wp.int32, side: wp.int32) -> wp.bool:
    """Return whether slice `slot`, not an earlier one, made edge number `passed` of a side of square `owner`.

    side: RIGHT_SIDE or UPPER_SIDE, a column of `w.before` [slices, 4]: edges on the sides of each slice's first square
    that earlier slices have passed.
    """
    first = w.squares[slot]
    return owner > first or (owner == first and passed >= w.before[4 * slot + side])


@wp.func
def corner_below(w: Weld, b: Base, first_state: wp.int32, square: wp.int32) -> wp.int32:
    """Return the vertex at the lower left corner of `square`, which the square below has made as its upper left one.

    It is an import (a negative number) if an earlier slice made it.
    """
    below = square - w.columns
    corner = wp.int32(0)
    if below >= w.state[first_state + FIRST_BEGUN]:  # the square below began in this slice
        corner = w.corners[2 * below]
    else:
        corner = add_import(w, b, first_state, UPPER_LEFT, below)
    return corner


@wp.func
def begin_left_side(
    w: Weld,
    b: Base,
    first_state: wp.int32,
    slot: wp.int32,
    code: wp.int32,
    level: wp.int32,
    vertices: wp.int32,
    edges: wp.int32,
):
    """Begin a square with its left side's first edge, from the upper left corner down.

    Returns corner, lower end, edge, and the next free vertex and edge number. Side and corner come from the left
    neighbour if there is one; they are imports if an earlier slice made them. Otherwise they are new, and the edge is
    written to `w.edges`. The corner is noted in `w.corners`. code: the leaf's word. level: the edge's level. vertices,
    edges: the next free numbers.
    """
    square = w.state[first_state + SQUARE]
    column = square % w.columns
    corner = vertices
    end = wp.int32(0)
    entry = edges
    new_vertices = wp.int32(0)
    if column > 0:
        owner = square - 1
        last = w.side_base[square] - 1  # sides lie square by square: the left neighbour's last entry
        w.state[first_state + LEFT] = 1
        if is_in_slice(w, slot, owner, last - w.side_base[owner], RIGHT_SIDE):
            corner = w.corners[2 * owner + 1]
            entry = w.side[last][0]
            end = w.side[last][1]
            check_level(w, first_state, level, w.side_level[last])
        else:
            corner = add_import(w, b, first_state, UPPER_RIGHT, owner)
            end = add_import(w, b, first_state, SIDE | (level << LEVEL_SHIFT), last)
            entry = end  # one import stands for the edge and for its lower end
    else:
        new_vertices = 1  # the corner
        if ((code >> CORNER) & 1) == 1:  # the edge ends on a vertex of the square below
            end = corner_below(w, b, first_state, square)
        else:
            end = vertices + 1
            new_vertices = 2
        w.edges[entry] = wp.vec2i(corner, end)
    w.corners[2 * square] = corner
    return corner, end, entry, vertices + new_vertices, edges + wp.min(new_vertices, 1)


@wp.func
def read_side(w: Weld, b: Base, first_state: wp.int32, slot: wp.int32, role: wp.int32, level: wp.int32) -> wp.vec2i:
    """Return the next (edge, far vertex) of the side shared with the square to the left or below.

    They are imports (negative numbers) if an earlier slice made them; one import stands for both, since `join` finds an
    edge with its far vertex. The slice's state counts the edge as passed.
    role: TAKE_LEFT or TAKE_BELOW. level: the edge's level, which is checked.
    """
    square = w.state[first_state + SQUARE]
    entry = wp.int32(0)
    is_here = wp.bool(False)
    if role == TAKE_LEFT:
        passed = w.state[first_state + LEFT]
        w.state[first_state + LEFT] = passed + 1
        entry = w.side_base[square] - 1 - passed
        is_here = is_in_slice(w, slot, square - 1, entry - w.side_base[square - 1], RIGHT_SIDE)
    else:
        owner = square - w.columns
        passed = w.state[first_state + BELOW]
        w.state[first_state + BELOW] = passed + 1
        upper_side = w.columns * w.rows + owner
        entry = w.side_base[upper_side + 1] - 1 - passed
        is_here = is_in_slice(w, slot, owner, entry - w.side_base[upper_side], UPPER_SIDE)
    shared_edge = wp.vec2i(0, 0)
    if is_here:
        shared_edge = w.side[entry]
        check_level(w, first_state, level, w.side_level[entry])
    else:
        n = add_import(w, b, first_state, SIDE | (level << LEVEL_SHIFT), entry)
        shared_edge = wp.vec2i(n, n)
    return shared_edge


@wp.func
def append_right(w: Weld, first_state: wp.int32, edge: wp.int32, level: wp.int32, begun: wp.int32, far: wp.int32):
    """Append an edge to the right side of the current square, for the square to the right.

    level: the edge's. begun: the vertex at which the curve began the edge. far: its other vertex, which becomes the
    upper right corner at the end of the side.
    """
    square = w.state[first_state + SQUARE]
    n = w.side_base[square] + w.state[first_state + RIGHT]
    w.side[n] = wp.vec2i(edge, begun)
    w.side_level[n] = level
    w.state[first_state + RIGHT] = w.state[first_state + RIGHT] + 1
    if n + 1 == w.side_base[square + 1]:  # the side ends
        w.corners[2 * square + 1] = far


@wp.func
def append_above(w: Weld, first_state: wp.int32, edge: wp.int32, level: wp.int32, begun: wp.int32):
    """Append an edge to the upper side of the current square, for the square above.

    level: the edge's. begun: the vertex at which the curve began the edge.
    """
    n = w.side_base[w.columns * w.rows + w.state[first_state + SQUARE]] + w.state[first_state + ABOVE]
    w.side[n] = wp.vec2i(edge, begun)
    w.side_level[n] = level
    w.state[first_state + ABOVE] = w.state[first_state + ABOVE] + 1
