# SPDX-License-Identifier: GPL-3.0-or-later
"""Longest-edge bisection of a grid of root squares.

Functions from heap ids to triangles and neighbours, and conforming edits of the tree (Dupuy 2020, section 4).

A triangle is (left, apex, right); its longest edge runs from left to right, and bisection puts a vertex in its middle:
child 0 is (left, middle, apex), child 1 is (apex, middle, right). In a square the roots are ids 2 and 3, depth 1, on
either side of the square's diagonal; id 1 is the square. In the tree of the grid the squares are the nodes at depth
`square_bits`, row by row from the south west. `t` is the tree's Bitfield, which can be read and edited; a `tree_id` is
a heap id in it.
"""

import warp as wp

from ..tree.atomic import highest_bit
from ..tree.bitfield import ONE, Bitfield, is_leaf
from ..tree.edits import split
from .halfway import middle_between

# Neighbours (left, right, edge) of ids 2 .. 7 as (columns to the east, rows to the north, id). Roots of two squares
# meet turned by half a turn, not mirrored like other neighbours, so the rule for each bit holds from depth 2 on.
FIRST_NEIGHBOURS = wp.constant(
    wp.types.vector(length=54, dtype=wp.int32)(
        *(0, -1, 3, -1, 0, 3, 0, 0, 3),
        *(0, 1, 2, 1, 0, 2, 0, 0, 2),
        *(0, 0, 5, 0, 0, 7, -1, 0, 6),
        *(0, 0, 6, 0, 0, 4, 0, -1, 7),
        *(0, 0, 7, 0, 0, 5, 1, 0, 4),
        *(0, 0, 4, 0, 0, 6, 0, 1, 5),
    )
)


@wp.struct
class SquareGrid:
    """The root squares."""

    columns: wp.int32
    rows: wp.int32
    square_bits: wp.int32  # depth of the squares in the tree


@wp.struct
class LebNode:
    """A triangle by its square and its heap id in that square; id 0: there is none.

    column, row: the square's position in the grid, from the south-west corner.
    """

    column: wp.int32
    row: wp.int32
    heap_id: wp.uint64


@wp.func
def node_of(grid: SquareGrid, tree_id: wp.uint64) -> LebNode:
    """Convert a node's heap id in the tree of all squares to its square and the heap id in that.

    The node is a square or below one. A square that only fills the tree up to a power of two has a row beyond the grid.
    """
    first_id = ONE << wp.uint64(highest_bit(tree_id) - grid.square_bits)  # in the square, at the node's depth
    square = wp.int32(tree_id / first_id) - (1 << grid.square_bits)
    node = LebNode()
    node.row = square / grid.columns
    node.column = square - node.row * grid.columns
    node.heap_id = first_id | (tree_id & (first_id - ONE))
    return node


@wp.func
def tree_id_of(grid: SquareGrid, node: LebNode) -> wp.uint64:
    """Convert a node of a square to its heap id in the tree of all squares; 0 if there is no node.

    It inverts `node_of`.
    """
    tree_id = wp.uint64(0)
    if node.heap_id != wp.uint64(0):
        square_id = wp.uint64((1 << grid.square_bits) + node.row * grid.columns + node.column)
        first_id = ONE << wp.uint64(highest_bit(node.heap_id))
        tree_id = square_id * first_id + node.heap_id - first_id
    return tree_id


@wp.func
def triangle_of(node: LebNode, unit_bits: wp.int32):
    """Return left, apex and right of a node's triangle, in lattice units: 2^unit_bits are a square's side.

    The node's depth in its square is at least 1.
    """
    side = wp.int32(1) << unit_bits
    left = wp.vec2i(0, side)
    apex = wp.vec2i(0, 0)
    right = wp.vec2i(side, 0)
    depth = highest_bit(node.heap_id)
    if ((node.heap_id >> wp.uint64(depth - 1)) & ONE) == ONE:  # root 3, on the other side of the diagonal
        left = wp.vec2i(side, 0)
        apex = wp.vec2i(side, side)
        right = wp.vec2i(0, side)
    for k in range(1, depth):
        middle = middle_between(left, right)
        if ((node.heap_id >> wp.uint64(depth - 1 - k)) & ONE) == ONE:  # child 1
            left = apex
        else:
            right = apex
        apex = middle
    corner = wp.vec2i(node.column << unit_bits, node.row << unit_bits)
    return left + corner, apex + corner, right + corner


@wp.func
def first_neighbour(grid: SquareGrid, node: LebNode, heap_id: wp.int32, edge: wp.int32) -> LebNode:
    """Return a neighbour of the triangle `heap_id` (2 .. 7, depth 1 or 2) in the node's square; id 0 beyond the grid.

    edge: 0 left, 1 right, 2 the longest. The result is read from a table.
    """
    entry = 9 * (heap_id - 2) + 3 * edge
    neighbour = LebNode()
    neighbour.column = node.column + FIRST_NEIGHBOURS[entry]
    neighbour.row = node.row + FIRST_NEIGHBOURS[entry + 1]
    if neighbour.column >= 0 and neighbour.column < grid.columns and neighbour.row >= 0 and neighbour.row < grid.rows:
        neighbour.heap_id = wp.uint64(FIRST_NEIGHBOURS[entry + 2])
    return neighbour


@wp.func
def child_of(node: LebNode, bit: wp.uint64) -> LebNode:
    """Return child 0 or 1 (`bit`) of a node; no node (id 0) if the node is none."""
    if node.heap_id != wp.uint64(0):
        node.heap_id = wp.uint64(2) * node.heap_id + bit
    return node


@wp.func
def neighbours_of(grid: SquareGrid, node: LebNode):
    """Return the neighbours of the same depth across the edges apex-right, left-apex and left-right.

    They need not exist in the tree, which may be coarser there; beyond the grid they have id 0. libleb names them
    "left", "right" and "edge". The node's depth in its square is at least 1.
    """
    depth = highest_bit(node.heap_id)
    start = wp.min(depth, 2)  # depth in the table; neighbours of deeper nodes follow from their parents'
    heap_id = wp.int32(node.heap_id >> wp.uint64(depth - start))
    left = first_neighbour(grid, node, heap_id, 0)
    right = first_neighbour(grid, node, heap_id, 1)
    edge = first_neighbour(grid, node, heap_id, 2)
    ancestor = LebNode()
    ancestor.column = node.column
    ancestor.row = node.row
    ancestor.heap_id = wp.uint64(heap_id)
    for k in range(start, depth):
        bit = (node.heap_id >> wp.uint64(depth - 1 - k)) & ONE
        # Child 1 is the left neighbour of child 0; child 0 is the right neighbour of child 1. Across the parent's
        # longest edge is half of the neighbour there. The child's longest edge is a leg of the parent; `outer` is half
        # of the neighbour across it.
        across = child_of(edge, ONE - bit)
        outer = child_of(right, ONE)
        if bit == ONE:
            outer = child_of(left, wp.uint64(0))
            left = across
            right = child_of(ancestor, wp.uint64(0))
        else:
            left = child_of(ancestor, ONE)
            right = across
        edge = outer
        ancestor = child_of(ancestor, bit)
    return left, right, edge


@wp.func
def edge_neighbour(grid: SquareGrid, node: LebNode) -> LebNode:
    """Return the other triangle of a node's diamond: the neighbour across the longest edge, id 0 at the border."""
    _left, _right, edge = neighbours_of(grid, node)
    return edge


@wp.func
def split_conforming(t: Bitfield, grid: SquareGrid, tree_id: wp.uint64):
    """Split a leaf, the other half of its diamond, and the chain of coarser neighbours that a conforming mesh requires.

    A diamond is split on both sides or not at all: forced splits as in ROAM (Duchaineau et al. 1997). tree_id: the leaf
    in the tree of the grid. Each pass splits the parent of the neighbour across the longest edge, if that parent is
    still a leaf, and then the neighbour; the next pass begins at the parent. It ends at the border, at a neighbour that
    is a root, or at a parent that was split before. The order matters: to split child 1 also sets a bit of its parent,
    so `split` would report the parent as split before. Threads may split neighbours at once: `split` returns whether a
    node was already split, so only the first thread continues with the parent's neighbour.
    """
    split(t, tree_id)
    node = node_of(grid, tree_id)
    is_going_on = wp.bool(True)
    while is_going_on:
        other = edge_neighbour(grid, node)
        is_going_on = other.heap_id != wp.uint64(0)
        if is_going_on:
            node = other
            node.heap_id = other.heap_id >> ONE
            is_going_on = node.heap_id > ONE
            if is_going_on:
                is_going_on = not split(t, tree_id_of(grid, node))
            split(t, tree_id_of(grid, other))


@wp.func
def has_leaves(t: Bitfield, tree_id: wp.uint64) -> wp.bool:
    """Return whether both children of a node are leaves of the tree, so that they can be merged."""
    return is_leaf(t, wp.uint64(2) * tree_id) and is_leaf(t, wp.uint64(2) * tree_id + ONE)


@wp.func
def can_merge(t: Bitfield, grid: SquareGrid, tree_id: wp.uint64) -> wp.bool:
    """Return whether a node's diamond can be merged: the children of both its triangles are leaves."""
    other = tree_id_of(grid, edge_neighbour(grid, node_of(grid, tree_id)))
    is_mergeable = has_leaves(t, tree_id)
    if is_mergeable and other != wp.uint64(0):
        is_mergeable = has_leaves(t, other)
    return is_mergeable
