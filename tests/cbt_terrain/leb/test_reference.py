# SPDX-License-Identifier: GPL-3.0-or-later
"""Longest-edge bisection against brute-force geometry."""

import random

import bisection
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.lattice import Lattice
from edited_tree import EditedTree
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_bisection import ReferenceMesh, assert_conforming, corners_of, edges_of, forced_split_leaves

GRIDS = [(1, 1), (2, 1), (1, 3), (3, 2), (5, 3)]


def leaves_of(tree, lattice):
    """Return the grid's leaves as (square, id), without the unused numbers after the last square."""
    nodes = [bisection.from_tree_id(lattice, int(n)) for n in tree.leaves()]
    return {node for node in nodes if node[0] < lattice.squares}


def test_roots_are_as_the_contract_says():
    assert bisection.triangle(2, 0) == ((0, 1), (0, 0), (1, 0))
    assert bisection.triangle(3, 0) == ((1, 0), (1, 1), (0, 1))
    assert bisection.triangle(4, 1) == ((0, 2), (1, 1), (0, 0))
    assert bisection.triangle(5, 1) == ((0, 0), (1, 1), (2, 0))


@pytest.mark.parametrize("depth", range(1, 9))
def test_triangles_equal_the_reference(depth):
    ids = np.arange(1 << depth, 2 << depth, dtype=np.uint64)
    expected = [corners_of(0, int(i), 1, 4) for i in ids]
    assert [bisection.triangle(int(i), 4) for i in ids] == expected
    assert np.array_equal(bisection.triangles(ids, 4), expected)


def test_triangles_of_mixed_depths_equal_those_of_single_ids():
    rng = random.Random(1)
    ids = [rng.randrange(1 << d, 2 << d) for d in range(1, 63) for _ in range(5)]
    rng.shuffle(ids)
    expected = [bisection.triangle(i, 31) for i in ids]
    assert np.array_equal(bisection.triangles(np.array(ids, np.uint64), 31), expected)


@given(st.integers(1, 62).flatmap(lambda d: st.integers(1 << d, (2 << d) - 1)))
def test_id_to_triangle_to_id(heap_id):
    assert bisection.heap_id_of(bisection.triangle(heap_id, 31), 31) == heap_id


def test_winding_alternates_with_depth():
    for depth in range(1, 12):
        for left, apex, right in bisection.triangles(np.arange(1 << depth, 2 << depth, dtype=np.uint64), 6):
            (ux, uy), (vx, vy) = apex - left, right - left
            assert (ux * vy - uy * vx > 0) == (depth % 2 == 1)


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("depth", range(1, 7))
def test_neighbours_share_the_edge_that_they_are_named_for(grid, depth):
    columns, rows = grid
    lattice = Lattice(columns, rows, 0)
    exponent = 3
    over_edge = {}
    corners = {}
    for square in range(columns * rows):
        for heap_id in range(1 << depth, 2 << depth):
            corners[square, heap_id] = corners_of(square, heap_id, columns, exponent)
            for edge in edges_of(corners[square, heap_id]):
                over_edge.setdefault(edge, set()).add((square, heap_id))
    for node, (left, apex, right) in corners.items():
        expected = []
        for edge in (frozenset((apex, right)), frozenset((left, apex)), frozenset((left, right))):
            expected.append(next(iter(over_edge[edge] - {node}), None))
        assert list(bisection.neighbours(lattice, node)) == expected
        assert bisection.diamond(lattice, node) == (node, expected[2])


@pytest.mark.parametrize("grid", GRIDS)
def test_neighbours_are_mutual_at_great_depth(grid):
    lattice = Lattice(*grid, 0)
    rng = random.Random(2)
    for _ in range(200):
        depth = rng.randrange(30, 63)
        node = rng.randrange(lattice.squares), rng.randrange(1 << depth, 2 << depth)
        left, right, edge = bisection.neighbours(lattice, node)
        assert edge is None or bisection.neighbours(lattice, edge)[2] == node
        assert left is None or bisection.neighbours(lattice, left)[1] == node
        assert right is None or bisection.neighbours(lattice, right)[0] == node


def test_children_meet_their_parent():
    assert bisection.children(5) == (10, 11)
    assert bisection.parent(10) == bisection.parent(11) == 5
    assert [bisection.depth_of(n) for n in (1, 2, 3, 4, 1 << 62)] == [0, 1, 1, 2, 62]


@given(st.sampled_from(GRIDS), st.data())
def test_tree_ids_round_trip(grid, data):
    lattice = Lattice(*grid, 0)
    depth = data.draw(st.integers(0, 50))
    node = data.draw(st.integers(0, lattice.squares - 1)), data.draw(st.integers(1 << depth, (2 << depth) - 1))
    tree_id = bisection.to_tree_id(lattice, node)
    assert tree_id.bit_length() - 1 == lattice.square_bits + depth
    assert bisection.from_tree_id(lattice, tree_id) == node


@pytest.mark.parametrize("grid", GRIDS)
def test_plant_makes_two_roots_a_square(grid):
    lattice = Lattice(*grid, 0)
    tree = EditedTree(12)
    bisection.plant(tree, lattice)
    assert leaves_of(tree, lattice) == {(s, n) for s in range(lattice.squares) for n in (2, 3)}
    assert tree.leaf_count == 2 * lattice.squares + (1 << lattice.square_bits) - lattice.squares


@settings(max_examples=25, deadline=None)
@given(st.sampled_from(GRIDS), st.integers(0, 2**32))
def test_conforming_edits_equal_the_brute_force(grid, seed):
    columns, rows = grid
    lattice = Lattice(columns, rows, 0)
    max_depth = 8
    tree = EditedTree(max_depth + lattice.square_bits)
    bisection.plant(tree, lattice)
    mesh = ReferenceMesh(columns, rows, 4)
    rng = random.Random(seed)
    for _ in range(40):
        square, heap_id = rng.choice(sorted(mesh.leaves))
        if rng.random() < 0.7:
            if heap_id.bit_length() - 1 < max_depth:
                done = bisection.split_conforming(tree, lattice, (square, heap_id))
                assert (square, heap_id) in done
                mesh.split((square, heap_id))
        elif heap_id > 3:
            merged = bisection.merge_conforming(tree, lattice, (square, heap_id // 2))
            assert bool(merged) == mesh.merge(square, heap_id // 2)
        assert leaves_of(tree, lattice) == mesh.leaves
    assert_conforming(mesh.leaves, columns, rows, 4)


def test_merge_undoes_split():
    lattice = Lattice(3, 2, 0)
    tree = EditedTree(14)
    bisection.plant(tree, lattice)
    before = tree.to_bytes()
    done = bisection.split_conforming(tree, lattice, (1, 2))
    for _ in range(4):
        deepest = max(leaves_of(tree, lattice), key=lambda node: (node[1].bit_length(), node))
        done += bisection.split_conforming(tree, lattice, deepest)
    for node in reversed(done):
        bisection.merge_conforming(tree, lattice, node)
    assert tree.to_bytes() == before


@pytest.mark.parametrize("grid", GRIDS)
def test_the_forced_split_reference_conforms_and_splits_enough(grid):
    columns, rows = grid
    max_depth, exponent = 8, 4
    side = 1 << exponent

    def wants_split(x, y, depth):
        near = max(abs(x - 0.3 * columns * side), abs(y - 0.6 * rows * side)) / side
        return near * 2 ** (depth / 2) < 1.5 or (x * 7 + y * 13 + depth) % 11 == 0

    leaves = forced_split_leaves(columns, rows, max_depth, wants_split)
    assert_conforming(leaves, columns, rows, exponent)
    for square, heap_id in leaves:
        depth = heap_id.bit_length() - 1
        left, _, right = corners_of(square, heap_id, columns, exponent)
        if depth < max_depth:
            assert not wants_split((left[0] + right[0]) // 2, (left[1] + right[1]) // 2, depth)


def test_conformity_check_finds_a_t_junction():
    leaves = {(0, 4), (0, 5), (0, 3)}
    with pytest.raises(AssertionError, match="belongs to 1 triangles"):
        assert_conforming(leaves, 1, 1, 2)


def test_bad_nodes_are_refused():
    lattice = Lattice(2, 2, 0)
    tree = EditedTree(6)
    bisection.plant(tree, lattice)
    with pytest.raises(TerrainError, match="not a leaf"):
        bisection.split_conforming(tree, lattice, (0, 4))
    with pytest.raises(TerrainError, match="not a leaf"):
        bisection.split_conforming(tree, lattice, (4, 2))
    with pytest.raises(TerrainError, match="expected an exponent of 3"):
        bisection.triangle(64, 2)
    with pytest.raises(TerrainError, match="depth 0"):
        bisection.triangle(1, 2)
    with pytest.raises(TerrainError, match="too shallow"):
        bisection.plant(tree, Lattice(8, 8, 0))
    node = (0, 2)
    while tree.is_leaf(bisection.to_tree_id(lattice, node)):
        if bisection.to_tree_id(lattice, node) >= 64:
            break
        bisection.split_conforming(tree, lattice, node)
        node = (0, 2 * node[1])
    with pytest.raises(TerrainError, match="deepest level, 6"):
        bisection.split_conforming(tree, lattice, node)
