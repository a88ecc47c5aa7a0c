# SPDX-License-Identifier: GPL-3.0-or-later
"""Heap ids, vertices, neighbours and diamonds of longest-edge bisection, at any depth and on any grid."""

import bisection
from adaptive_terrain.cbt_terrain.field.lattice import Lattice
from edited_tree import EditedTree
from hypothesis import given
from hypothesis import strategies as st

GRIDS = st.sampled_from([(1, 1), (2, 1), (1, 3), (3, 2), (5, 3), (16, 1)])
EXPONENT = bisection.MAX_DEPTH // 2


@st.composite
def nodes(draw, deepest=bisection.MAX_DEPTH):
    """Draw a lattice and one of its nodes."""
    lattice = Lattice(*draw(GRIDS), 0)
    depth = draw(st.integers(1, deepest))
    return lattice, (draw(st.integers(0, lattice.squares - 1)), draw(st.integers(1 << depth, (2 << depth) - 1)))


def corners(lattice, node):
    """Return the vertices of a node in units of the whole grid."""
    row, column = divmod(node[0], lattice.columns)
    return [(x + (column << EXPONENT), y + (row << EXPONENT)) for x, y in bisection.triangle(node[1], EXPONENT)]


@given(nodes())
def test_id_vertices_id(case):
    lattice, (square, heap_id) = case
    vertices = bisection.triangle(heap_id, EXPONENT)
    assert bisection.heap_id_of(vertices, EXPONENT) == heap_id
    assert bisection.from_tree_id(lattice, bisection.to_tree_id(lattice, (square, heap_id))) == (square, heap_id)


@given(nodes(bisection.MAX_DEPTH - 1))
def test_children_halve_their_parent(case):
    _, (_, heap_id) = case
    (left, apex, right), halves = bisection.triangle(heap_id, EXPONENT), bisection.children(heap_id)
    if bisection.depth_of(heap_id) % 2 == 0 and bisection.depth_of(heap_id) // 2 == EXPONENT:
        return  # the middle of its edge is between whole units
    middle = ((left[0] + right[0]) // 2, (left[1] + right[1]) // 2)
    assert [bisection.triangle(half, EXPONENT) for half in halves] == [(left, middle, apex), (apex, middle, right)]
    assert [bisection.parent(half) for half in halves] == [heap_id] * 2


@given(nodes())
def test_neighbours_share_their_edge_and_are_mutual(case):
    lattice, node = case
    left, apex, right = corners(lattice, node)
    over = dict(zip(((apex, right), (left, apex), (left, right)), bisection.neighbours(lattice, node), strict=True))
    wide, high = lattice.columns << EXPONENT, lattice.rows << EXPONENT
    for edge, other in over.items():
        if other is None:  # then the edge runs along the grid's border
            xs, ys = {x for x, _ in edge}, {y for _, y in edge}
            assert xs in ({0}, {wide}) or ys in ({0}, {high})
            continue
        assert set(edge) < set(corners(lattice, other)) and other != node
        assert bisection.depth_of(other[1]) == bisection.depth_of(node[1])
        assert node in bisection.neighbours(lattice, other)


@given(nodes())
def test_a_diamond_is_one_for_both_of_its_triangles(case):
    lattice, node = case
    here, other = bisection.diamond(lattice, node)
    assert here == node
    if other is not None:
        assert set(bisection.diamond(lattice, other)) == {node, other}
        ends = corners(lattice, node)[0], corners(lattice, node)[2]
        assert {corners(lattice, other)[0], corners(lattice, other)[2]} == set(ends)


@given(GRIDS, st.lists(st.integers(0, 10**6), min_size=1, max_size=25), st.integers(0, 10**6))
def test_split_then_merge_in_reverse_gives_the_tree_back(grid, picks, pick):
    lattice = Lattice(*grid, 0)
    tree = EditedTree(26)
    bisection.plant(tree, lattice)

    def splittable():
        found = [bisection.from_tree_id(lattice, leaf) for leaf in tree.leaves().tolist()]
        return [node for node in found if node[0] < lattice.squares and bisection.depth_of(node[1]) < 18]

    states, done = [tree.to_bytes()], []
    for pick in picks:
        choice = splittable()
        done.append(bisection.split_conforming(tree, lattice, choice[pick % len(choice)]))
        states.append(tree.to_bytes())
    for split in reversed(done):
        assert tree.to_bytes() == states.pop()
        for node in reversed(split):
            bisection.merge_conforming(tree, lattice, node)
    assert tree.to_bytes() == states.pop()
