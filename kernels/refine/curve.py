# SPDX-License-Identifier: GPL-3.0-or-later
"""The curve through the leaves: how it passes a triangle, and where a square's border is shared.

Child 0 of a triangle (left, apex, right) is (left, middle, apex), child 1 is (apex, middle, right): depth-first order
is the Sierpinski curve, so consecutive leaves share an edge. A leaf is entered and left through known edges; whether
its third edge was passed before is carried down the walk in a state of three bits. Cells are the triangles at the
greatest depth, numbered along the curve in a square; a triangle is located by its first cell.

Root squares are walked row by row, each a closed curve from its upper left corner, counter-clockwise along its border:
left side down, bottom right, right side up, top left. So a side that a square shares with an earlier one is passed in
the opposite direction, last edge first.
"""

import warp as wp

# A leaf's word of 16 bits: state, parity of the depth, role of the third edge on the square's border, flags, depth.
# Shifts; the state is lowest.
PARITY = wp.constant(3)
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
# States of the children, four bits for each state of the parent, that of state 0 lowest.
LEFT_STATES = wp.constant(0x221032)
RIGHT_STATES = wp.constant(0x105554)

# Roles of a third edge on the border of its square.
INNER = wp.constant(0)  # not on a side that is shared with another square
TAKE_LEFT = wp.constant(1)  # the square to the left has made it
TAKE_BELOW = wp.constant(2)
GIVE_RIGHT = wp.constant(3)  # the square to the right will take it
GIVE_ABOVE = wp.constant(4)
TO_CORNER = wp.constant(5)  # a new edge to a vertex that the square below has made


@wp.func
def left_state(state: wp.int32) -> wp.int32:
    """Return the state (3 bits) of the curve in child 0 of a triangle whose state is `state`."""
    return (LEFT_STATES >> (4 * state)) & 7


@wp.func
def right_state(state: wp.int32, cell: wp.uint64) -> wp.int32:
    """Return the state (3 bits) of the curve in child 1 of a triangle whose state is `state`, from a table.

    cell: the triangle's first deepest cell, counted in the square. Bit 0 is 1 if the third edge was passed before.
    """
    s = (RIGHT_STATES >> (4 * state)) & 7
    if cell == wp.uint64(0):
        s = s & 6  # the curve starts on the border: the other half of its entry edge was never passed
    return s


@wp.func
def leaf_word(state: wp.int32, depth: wp.int32) -> wp.uint32:
    """Return a leaf's 16-bit word: state of the curve and depth, without its border role and flags."""
    return wp.uint32(state | ((depth & 1) << PARITY) | (depth << DEPTH_SHIFT))


@wp.func
def touches_border(left: wp.vec2i, apex: wp.vec2i, right: wp.vec2i, corner: wp.vec2i, side: wp.int32) -> wp.bool:
    """Return whether a triangle has a vertex on the border of its square. All in lattice units.

    corner, side: south-west corner and side of the square.
    """
    low = wp.min(wp.min(left, right), apex) - corner
    high = wp.max(wp.max(left, right), apex) - corner
    return low[0] == 0 or low[1] == 0 or high[0] == side or high[1] == side


@wp.func
def end_of_entry(state: wp.int32, apex: wp.vec2i, right: wp.vec2i) -> wp.vec2i:
    """Return the far end of the edge by which the curve enters a triangle with this state and these corners.

    The edge begins at the triangle's left vertex.
    """
    end = apex
    if (state & 6) == HYP_LEG:  # it enters by the hypotenuse
        end = right
    return end


@wp.func
def third_edge(state: wp.int32, left: wp.vec2i, apex: wp.vec2i, right: wp.vec2i):
    """Return the ends of the edge that the curve does not cross: a known vertex, and one that is new if the edge is.

    state: the curve's state in the triangle. The edge is new if the state's lowest bit is 0.
    """
    passage = state & 6
    known = left
    if passage == LEG_HYP:
        known = apex
    new = right
    if passage == HYP_LEG:
        new = apex
    return known, new


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
    """Return the border role (INNER .. TO_CORNER) of a leaf's third edge p - q.

    Squares write their right and upper sides for later squares, which read them as their left and lower sides. corner,
    side: south-west corner and side of the leaf's square, lattice units. column, row: its position. columns, rows:
    numbers of squares.
    """
    role = INNER
    if p[0] == q[0]:  # the edge runs from south to north
        if p[0] == corner[0]:
            if column > 0:
                role = TAKE_LEFT
            elif row > 0 and wp.min(p[1], q[1]) == corner[1]:  # it ends on the square's lower left corner
                role = TO_CORNER
        elif p[0] == corner[0] + side and column < columns - 1:
            role = GIVE_RIGHT
    elif p[1] == q[1]:  # from west to east
        if p[1] == corner[1] and row > 0:
            role = TAKE_BELOW
        elif p[1] == corner[1] + side and row < rows - 1:
            role = GIVE_ABOVE
    return role
