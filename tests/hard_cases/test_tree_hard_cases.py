# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases of the tree and the bisection, by their numbers in tools/hard_cases_page.py."""

import random
import tracemalloc

import bisection
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.lattice import Lattice
from edited_tree import EditedTree
from reference_bisection import assert_conforming


def random_ids(depth, count, seed):
    rng = random.Random(seed)
    return [(1 << depth), (2 << depth) - 1] + [rng.randrange(1 << depth, 2 << depth) for _ in range(count)]


def leaves_of(tree, lattice):
    nodes = [bisection.from_tree_id(lattice, int(n)) for n in tree.leaves()]
    return {node for node in nodes if node[0] < lattice.squares}


def test_case_01_depth_48_is_exact_in_float32():
    """Vertices at depth 48 are exact in float32; deeper ones are refused in float32 and exact in float64."""
    ids = random_ids(48, 2000, seed=1)
    exact = np.array([bisection.triangle(n, 24) for n in ids])
    plane = bisection.plane_coordinates(np.array(ids, np.uint64))
    assert plane.dtype == np.float32
    assert np.array_equal(plane.astype(np.float64) * 2.0**24, exact)
    for depth in (50, 55, 62):
        deep = random_ids(depth, 2000, seed=depth)
        with pytest.raises(TerrainError, match="ask for float64"):
            bisection.plane_coordinates(np.array(deep, np.uint64))
        plane = bisection.plane_coordinates(np.array(deep, np.uint64), np.float64)
        exact = [bisection.triangle(n, 31) for n in deep]
        assert [[[int(c * 2**31) for c in corner] for corner in t] for t in plane.tolist()] == np.array(exact).tolist()


@pytest.mark.parametrize("depth", [30, 31, 32, 52, 53, 54, 61, 62])
def test_case_02_ids_round_trip_through_triangles(depth):
    """Ids at depths 30 to 62 round-trip through their triangles and tree ids."""
    lattice = Lattice(3, 2, 0)
    for heap_id in random_ids(depth, 200, seed=depth):
        assert bisection.heap_id_of(bisection.triangle(heap_id, 31), 31) == heap_id
        assert bisection.heap_id_of(tuple(map(tuple, bisection.triangles([heap_id], 31)[0].tolist())), 31) == heap_id
        tree_id = bisection.to_tree_id(lattice, (5, heap_id))
        assert bisection.from_tree_id(lattice, tree_id) == (5, heap_id)


@pytest.mark.parametrize("max_depth", [31, 32, 33, 40])
def test_case_02_ids_round_trip_through_the_tree(max_depth):
    """Leaves at depths 31 to 40 round-trip through their ranks as Python integers, also from saved bytes."""
    tree = EditedTree(max_depth)
    rng = random.Random(max_depth)
    targets = [1 << max_depth, (2 << max_depth) - 1, *(rng.randrange(1 << max_depth, 2 << max_depth) for _ in range(3))]
    for target in targets:
        while (leaf := tree.leaf_at(target - tree.cell_count)) != target:
            tree.split(leaf)
        assert tree.decode(tree.encode(target)) == target
        assert type(tree.decode(tree.encode(target))) is int
    leaves = tree.leaves().tolist()
    assert [tree.encode(n) for n in leaves] == list(range(tree.leaf_count))
    assert EditedTree.from_bytes(tree.to_bytes()).leaves().tolist() == leaves


def random_leaves(max_depth, count, seed):
    """Return the first cells of at least `count` leaves of a random tree, int64."""
    rng = np.random.default_rng(seed)
    cells, sizes = np.zeros(1, np.int64), np.array([1 << max_depth])
    while len(cells) < count:
        split = (rng.random(len(cells)) < 0.5) & (sizes > 1)
        sizes = np.where(split, sizes >> 1, sizes)
        cells = np.concatenate([cells, (cells + sizes)[split]])
        sizes = np.concatenate([sizes, sizes[split]])
    return np.sort(cells)


@pytest.mark.parametrize("max_depth", [28, 32, 36])
def test_case_03_memory_follows_the_leaves(max_depth):
    """100,000 leaves in trees of 2^28 to 2^36 cells need at most 64 bytes per leaf."""
    cells = random_leaves(max_depth, 100_000, seed=max_depth)
    depths = max_depth - np.log2(np.diff(cells, append=1 << max_depth)).astype(np.uint16)
    tracemalloc.start()
    tree = EditedTree(max_depth)
    empty = tree.nbytes
    for _ in range(5):
        tree.set_depths(depths)
        tree.reset()
    tree.set_depths(depths)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert tree.leaf_count >= 100_000
    assert empty < 4096
    assert tree.nbytes < 64 * len(cells)
    # a growing pool holds the old one and the new one
    assert peak < 1.5 * tree.nbytes + 2**17


def test_case_03_one_deep_branch_costs_kilobytes():
    """One branch down to depth 40 with 41 leaves adds at most 640 bytes."""
    tree = EditedTree(40)
    before = len(tree.to_bytes())
    while (leaf := tree.leaf_at(0x5A5A5A5A5A)) < tree.cell_count:
        tree.split(leaf)
    assert tree.leaf_count == 41
    assert len(tree.to_bytes()) - before <= 16 * 40


@pytest.mark.parametrize("grid", [(1, 1), (3, 2)])
def test_case_44_split_then_merge_gives_the_bits_back(grid):
    """30 random conforming splits, merged in reverse, restore the tree's bytes."""
    lattice = Lattice(*grid, 0)
    tree = EditedTree(30)
    bisection.plant(tree, lattice)
    rng = random.Random(44)
    for _ in range(30):
        bisection.split_conforming(tree, lattice, rng.choice(sorted(leaves_of(tree, lattice))))
    before = tree.to_bytes()
    done = []
    for _ in range(30):
        done += bisection.split_conforming(tree, lattice, rng.choice(sorted(leaves_of(tree, lattice))))
    assert tree.to_bytes() != before
    for node in reversed(done):
        bisection.merge_conforming(tree, lattice, node)
    assert tree.to_bytes() == before


@pytest.mark.parametrize("grid", [(1, 1), (3, 2)])
def test_case_45_a_diamond_merges_whole_or_not_at_all(grid):
    """A random merge takes all halves of a diamond or none, and every state is conforming."""
    lattice = Lattice(*grid, 0)
    tree = EditedTree(12)
    bisection.plant(tree, lattice)
    rng = random.Random(45)
    whole = refused = 0
    for _ in range(60):
        bisection.split_conforming(
            tree, lattice, rng.choice(sorted(n for n in leaves_of(tree, lattice) if n[1].bit_length() < 9))
        )
    leaves = leaves_of(tree, lattice)
    while halved := sorted(n for n in leaves if n[1] > 3):
        square, heap_id = rng.choice(halved)
        node = square, heap_id // 2
        halves = [h for h in bisection.diamond(lattice, node) if h is not None]
        quarters = {(s, child) for s, n in halves for child in bisection.children(n)}
        merged = bisection.merge_conforming(tree, lattice, node)
        if merged:
            assert set(merged) == set(halves)
            assert leaves_of(tree, lattice) == leaves - quarters | set(halves)
            whole += 1
        else:
            assert not quarters <= leaves
            assert leaves_of(tree, lattice) == leaves
            refused += 1
        leaves = leaves_of(tree, lattice)
        assert_conforming(leaves, *grid, 5)
    assert whole > 10 and refused > 10
