# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases of the tree and the bisection, by their numbers in tools/hard_cases_page.py."""

import random
import tracemalloc

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.lattice import Lattice
from adaptive_terrain.cbt_terrain.leb import bisection
from adaptive_terrain.cbt_terrain.tree.concurrent_binary_tree import ConcurrentBinaryTree
from edited_tree import EditedTree
from reference_bisection import ReferenceMesh, assert_conforming, corners_of, leaves_of, split_nodes, to_tree_id

SQUARE = Lattice(1, 1, 0)


def random_ids(depth, count, seed):
    rng = random.Random(seed)
    return [(1 << depth), (2 << depth) - 1] + [rng.randrange(1 << depth, 2 << depth) for _ in range(count)]


def planted(lattice, max_depth):
    tree = ConcurrentBinaryTree(max_depth)
    bisection.plant(tree, lattice)
    return tree


def ids_of(lattice, *nodes):
    return np.array([to_tree_id(lattice, node) for node in nodes], np.uint64)


def test_case_01_depth_48_is_exact_in_float32():
    """Vertices at depth 48 are those of their bisections and exact in float32; at depths 50 to 58, in float64."""
    for depth, dtype in ((48, np.float32), (50, np.float64), (55, np.float64), (58, np.float64)):
        exponent, ids = depth // 2, random_ids(depth, 500, seed=depth)
        whole = bisection.triangles(SQUARE, np.array(ids, np.uint64), exponent)
        assert np.array_equal(whole, [corners_of(0, heap_id, 1, exponent) for heap_id in ids])
        in_square = (whole / 2.0**exponent).astype(dtype)
        assert np.array_equal(in_square.astype(np.float64) * 2.0**exponent, whole)


@pytest.mark.parametrize("depth", [30, 31, 32, 52, 53, 54, 57, 58])
def test_case_02_deep_ids_lead_to_their_neighbours_and_back(depth):
    """Ids at depths 30 to 58 have distinct triangles, and their neighbours over each edge lead back to them."""
    ids = np.unique(np.array(random_ids(depth, 200, seed=depth), np.uint64))
    triangles = bisection.triangles(SQUARE, ids, 29)
    assert len(np.unique(triangles.reshape(len(ids), -1), axis=0)) == len(ids)
    lattice = Lattice(3, 2, 0)
    ids = ids_of(lattice, *((5, int(heap_id)) for heap_id in ids))
    for edge, back in ((0, 1), (1, 0), (2, 2)):
        found = bisection.neighbours(lattice, ids)[:, edge]
        assert (found > 0).sum() > 0.9 * len(ids)
        assert np.array_equal(bisection.neighbours(lattice, found[found > 0])[:, back], ids[found > 0])


@pytest.mark.parametrize("max_depth", [31, 32, 33, 40, 52, 53, 54, 60, 61, 62])
def test_case_02_ids_round_trip_through_the_tree(max_depth):
    """Leaves at depths 31 to 62 round-trip through their ranks as Python integers, also from saved bytes."""
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
    lattice, rng = Lattice(*grid, 0), random.Random(44)
    tree = planted(lattice, 30)

    def split_30():
        for _ in range(30):
            bisection.split_conforming(tree, lattice, ids_of(lattice, rng.choice(sorted(leaves_of(tree, lattice)))))

    split_30()
    before, leaves = tree.to_bytes(), leaves_of(tree, lattice)
    split_30()
    assert tree.to_bytes() != before
    for node in sorted(split_nodes(leaves_of(tree, lattice)) - split_nodes(leaves), key=lambda n: -n[1].bit_length()):
        bisection.merge_conforming(tree, lattice, ids_of(lattice, node))
    assert tree.to_bytes() == before


@pytest.mark.parametrize("grid", [(1, 1), (3, 2)])
def test_case_45_a_diamond_merges_whole_or_not_at_all(grid):
    """A random merge takes all halves of a diamond or none, and every state is conforming."""
    lattice, rng = Lattice(*grid, 0), random.Random(45)
    tree, mesh = planted(lattice, 12), ReferenceMesh(*grid, 5)
    for _ in range(60):
        picked = rng.choice(sorted(leaf for leaf in mesh.leaves if leaf[1].bit_length() < 9))
        bisection.split_conforming(tree, lattice, ids_of(lattice, picked))
        mesh.split(picked)
    outcomes = []
    while halved := sorted(leaf for leaf in mesh.leaves if leaf[1] > 3):
        square, heap_id = rng.choice(halved)
        before = mesh.leaves
        outcomes.append(mesh.merge(square, heap_id // 2))
        assert bisection.merge_conforming(tree, lattice, ids_of(lattice, (square, heap_id // 2))) == outcomes[-1:]
        assert leaves_of(tree, lattice) == mesh.leaves
        assert len(before) - len(mesh.leaves) in ((1, 2) if outcomes[-1] else (0,))
        assert_conforming(mesh.leaves, *grid, 5)
    assert outcomes.count(True) > 10 and outcomes.count(False) > 10
