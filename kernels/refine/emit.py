# SPDX-License-Identifier: GPL-3.0-or-later
"""Output of a walk: a word per leaf and a point per new vertex. Leaves beyond the capacity are only counted.

A walk visits a slice: a contiguous part of the Sierpinski curve over all root squares, located by the numbers of the
deepest cells along it. A leaf's word has 16 bits: its curve state, its depth and flags (curve.py). An even block is all
leaves below a triangle if they have one depth; it is written at once.

`w`: the slice's Walk; its words and points begin at entry `w.leaf_base`, with room for `w.leaf_capacity`. `q`: its
current square; `q.start` is the square's first cell in the slice. `c`: its cursor, with the triangle's first `cell` in
the square. `n`: its counts so far.
"""

import warp as wp

from ..field.domain import Domain
from ..unchecked import put
from .block import new_vertices, write_block
from .curve import (
    BORDER,
    CORNER,
    FIRST,
    INNER,
    LAST,
    TAKE_BELOW,
    TAKE_LEFT,
    TO_CORNER,
    border_role,
    end_of_entry,
    leaf_word,
    third_edge,
    touches_border,
)
from .interval import EVEN_BLOCK, LEAF
from .steps import size_of
from .walk_state import Cursor, Square, Walk, Written


@wp.func
def count_side(domain: Domain, w: Walk, q: Square, side: wp.int32):
    """Count one more edge on a side of square q in `w.sides`, which has four counts for each slice and square.

    side: 0 for an edge that the square to the left has already written, 1 for one that the square below has; 2 for one
    that the square to the right will use, 3 for one that the square above will.
    """
    entry = 4 * (w.slot * domain.columns * domain.rows + q.number) + side
    w.sides[entry] = w.sides[entry] + 1


@wp.func
def emit_entry(domain: Domain, w: Walk, q: Square, c: Cursor, n: Written):
    """Write the edge through which the curve enters a square; return flags for the first leaf, new vertices, new edges.

    flags: bits of the leaf's word. The edge is new, unless the square to the left has it on its right side already.
    """
    flags = wp.uint32(1) << wp.uint32(FIRST)
    vertices = wp.int32(0)
    edges = wp.int32(0)
    entry_end = end_of_entry(c.state, c.apex, c.right)
    if q.column > 0:  # the square to the left has made the edge
        count_side(domain, w, q, 0)
    else:
        edges = 1
        vertices = 2
        if q.row > 0 and entry_end[1] == q.corner[1]:  # on the corner that the square below has made
            flags = flags | (wp.uint32(1) << wp.uint32(CORNER))
            vertices = 1
        if n.leaves < w.leaf_capacity:
            w.point[w.leaf_base + n.vertices] = c.left
            w.point[w.leaf_base + n.vertices + wp.int64(1)] = entry_end  # stays only if it is new
    return flags, vertices, edges


@wp.func
def emit_leaf(domain: Domain, w: Walk, q: Square, c: Cursor, n: Written):
    """Write the word and the new vertices of the leaf at the cursor; return the numbers of new vertices and edges.

    Edges on sides that squares share are counted in `w.sides`, too. The role of the leaf's third edge says whether the
    square to the left or below has already made it (TAKE_LEFT, TAKE_BELOW), whether a later square will read it
    (GIVE_RIGHT, GIVE_ABOVE), or whether only its end is an existing corner (TO_CORNER).
    """
    code = leaf_word(c.state, c.depth)
    vertices = wp.int32(0)
    edges = wp.int32(1)  # the one through which the curve leaves
    if c.cell == wp.uint64(0):  # the square's first leaf
        flags, entry_vertices, entry_edges = emit_entry(domain, w, q, c, n)
        code = code | flags
        vertices = entry_vertices
        edges += entry_edges
    known, new = third_edge(c.state, c.left, c.apex, c.right)
    if n.leaves < w.leaf_capacity:
        put(w.point, w.leaf_base + n.vertices + wp.int64(vertices), new)  # stays only if it is new
    new_edge = 1 - (c.state & 1)  # bit 0: the curve has passed the third edge before
    new_vertex = new_edge  # a new edge ends on a new vertex, except on the border of a square
    if w.grid == 1 and new_edge == 1:  # there are several squares
        role = border_role(known, new, q.corner, q.side, q.column, q.row, domain.columns, domain.rows)
        code = code | (wp.uint32(role) << wp.uint32(BORDER))
        if role != INNER and role != TO_CORNER:
            count_side(domain, w, q, role - 1)  # sides are in the order of roles
        if role == TAKE_LEFT or role == TAKE_BELOW:
            new_edge = 0
            new_vertex = 0
        if role == TO_CORNER:
            new_vertex = 0
    if c.cell + size_of(w, c.depth) == size_of(w, 0):  # the square's last leaf
        code = code | (wp.uint32(1) << wp.uint32(LAST))
        if q.row < domain.rows - 1:  # the curve leaves the square through its upper side
            count_side(domain, w, q, 3)
    if n.leaves < w.leaf_capacity:
        put(w.code, w.leaf_base + n.leaves, wp.uint16(code))
    return vertices + new_vertex, edges + new_edge


@wp.func
def can_copy_block(w: Walk, q: Square, c: Cursor) -> wp.bool:
    """Return whether all leaves below the cursor's triangle can be copied as one block.

    All of them must be in the walk's slice, and none may have special bits. Special are the first and the last leaf of
    a square and, if the walk has several squares (`w.grid` is 1), the leaves on a square's border.
    """
    # c.cell, q.start and `end` are counted from the square's first cell (q.base), w.end_cell over all squares.
    end = c.cell + size_of(w, c.depth)
    inside = c.cell > wp.uint64(0) and end < size_of(w, 0) and c.cell >= q.start and q.base + end <= w.end_cell
    return inside and (w.grid == 0 or not touches_border(c.left, c.apex, c.right, q.corner, q.side))


@wp.func
def emit_block(w: Walk, q: Square, c: Cursor, n: Written, depth: wp.int32) -> wp.int32:
    """Write all leaves below the cursor, at this depth, from the table; return the number of new vertices."""
    bisections = depth - c.depth
    leaves = 1 << bisections
    if n.leaves + wp.int64(leaves) <= w.leaf_capacity:
        word = wp.uint16(leaf_word(0, depth))
        leaf = w.leaf_base + n.leaves
        vertex = w.leaf_base + n.vertices
        write_block(w.blocks, c.state, bisections, c.left, c.apex, c.right, word, w.code, leaf, w.point, vertex)
    return new_vertices(w.blocks, c.state, bisections)


@wp.func
def emit(domain: Domain, w: Walk, q: Square, c: Cursor, n: Written, verdict: wp.int32) -> Written:
    """Write the leaves below the cursor's triangle if its verdict is LEAF or EVEN_BLOCK; return the new counts.

    A leaf that begins before the slice belongs to the one before and is left out; a block is inside the slice
    (`can_copy_block`).
    """
    leaves = wp.int32(0)
    vertices = wp.int32(0)
    edges = wp.int32(0)
    if verdict == LEAF:
        if c.cell >= q.start:
            leaves = 1
            vertices, edges = emit_leaf(domain, w, q, c, n)
    elif verdict == EVEN_BLOCK:
        depth = w.intervals[c.interval_index].even_depth
        leaves = 1 << (depth - c.depth)
        vertices = emit_block(w, q, c, n, depth)
        edges = leaves + vertices  # a leaf adds the edge by which the curve leaves it, a new vertex one more
    n.leaves = n.leaves + wp.int64(leaves)
    n.vertices = n.vertices + wp.int64(vertices)
    n.edges = n.edges + wp.int64(edges)
    return n
