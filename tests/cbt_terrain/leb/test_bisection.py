# SPDX-License-Identifier: GPL-3.0-or-later
"""Longest-edge bisection against brute-force geometry."""

import random

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.lattice import Lattice
from adaptive_terrain.cbt_terrain.leb import bisection
from adaptive_terrain.cbt_terrain.tree.concurrent_binary_tree import ConcurrentBinaryTree
from reference_bisection import (
    ReferenceMesh,
    assert_conforming,
    corners_of,
    edges_of,
    forced_split_leaves,
    leaves_of,
    to_tree_id,
)

GRIDS = [(1, 1), (2, 1), (1, 3), (3, 2), (5, 3)]
MAX_DEPTH = 8


def ids_of(lattice: Lattice, nodes) -> np.ndarray:
    return np.array([to_tree_id(lattice, node) for node in nodes], np.uint64)


def test_roots_and_their_halves():
    found = bisection.triangles(Lattice(1, 1, 0), np.arange(2, 6, dtype=np.uint64), 1)
    assert found[:2].tolist() == [[[0, 2], [0, 0], [2, 0]], [[2, 0], [2, 2], [0, 2]]]
    assert found[2:].tolist() == [[[0, 2], [1, 1], [0, 0]], [[0, 0], [1, 1], [2, 0]]]


@pytest.mark.parametrize("grid", GRIDS)
def test_triangles_equal_the_reference(grid):
    """Also deep ones: 2^24 units along a square, 48 bisections."""
    lattice, rng = Lattice(*grid, 0), random.Random(3)
    nodes = [(s, n) for s in range(lattice.squares) for n in range(2, 64)]
    nodes += [(rng.randrange(lattice.squares), rng.randrange(1 << d, 2 << d)) for d in range(6, 49) for _ in range(20)]
    expected = [corners_of(*node, lattice.columns, 24) for node in nodes]
    assert np.array_equal(bisection.triangles(lattice, ids_of(lattice, nodes), 24), expected)


def test_winding_alternates_with_depth():
    for depth in range(1, 12):
        ids = np.arange(1 << depth, 2 << depth, dtype=np.uint64)
        for left, apex, right in bisection.triangles(Lattice(1, 1, 0), ids, 6):
            (ux, uy), (vx, vy) = apex - left, right - left
            assert (ux * vy - uy * vx > 0) == (depth % 2 == 1)


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("depth", range(1, 7))
def test_neighbours_share_the_edge_that_they_are_named_for(grid, depth):
    lattice, over_edge = Lattice(*grid, 0), {}
    nodes = [(square, n) for square in range(lattice.squares) for n in range(1 << depth, 2 << depth)]
    corners = {node: corners_of(*node, lattice.columns, 3) for node in nodes}
    for node in nodes:
        for edge in edges_of(corners[node]):
            over_edge.setdefault(edge, set()).add(node)
    found = bisection.neighbours(lattice, ids_of(lattice, nodes)).tolist()
    for node, beside in zip(nodes, found, strict=True):
        left, apex, right = corners[node]
        others = [over_edge[frozenset(edge)] - {node} for edge in ((apex, right), (left, apex), (left, right))]
        assert max(map(len, others)) <= 1
        assert beside == [to_tree_id(lattice, min(other)) if other else 0 for other in others]


@pytest.mark.parametrize("threads", [3, pytest.param(1, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("grid", GRIDS)
def test_many_edits_at_once_equal_the_brute_force(grid, threads, eager_threads):
    """Splits force others in neighbours that other threads split; merges take whole diamonds or nothing."""
    lattice, rng = Lattice(*grid, 0), random.Random(threads)
    tree = ConcurrentBinaryTree(MAX_DEPTH + lattice.square_bits, threads)
    bisection.plant(tree, lattice)
    mesh, merged = ReferenceMesh(*grid, 4), 0
    for _ in range(14):
        candidates = sorted(node for node in mesh.leaves if node[1] < 1 << MAX_DEPTH)
        picked = rng.sample(candidates, min(len(candidates), rng.randrange(1, 12)))
        bisection.split_conforming(tree, lattice, ids_of(lattice, picked))
        for node in picked:
            if node in mesh.leaves:
                mesh.split(node)
        assert leaves_of(tree, lattice) == mesh.leaves
        parents = sorted({(square, heap_id >> 1) for square, heap_id in mesh.leaves if heap_id > 3})
        for node in rng.sample(parents, min(len(parents), 2)):
            [whole] = bisection.merge_conforming(tree, lattice, ids_of(lattice, [node]))
            assert whole == mesh.merge(*node)
            merged += whole
        assert leaves_of(tree, lattice) == mesh.leaves
    assert_conforming(mesh.leaves, *grid, 4)
    assert merged > 3


def test_all_diamonds_merge_at_once():
    lattice = Lattice(3, 2, 0)
    tree = ConcurrentBinaryTree(9, 2)
    bisection.plant(tree, lattice)
    planted = tree.to_bytes()
    roots = tree.leaves()[: 2 * lattice.squares]
    bisection.split_conforming(tree, lattice, roots)
    assert tree.leaf_count == 4 * lattice.squares + 2
    assert bisection.merge_conforming(tree, lattice, roots).all()
    assert tree.to_bytes() == planted


def test_a_tree_without_room_for_the_squares_is_refused():
    with pytest.raises(TerrainError, match="too shallow for 64 root squares"):
        bisection.plant(ConcurrentBinaryTree(6), Lattice(8, 8, 0))


@pytest.mark.parametrize("grid", GRIDS)
def test_plant_makes_two_roots_a_square(grid):
    lattice = Lattice(*grid, 0)
    tree = ConcurrentBinaryTree(12)
    bisection.plant(tree, lattice)
    assert leaves_of(tree, lattice) == {(s, n) for s in range(lattice.squares) for n in (2, 3)}
    assert tree.leaf_count == 2 * lattice.squares + (1 << lattice.square_bits) - lattice.squares


@pytest.mark.parametrize("grid", GRIDS)
def test_the_forced_split_reference_conforms_and_splits_enough(grid):
    columns, rows = grid
    side = 1 << 4

    def wants_split(x, y, depth):
        near = max(abs(x - 0.3 * columns * side), abs(y - 0.6 * rows * side)) / side
        return near * 2 ** (depth / 2) < 1.5 or (x * 7 + y * 13 + depth) % 11 == 0

    leaves = forced_split_leaves(columns, rows, MAX_DEPTH, wants_split)
    assert_conforming(leaves, columns, rows, 4)
    for square, heap_id in leaves:
        depth = heap_id.bit_length() - 1
        left, _, right = corners_of(square, heap_id, columns, 4)
        if depth < MAX_DEPTH:
            assert not wants_split((left[0] + right[0]) // 2, (left[1] + right[1]) // 2, depth)


def test_conformity_check_finds_a_t_junction():
    leaves = {(0, 4), (0, 5), (0, 3)}
    with pytest.raises(AssertionError, match="belongs to 1 triangles"):
        assert_conforming(leaves, 1, 1, 2)
