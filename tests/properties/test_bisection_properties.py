# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertices, neighbours and diamonds of longest-edge bisection, at any depth and on any grid."""

import numpy as np
from adaptive_terrain.cbt_terrain.field.lattice import Lattice
from adaptive_terrain.cbt_terrain.leb import bisection
from adaptive_terrain.cbt_terrain.tree.concurrent_binary_tree import ConcurrentBinaryTree
from hypothesis import given
from hypothesis import strategies as st
from reference_bisection import leaves_of, split_nodes, to_tree_id

GRIDS = st.sampled_from([(1, 1), (2, 1), (1, 3), (3, 2), (5, 3), (16, 1)])
EXPONENT = 24
DEEPEST = 2 * EXPONENT


@st.composite
def nodes(draw, deepest=DEEPEST):
    """Draw a lattice and the tree id of one of its nodes."""
    lattice = Lattice(*draw(GRIDS), 0)
    depth = draw(st.integers(1, deepest))
    node = draw(st.integers(0, lattice.squares - 1)), draw(st.integers(1 << depth, (2 << depth) - 1))
    return lattice, to_tree_id(lattice, node)


def corners(lattice, tree_id):
    """Return the vertices of a node in units of the whole grid."""
    return list(map(tuple, bisection.triangles(lattice, np.array([tree_id], np.uint64), EXPONENT)[0].tolist()))


def neighbours(lattice, tree_id):
    """Return the nodes over the edges apex-right, left-apex and left-right; 0 beyond the grid."""
    return bisection.neighbours(lattice, np.array([tree_id], np.uint64))[0].tolist()


@given(nodes(DEEPEST - 1))
def test_children_halve_their_parent(case):
    lattice, tree_id = case
    left, apex, right = corners(lattice, tree_id)
    middle = ((left[0] + right[0]) // 2, (left[1] + right[1]) // 2)
    assert corners(lattice, 2 * tree_id) == [left, middle, apex]
    assert corners(lattice, 2 * tree_id + 1) == [apex, middle, right]


@given(nodes())
def test_neighbours_share_their_edge_and_are_mutual(case):
    lattice, node = case
    left, apex, right = corners(lattice, node)
    over = dict(zip(((apex, right), (left, apex), (left, right)), neighbours(lattice, node), strict=True))
    wide, high = lattice.columns << EXPONENT, lattice.rows << EXPONENT
    for edge, other in over.items():
        if other == 0:  # then the edge runs along the grid's border
            xs, ys = {x for x, _ in edge}, {y for _, y in edge}
            assert xs in ({0}, {wide}) or ys in ({0}, {high})
            continue
        assert set(edge) < set(corners(lattice, other)) and other != node
        assert other.bit_length() == node.bit_length()
        assert node in neighbours(lattice, other)


@given(nodes())
def test_a_diamond_is_one_for_both_of_its_triangles(case):
    lattice, node = case
    other = neighbours(lattice, node)[2]
    if other:
        assert neighbours(lattice, other)[2] == node
        assert {corners(lattice, other)[k] for k in (0, 2)} == {corners(lattice, node)[k] for k in (0, 2)}


@given(GRIDS, st.lists(st.integers(0, 10**6), min_size=1, max_size=25))
def test_split_then_merge_in_reverse_gives_the_tree_back(grid, picks):
    lattice = Lattice(*grid, 0)
    tree = ConcurrentBinaryTree(26)
    bisection.plant(tree, lattice)
    states = []
    for pick in picks:
        choice = sorted(node for node in leaves_of(tree, lattice) if node[1].bit_length() <= 18)
        states.append((tree.to_bytes(), leaves_of(tree, lattice)))
        picked = to_tree_id(lattice, choice[pick % len(choice)])
        bisection.split_conforming(tree, lattice, np.array([picked], np.uint64))
        assert picked not in tree.leaves()
    for before, leaves in reversed(states):
        split = split_nodes(leaves_of(tree, lattice)) - split_nodes(leaves)
        for node in sorted(split, key=lambda node: -node[1].bit_length()):
            bisection.merge_conforming(tree, lattice, np.array([to_tree_id(lattice, node)], np.uint64))
        assert tree.to_bytes() == before
