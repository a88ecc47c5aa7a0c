# SPDX-License-Identifier: GPL-3.0-or-later
"""Longest-edge bisection of a grid of root squares: pure functions from heap ids to triangles, neighbours and diamonds.

A triangle is (left, apex, right); its longest edge runs from left to right, and bisection puts a vertex in its middle:
child 0 is (left, middle, apex), child 1 is (apex, middle, right). In one square the roots are ids 2 and 3, depth 1, on
either side of the square's diagonal; id 1 is the square. A `Node` is a square's number, row by row from the south west,
and an id in that square. Coordinates are integers, 2**exponent a side; depth d needs an exponent of d // 2.

Conforming split and merge edit a tree by hand; a refinement for a view needs neither.
"""

import numpy as np
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.lattice import Lattice
from edited_tree import EditedTree

MAX_DEPTH = 62  # ids fit int64, and so do squared edge lengths in units

Point = tuple[int, int]
Node = tuple[int, int]

# Neighbours (left, right, edge) of depths 1 and 2 as (columns to the east, rows to the north, id). Roots of two squares
# meet turned by half a turn, not mirrored like other neighbours, so the rule for each bit holds from depth 2 on.
_SQUARE_NEIGHBOURS = {
    2: ((0, -1, 3), (-1, 0, 3), (0, 0, 3)),
    3: ((0, 1, 2), (1, 0, 2), (0, 0, 2)),
    4: ((0, 0, 5), (0, 0, 7), (-1, 0, 6)),
    5: ((0, 0, 6), (0, 0, 4), (0, -1, 7)),
    6: ((0, 0, 7), (0, 0, 5), (1, 0, 4)),
    7: ((0, 0, 4), (0, 0, 6), (0, 1, 5)),
}


# Ids


def depth_of(heap_id: int) -> int:
    """Depth of a node: 0 for the square, 1 for its two roots."""
    return heap_id.bit_length() - 1


def parent(heap_id: int) -> int:
    """Return the node that `heap_id` is a half of."""
    return heap_id >> 1


def children(heap_id: int) -> tuple[int, int]:
    """Return the left and the right half of a node."""
    return 2 * heap_id, 2 * heap_id + 1


def to_tree_id(lattice: Lattice, node: Node) -> int:
    """Id of a node in the tree of the whole grid: squares are the nodes at depth `lattice.square_bits`."""
    square, heap_id = node
    depth = depth_of(heap_id)
    return (((1 << lattice.square_bits) + square) << depth) + heap_id - (1 << depth)


def from_tree_id(lattice: Lattice, tree_id: int) -> Node:
    """Square and id of a node of the grid's tree; undoes `to_tree_id`."""
    depth = depth_of(tree_id) - lattice.square_bits
    if depth < 0:
        raise TerrainError(f"Tree node {tree_id} holds several squares; expected {1 << lattice.square_bits} or more.")
    return (tree_id >> depth) - (1 << lattice.square_bits), (tree_id & ((1 << depth) - 1)) | 1 << depth


# Triangles


def triangle(heap_id: int, exponent: int) -> tuple[Point, Point, Point]:
    """Return the vertices (left, apex, right) of a node of depth 1 or more, in units of 2**-exponent sides."""
    depth = depth_of(heap_id)
    _check(depth, exponent, heap_id)
    side = 1 << exponent
    left, apex, right = (0, side), (0, 0), (side, 0)
    if heap_id >> depth - 1 & 1:
        left, apex, right = right, (side, side), left
    for bit in range(depth - 2, -1, -1):
        middle = (left[0] + right[0]) >> 1, (left[1] + right[1]) >> 1
        left, apex, right = (apex, middle, right) if heap_id >> bit & 1 else (left, middle, apex)
    return left, apex, right


def triangles(heap_ids: np.ndarray, exponent: int) -> np.ndarray:
    """`triangle` of many nodes: uint64 [n] to int64 [n, 3, 2]."""
    ids = np.asarray(heap_ids, np.uint64).astype(np.int64)
    if len(ids) == 0:
        return np.empty((0, 3, 2), np.int64)
    deepest = depth_of(int(ids.max()))
    _check(depth_of(int(ids.min())), exponent, int(ids.min()))
    _check(deepest, exponent, int(ids.max()))
    depth = np.searchsorted(1 << np.arange(deepest + 1, dtype=np.int64), ids, side="right") - 1
    side = 1 << exponent
    roots = np.array([[[0, side], [0, 0], [side, 0]], [[side, 0], [side, side], [0, side]]], np.int64)
    corners = roots[(ids >> depth - 1) & 1]
    for level in range(1, deepest):
        rows = np.flatnonzero(depth > level)
        left, apex, right = corners[rows, 0], corners[rows, 1], corners[rows, 2]
        second = ((ids[rows] >> depth[rows] - 1 - level) & 1).astype(bool)[:, None]
        halves = [np.where(second, apex, left), (left + right) >> 1, np.where(second, right, apex)]
        corners[rows] = np.stack(halves, axis=1)
    return corners


def heap_id_of(vertices: tuple[Point, Point, Point], exponent: int) -> int:
    """Id of the node with these vertices (left, apex, right); undoes `triangle`."""
    (lx, ly), (ax, ay), (rx, ry) = vertices
    twice_area = abs((lx - ax) * (ry - ay) - (ly - ay) * (rx - ax))
    depth = 2 * exponent + 2 - twice_area.bit_length()
    side = 1 << exponent
    inside = lx + ax + rx, ly + ay + ry  # three times the centroid
    heap_id = 2 if inside[0] + inside[1] < 3 * side else 3
    left, apex, right = triangle(heap_id, exponent)
    while depth_of(heap_id) < depth:
        middle = (left[0] + right[0]) >> 1, (left[1] + right[1]) >> 1
        x, y = inside[0] - 3 * middle[0], inside[1] - 3 * middle[1]
        to_left = (left[0] - middle[0]) * x + (left[1] - middle[1]) * y
        heap_id = 2 * heap_id + (to_left < 0)
        left, apex, right = (left, middle, apex) if to_left > 0 else (apex, middle, right)
    if (left, apex, right) != tuple(vertices):
        raise TerrainError(f"No node of a square of side 2**{exponent} has the vertices {vertices}.")
    return heap_id


def plane_coordinates(heap_ids: np.ndarray, dtype=np.float32) -> np.ndarray:
    """Return the exact vertices of nodes in the unit square: uint64 [n] to float32 or float64 [n, 3, 2].

    Each node is exact in float32 to depth 48, and in float64. Raises TerrainError where float32 would round.
    """
    exponent = MAX_DEPTH // 2
    exact = triangles(heap_ids, exponent) / float(1 << exponent)
    result = exact.astype(dtype)
    rounded = (result != exact).any(axis=(1, 2))
    if rounded.any():
        worst = int(np.asarray(heap_ids)[rounded].max())
        raise TerrainError(
            f"Node {worst} at depth {depth_of(worst)} has vertices that {np.dtype(dtype).name} cannot hold; "
            "expected depth 48 or less; ask for float64 coordinates."
        )
    return result


# Neighbours


def neighbours(lattice: Lattice, node: Node) -> tuple[Node | None, Node | None, Node | None]:
    """Return the nodes of equal depth over the edges apex-right ("left"), left-apex ("right") and left-right ("edge").

    None over the grid's border. The names and the rule for each bit are those of libleb.
    """
    square, heap_id = node
    depth = depth_of(heap_id)
    _check(depth, MAX_DEPTH, heap_id)
    row, column = divmod(square, lattice.columns)
    start = min(depth, 2)
    near = [
        (column + dx, row + dy, n) if 0 <= column + dx < lattice.columns and 0 <= row + dy < lattice.rows else None
        for dx, dy, n in _SQUARE_NEIGHBOURS[heap_id >> depth - start]
    ]
    own = (column, row, heap_id >> depth - start)
    for bit in range(depth - start - 1, -1, -1):
        left, right, edge = near
        if heap_id >> bit & 1:
            near, own = [_half(edge, 0), _half(own, 0), _half(left, 0)], _half(own, 1)
        else:
            near, own = [_half(own, 1), _half(edge, 1), _half(right, 1)], _half(own, 0)
    left, right, edge = (n and (n[1] * lattice.columns + n[0], n[2]) for n in near)
    return left, right, edge


def diamond(lattice: Lattice, node: Node) -> tuple[Node, Node | None]:
    """Return the node and the one over its longest edge, perhaps in another square: both split and merge together."""
    return node, neighbours(lattice, node)[2]


# Edits that keep the mesh free of T-junctions


def plant(tree: EditedTree, lattice: Lattice) -> None:
    """Make the tree's leaves the two roots of each square, and one leaf for each number after the last square."""
    shift = tree.max_depth - lattice.square_bits
    if shift < 1:
        raise TerrainError(f"A tree of depth {tree.max_depth} is too shallow for {lattice.squares} root squares.")
    roots = np.arange(2 * lattice.squares, dtype=np.int64) << (shift - 1)
    unused = np.arange(lattice.squares, 1 << lattice.square_bits, dtype=np.int64) << shift
    tree.put(np.concatenate([roots, unused]))


def split_conforming(tree: EditedTree, lattice: Lattice, node: Node) -> list[Node]:
    """Split a leaf with the other half of its diamond, coarser neighbours first; return the split nodes in order.

    Forced splits as in ROAM (Duchaineau et al. 1997): a node's longest edge is split on both sides or not at all.
    """
    _check_leaf(tree, lattice, node)
    if to_tree_id(lattice, node) >= tree.cell_count:
        raise TerrainError(f"Node {node} is at the tree's deepest level, {tree.max_depth}; it cannot be split.")
    done: list[Node] = []
    waiting = [node]
    while waiting:
        here, other = diamond(lattice, waiting[-1])
        if other is None or tree.is_leaf(to_tree_id(lattice, other)):
            for half in (here, other):
                if half is not None:
                    tree.split(to_tree_id(lattice, half))
                    done.append(half)
            waiting.pop()
        else:
            waiting.append((other[0], parent(other[1])))
    return done


def merge_conforming(tree: EditedTree, lattice: Lattice, node: Node) -> list[Node]:
    """Merge the halves of `node` and of the other triangle of its diamond; return the merged nodes.

    A diamond is merged whole or, where one of its four halves is split further, not at all: then the list is empty.
    """
    whole = [half for half in diamond(lattice, node) if half is not None]
    if not all(tree.is_leaf(to_tree_id(lattice, (s, child))) for s, n in whole for child in children(n)):
        return []
    for half in whole:
        tree.merge(to_tree_id(lattice, half))
    return whole


def _half(node: tuple[int, int, int] | None, bit: int) -> tuple[int, int, int] | None:
    return node and (node[0], node[1], 2 * node[2] + bit)


def _check(depth: int, exponent: int, heap_id: int) -> None:
    if not 1 <= depth <= MAX_DEPTH:
        raise TerrainError(f"Node {heap_id} is at depth {depth}; expected a triangle, depth 1 .. {MAX_DEPTH}.")
    if exponent < depth // 2:
        raise TerrainError(
            f"Node {heap_id} at depth {depth} has vertices between whole units of 2**-{exponent}; "
            f"expected an exponent of {depth // 2} or more."
        )


def _check_leaf(tree: EditedTree, lattice: Lattice, node: Node) -> None:
    if not (0 <= node[0] < lattice.squares and tree.is_leaf(to_tree_id(lattice, node))):
        raise TerrainError(f"Node {node} is not a leaf of the tree; only a leaf can be split.")
