# SPDX-License-Identifier: GPL-3.0-or-later
"""Longest-edge bisection in kernels against the tests' own in Python, and conforming edits against brute force."""

import random

import bisection as reference
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.lattice import Lattice
from adaptive_terrain.cbt_terrain.leb import bisection
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.tree.concurrent_binary_tree import ConcurrentBinaryTree
from reference_bisection import ReferenceMesh, assert_conforming

GRIDS = [(1, 1), (2, 1), (1, 3), (3, 2), (5, 3)]
MAX_DEPTH = 8


def ids_of(lattice: Lattice, nodes) -> np.ndarray:
    return np.array([reference.to_tree_id(lattice, node) for node in nodes], np.uint64)


def leaves_of(tree: ConcurrentBinaryTree, lattice: Lattice) -> set[tuple[int, int]]:
    nodes = {reference.from_tree_id(lattice, int(leaf)) for leaf in tree.leaves()}
    return {node for node in nodes if node[0] < lattice.squares}


@pytest.mark.parametrize("grid", GRIDS)
def test_triangles_and_neighbours_equal_the_reference(grid):
    lattice, rng = Lattice(*grid, 0), random.Random(3)
    nodes = [(s, n) for s in range(lattice.squares) for n in range(2, 64)]
    nodes += [(rng.randrange(lattice.squares), rng.randrange(1 << d, 2 << d)) for d in range(6, 37) for _ in range(20)]
    corners = bisection.triangles(lattice, ids_of(lattice, nodes), 20)
    found = bisection.neighbours(lattice, ids_of(lattice, nodes))
    for (square, heap_id), triangle, beside in zip(nodes, corners, found, strict=True):
        corner = np.array([square % lattice.columns, square // lattice.columns]) << 20
        assert (triangle == reference.triangle(heap_id, 20) + corner).all()
        expected = reference.neighbours(lattice, (square, heap_id))
        assert beside.tolist() == [node and reference.to_tree_id(lattice, node) or 0 for node in expected]


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("grid", GRIDS)
def test_many_edits_at_once_equal_the_brute_force(grid, threads, monkeypatch):
    """Splits force others in neighbours that other threads split; merges take whole diamonds or nothing."""
    monkeypatch.setattr(launch, "SLICE_ITEMS", 2)
    lattice, rng = Lattice(*grid, 0), random.Random(threads)
    tree = ConcurrentBinaryTree(MAX_DEPTH + lattice.square_bits, threads)
    bisection.plant(tree, lattice)
    mesh, merged = ReferenceMesh(*grid, 4), 0
    for _ in range(25):
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
