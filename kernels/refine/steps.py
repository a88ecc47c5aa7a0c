# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of a walk along the curve: into a square, down to a triangle's children, on to the next triangle.

Positions on the curve are counted in deepest cells, 2^cell_bits of them in a root square. A slice is the part of the
curve from `w.first_cell` to before `w.end_cell`.

`w`: the slice's Walk. `q`: its current square; `q.base` is its first deepest cell, and `q.start`, counted from there,
the first one in the slice. `c`: its cursor: a triangle with its first cell in the square, and the `top` of the stack of
triangles that follow (-1: the square or the slice has ended).
"""

import warp as wp

from ..field.domain import Domain
from ..leb.halfway import middle_between
from ..unchecked import item_at, put
from .curve import HYP_LEG, LEG_HYP, left_state, right_state
from .interval import SPLIT, unknown_interval
from .walk_state import STACK, Cursor, Square, Walk, Written

STOPPED = wp.constant(3)  # entry of a slice's counts: 1 if a leaf is too coarse and as deep as leaves may be


@wp.func
def square_at(domain: Domain, w: Walk, number: wp.int32) -> Square:
    """Return root square `number` as a Square, with the cell at which the slice begins in it."""
    q = Square()
    q.number = number
    q.row = number / domain.columns
    q.column = number - q.row * domain.columns
    q.corner = wp.vec2i(q.column << domain.unit_bits, q.row << domain.unit_bits)
    q.side = wp.int32(1) << domain.unit_bits
    q.base = wp.uint64(number) << wp.uint64(w.cell_bits)
    if w.first_cell > q.base:
        q.start = w.first_cell - q.base
    return q


@wp.func
def enter(w: Walk, q: Square) -> Cursor:
    """Return a cursor at the first of a square's two halves, with the other half on the stack; neither is decided.

    A slice that begins later in the square still starts here: `advance` and `emit` leave out earlier triangles. An
    entry of `stack` has a triangle's apex and right corner; the left corner is the right one of the triangle before. An
    entry of `aside` packs its curve state (3 bits), its depth (6 bits) and the index of its interval.
    """
    entry = w.slot * STACK
    x0 = q.corner[0]
    y0 = q.corner[1]
    c = Cursor()
    c.left = wp.vec2i(x0, y0 + q.side)
    c.apex = q.corner
    c.right = wp.vec2i(x0 + q.side, y0)
    # The curve enters the first half by a leg and leaves it by the hypotenuse, by which it enters the second half.
    c.state = LEG_HYP
    c.depth = 1
    c.interval_index = entry
    c.top = 1
    w.stack[entry] = wp.vec4i(x0 + q.side, y0 + q.side, x0, y0 + q.side)
    w.aside[entry] = HYP_LEG | (1 << 3) | (entry << 9)
    w.intervals[entry] = unknown_interval()
    return c


@wp.func
def size_of(w: Walk, depth: wp.int32) -> wp.uint64:
    """Return the number of deepest cells in a triangle at a depth."""
    return wp.uint64(1) << wp.uint64(w.cell_bits - depth)


@wp.func
def middle_of(c: Cursor) -> wp.vec2i:
    """Return the vertex at which the diamond of the cursor's triangle is split: the middle of its longest edge."""
    return middle_between(c.left, c.right)


@wp.func
def advance(w: Walk, q: Square, c: Cursor, verdict: wp.int32) -> Cursor:
    """Move the cursor along the curve: to a child of a split triangle, else to the next triangle on the stack.

    The first child comes first and the second is pushed; if the slice begins after the first, the cursor moves to the
    second. `top` becomes -1 at the end of the square or the slice. Fields are assigned one by one: Warp copies a struct
    that is assigned whole in a branch, even if the branch is not taken. verdict: SPLIT to split the triangle.
    """
    if verdict == SPLIT:
        middle = middle_of(c)
        c.depth = c.depth + 1
        half = size_of(w, c.depth)
        if c.cell + half > q.start:  # a part of the first child is in the slice
            entry = w.slot * STACK + c.top
            put(w.stack, entry, wp.vec4i(middle[0], middle[1], c.right[0], c.right[1]))
            put(w.aside, wp.int64(entry), right_state(c.state, c.cell) | (c.depth << 3) | (c.interval_index << 9))
            c.top = c.top + 1
            c.state = left_state(c.state)
            c.right = c.apex
        else:
            c.state = right_state(c.state, c.cell)
            c.left = c.apex
            c.cell = c.cell + half
        c.apex = middle
    else:
        c.cell = c.cell + size_of(w, c.depth)
        c.top = wp.where(q.base + c.cell >= w.end_cell, -1, c.top - 1)
        if c.top >= 0:
            top_entry = w.slot * STACK + c.top
            c.left = c.right
            corners = item_at(w.stack, top_entry)
            c.apex = wp.vec2i(corners[0], corners[1])
            c.right = wp.vec2i(corners[2], corners[3])
            packed = item_at(w.aside, top_entry)
            c.state = packed & 7
            c.depth = (packed >> 3) & 63
            c.interval_index = packed >> 9
    return c


@wp.func
def put_results(w: Walk, n: Written, end: wp.uint64):
    """Write a slice's counts n of leaves, vertices and edges, and `end`, the cell after its last leaf."""
    w.ends[w.slot] = end
    w.counts[4 * w.slot] = n.leaves
    w.counts[4 * w.slot + 1] = n.vertices
    w.counts[4 * w.slot + 2] = n.edges
