# SPDX-License-Identifier: GPL-3.0-or-later
"""A brute-force reference for refinements: triangles by their vertices, neighbours by looking up shared edges.

It knows nothing of heap-id rules, bitfields and nested criteria: only "bisect the longest edge, on both sides of it".
"""

from collections import Counter
from collections.abc import Callable

Point = tuple[int, int]
Triangle = tuple[Point, Point, Point]  # left, apex, right; the longest edge runs from left to right


class ReferenceMesh:
    """A conforming triangulation of `columns` x `rows` squares of side 2**exponent: leaves by (square, id)."""

    def __init__(self, columns: int, rows: int, exponent: int):
        self.columns, self.rows, self.side = columns, rows, 1 << exponent
        self.vertices: dict[tuple[int, int], Triangle] = {}
        self.of_edge: dict[frozenset, set] = {}
        for square in range(columns * rows):
            x, y = (square % columns) * self.side, (square // columns) * self.side
            sw, se, nw, ne = (x, y), (x + self.side, y), (x, y + self.side), (x + self.side, y + self.side)
            self._add((square, 2), (nw, sw, se))
            self._add((square, 3), (se, ne, nw))

    @property
    def leaves(self) -> set[tuple[int, int]]:
        return set(self.vertices)

    def middle(self, leaf: tuple[int, int]) -> Point:
        """Return the vertex that splits the leaf."""
        (lx, ly), _, (rx, ry) = self.vertices[leaf]
        assert (lx + rx) % 2 == 0 and (ly + ry) % 2 == 0, "the exponent is too small for this depth"
        return (lx + rx) // 2, (ly + ry) // 2

    def partner(self, leaf: tuple[int, int]) -> tuple[int, int] | None:
        """Return the leaf on the other side of the longest edge."""
        left, _, right = self.vertices[leaf]
        others = self.of_edge[frozenset((left, right))] - {leaf}
        assert len(others) <= 1
        return next(iter(others), None)

    def split(self, leaf: tuple[int, int]) -> list[tuple[int, int]]:
        """Split a leaf, coarser neighbours first; all the halves that were made."""
        made = []
        other = self.partner(leaf)
        while other is not None and self.partner(other) != leaf:
            made += self.split(other)
            other = self.partner(leaf)
        for half in (leaf, other):
            if half is not None:
                made += self._bisect(half)
        return made

    def merge(self, square: int, heap_id: int) -> bool:
        """Merge the diamond whose one triangle is this node, if its four halves (two on a border) are all leaves."""
        if not {(square, 2 * heap_id), (square, 2 * heap_id + 1)} <= self.leaves:
            return False
        middle = self.vertices[square, 2 * heap_id][1]
        around = [leaf for leaf, corners in self.vertices.items() if middle in corners]
        if any(self.vertices[leaf][1] != middle for leaf in around):
            return False
        for square, heap_id in {(s, n // 2) for s, n in around}:
            left, _, apex = self.vertices[square, 2 * heap_id]
            right = self.vertices[square, 2 * heap_id + 1][2]
            self._remove((square, 2 * heap_id))
            self._remove((square, 2 * heap_id + 1))
            self._add((square, heap_id), (left, apex, right))
        return True

    def _bisect(self, leaf: tuple[int, int]) -> list[tuple[int, int]]:
        square, heap_id = leaf
        middle = self.middle(leaf)
        left, apex, right = self.vertices[leaf]
        self._remove(leaf)
        self._add((square, 2 * heap_id), (left, middle, apex))
        self._add((square, 2 * heap_id + 1), (apex, middle, right))
        return [(square, 2 * heap_id), (square, 2 * heap_id + 1)]

    def _add(self, leaf: tuple[int, int], corners: Triangle) -> None:
        self.vertices[leaf] = corners
        for edge in edges_of(corners):
            self.of_edge.setdefault(edge, set()).add(leaf)

    def _remove(self, leaf: tuple[int, int]) -> None:
        for edge in edges_of(self.vertices.pop(leaf)):
            self.of_edge[edge].discard(leaf)


def edges_of(corners: Triangle) -> list[frozenset]:
    """Return the three undirected edges of a triangle."""
    left, apex, right = corners
    return [frozenset((left, apex)), frozenset((apex, right)), frozenset((right, left))]


def corners_of(square: int, heap_id: int, columns: int, exponent: int) -> Triangle:
    """Return the vertices (left, apex, right) of a node by bisection from its root, in grid coordinates."""
    mesh = ReferenceMesh(columns, square // columns + 1, exponent)
    corners = mesh.vertices[square, 2 + (bin(heap_id)[3] == "1")]
    for bit in bin(heap_id)[4:]:
        left, apex, right = corners
        middle = (left[0] + right[0]) // 2, (left[1] + right[1]) // 2
        corners = (left, middle, apex) if bit == "0" else (apex, middle, right)
    return corners


def forced_split_leaves(
    columns: int, rows: int, max_depth: int, wants_split: Callable[[int, int, int], bool], exponent: int | None = None
) -> set[tuple[int, int]]:
    """Return the leaves of the conforming refinement with forced splits (ROAM) as a set of (square, in-square id).

    `wants_split(x, y, depth)` decides each leaf above `max_depth` (bisections inside a square, roots have depth 1) at
    the split vertex, in units of the grid: a square's side is 2**exponent, by default the smallest that makes all
    vertices whole, (max_depth + 1) // 2. x runs east, y north.
    """
    mesh = ReferenceMesh(columns, rows, (max_depth + 1) // 2 if exponent is None else exponent)
    waiting = list(mesh.leaves)
    while waiting:
        leaf = waiting.pop()
        if leaf in mesh.vertices and depth_of(leaf) < max_depth and wants_split(*mesh.middle(leaf), depth_of(leaf)):
            waiting += mesh.split(leaf)
    return mesh.leaves


def depth_of(leaf: tuple[int, int]) -> int:
    """Return the number of bisections of the leaf's square; its two roots have depth 1."""
    return leaf[1].bit_length() - 1


def to_tree_id(lattice, node: tuple[int, int]) -> int:
    """Return a node's id in the tree of the whole grid, whose nodes at depth `lattice.square_bits` are the squares."""
    square, heap_id = node
    first = 1 << heap_id.bit_length() - 1
    return ((1 << lattice.square_bits) + square) * first + heap_id - first


def from_tree_id(lattice, tree_id: int) -> tuple[int, int]:
    """Return the square and the id in it of a node of the grid's tree."""
    first = 1 << int(tree_id).bit_length() - 1 - lattice.square_bits
    square, rest = divmod(int(tree_id), first)
    return square - (1 << lattice.square_bits), rest + first


def leaves_of(tree, lattice) -> set[tuple[int, int]]:
    """Return the grid's leaves in a tree, without the unused numbers after the last square."""
    nodes = (from_tree_id(lattice, leaf) for leaf in tree.leaves())
    return {node for node in nodes if node[0] < lattice.squares}


def split_nodes(leaves: set[tuple[int, int]]) -> set[tuple[int, int]]:
    """Return the triangles above some leaves."""
    split = set()
    for square, heap_id in leaves:
        while (heap_id := heap_id >> 1) > 1 and (square, heap_id) not in split:
            split.add((square, heap_id))
    return split


def assert_conforming(leaves: set[tuple[int, int]], columns: int, rows: int, exponent: int) -> None:
    """Check that each edge belongs to two leaves, or to one at the border, and that the areas add up."""
    side = 1 << exponent
    uses: Counter = Counter()
    twice_area = 0
    for square, heap_id in leaves:
        corners = corners_of(square, heap_id, columns, exponent)
        (lx, ly), (ax, ay), (rx, ry) = corners
        twice_area += abs((lx - ax) * (ry - ay) - (ly - ay) * (rx - ax))
        uses.update(edges_of(corners))
    assert twice_area == 2 * columns * rows * side * side
    for edge, count in uses.items():
        (ax, ay), (bx, by) = edge
        border = (ax == bx and ax in (0, columns * side)) or (ay == by and ay in (0, rows * side))
        assert count == (1 if border else 2), f"edge {sorted(edge)} belongs to {count} triangles"
