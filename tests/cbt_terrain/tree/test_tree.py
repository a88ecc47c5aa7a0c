# SPDX-License-Identifier: GPL-3.0-or-later
"""The concurrent binary tree against a plain set of leaves."""

import struct
import zlib

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.tree.concurrent_binary_tree import ConcurrentBinaryTree, depths_of
from edited_tree import EditedTree
from hypothesis import given, settings
from hypothesis import strategies as st


class ReferenceTree:
    """The leaves of a binary tree as a set of heap ids."""

    def __init__(self, max_depth):
        self.max_depth = max_depth
        self.leaves = {1}

    def cell(self, heap_id):
        shift = self.max_depth + 1 - heap_id.bit_length()
        return (heap_id << shift) - (1 << self.max_depth)

    def in_order(self):
        return sorted(self.leaves, key=self.cell)

    def split(self, heap_id):
        self.leaves.remove(heap_id)
        self.leaves |= {2 * heap_id, 2 * heap_id + 1}

    def can_merge(self, heap_id):
        return {2 * heap_id, 2 * heap_id + 1} <= self.leaves

    def merge(self, heap_id):
        self.leaves -= {2 * heap_id, 2 * heap_id + 1}
        self.leaves.add(heap_id)


def random_tree(rng, max_depth, leaves):
    """Return the leaves of a random tree, deep at one end of most branches."""
    reference = ReferenceTree(max_depth)
    while len(reference.leaves) < leaves:
        candidates = [n for n in reference.leaves if n >> max_depth == 0]
        if not candidates:
            break
        deep = max(candidates) if rng.random() < 0.3 else candidates[rng.integers(len(candidates))]
        reference.split(int(deep))
    return reference


def stream_of(reference):
    return np.array([reference.cell(n) for n in reference.in_order()], np.int64)


def assert_same(tree, reference):
    in_order = reference.in_order()
    assert tree.leaf_count == len(in_order)
    assert tree.leaves().tolist() == in_order
    # I4: the leaves partition the domain, in integers.
    assert sum(1 << tree.max_depth + 1 - n.bit_length() for n in in_order) == tree.cell_count


def test_a_new_tree_is_its_root():
    tree = EditedTree(20)
    assert (tree.leaf_count, tree.decode(0), tree.encode(1), tree.is_leaf(1)) == (1, 1, 0, True)
    assert not tree.is_leaf(2) and not tree.is_leaf(3)
    assert tree.leaf_at(0) == tree.leaf_at((1 << 20) - 1) == 1
    assert tree.cells().tolist() == [0]


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from([6, 7, 12, 13, 19, 26, 40, 43, 48, 54, 60, 62]),
    st.integers(0, 2**32),
    st.lists(st.booleans(), max_size=60),
)
def test_random_split_and_merge_equal_the_reference(max_depth, seed, splits):
    tree, reference = EditedTree(max_depth), ReferenceTree(max_depth)
    rng = np.random.default_rng(seed)
    for split in splits:
        leaves = reference.in_order()
        heap_id = leaves[rng.integers(len(leaves))] if rng.random() < 0.5 else max(leaves)
        if split and heap_id >> max_depth == 0:
            tree.split(heap_id)
            reference.split(heap_id)
        elif reference.can_merge(heap_id // 2):
            tree.merge(heap_id // 2)
            reference.merge(heap_id // 2)
        in_order = reference.in_order()
        assert [tree.decode(k) for k in range(len(in_order))] == in_order
    assert_same(tree, reference)
    in_order = reference.in_order()
    for rank, heap_id in enumerate(in_order):
        assert tree.encode(heap_id) == rank
        assert tree.is_leaf(heap_id)
        assert tree.cells()[rank] == reference.cell(heap_id)
        assert not (heap_id > 1 and tree.is_leaf(heap_id // 2))
        assert not (heap_id >> max_depth == 0 and tree.is_leaf(2 * heap_id))
    for cell in rng.integers(0, 1 << max_depth, 20):
        covering = tree.leaf_at(int(cell))
        first = reference.cell(covering)
        assert covering in reference.leaves
        assert first <= cell < first + (1 << max_depth + 1 - covering.bit_length())


@settings(max_examples=30, deadline=None)
@given(st.sampled_from([6, 11, 18, 25, 31]), st.integers(0, 2**32))
def test_mark_equals_a_rebuild_whatever_came_before(max_depth, seed):
    rng = np.random.default_rng(seed)
    tree = EditedTree(max_depth)
    for _ in range(4):
        reference = random_tree(rng, max_depth, int(rng.integers(1, 300)))
        before, after = set(tree.cells().tolist()), stream_of(reference)
        assert tree.put(after) == (before != set(after.tolist()))
        assert_same(tree, reference)
        if rng.random() < 0.5:
            heap_id = min(reference.leaves)
            if heap_id >> max_depth == 0:
                tree.split(heap_id)


def test_an_equal_stream_changes_nothing():
    tree = EditedTree(24)
    tree.reset(12)
    assert not tree.put(tree.cells().copy())
    assert tree.leaf_count == 4096


@pytest.mark.parametrize("max_depth", [6, 12, 18])
def test_reset_gives_every_node_of_a_depth(max_depth):
    tree = EditedTree(max_depth)
    for depth in (max_depth, 0, max_depth // 2):
        tree.reset(depth)
        assert tree.leaves().tolist() == list(range(1 << depth, 2 << depth))


@settings(max_examples=30, deadline=None)
@given(st.sampled_from([6, 12, 27, 40, 48, 61, 62]), st.integers(0, 2**32), st.integers(1, 200))
def test_bytes_round_trip(max_depth, seed, leaves):
    reference = random_tree(np.random.default_rng(seed), max_depth, leaves)
    tree = EditedTree(max_depth)
    tree.put(stream_of(reference))
    data = tree.to_bytes()
    assert len(data) == 20 + len(reference.leaves)
    assert tree.depths().tolist() == [n.bit_length() - 1 for n in reference.in_order()]
    again = EditedTree.from_bytes(data)
    assert again.max_depth == max_depth
    assert_same(again, reference)
    assert again.to_bytes() == data


def sealed(max_depth, depths, version=2):
    data = struct.pack("<4sHHQ", b"ACBT", version, max_depth, len(depths)) + bytes(depths)
    return data + struct.pack("<I", zlib.crc32(data))


def test_damaged_bytes_are_refused():
    tree = EditedTree(16)
    tree.reset(5)
    data = tree.to_bytes()
    for length in (0, 3, 19, len(data) - 1):
        with pytest.raises(TerrainError):
            EditedTree.from_bytes(data[:length])
    for at in range(len(data)):
        with pytest.raises(TerrainError):
            EditedTree.from_bytes(data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :])
    lying = struct.pack("<4sHHQ", b"ACBT", 2, 40, 10**15) + bytes(100)
    with pytest.raises(TerrainError, match="cut short or damaged"):
        EditedTree.from_bytes(lying + struct.pack("<I", zlib.crc32(lying)))


def test_bytes_that_are_no_tree_are_refused():
    assert EditedTree.from_bytes(sealed(8, [1, 1])).leaves().tolist() == [2, 3]
    gaps = ([], [1], [1, 1, 8], [1, 2], [2, 1, 2], [1, 2, 3, 8], [9] * 512, [255], [0, 0], [1] * 257)
    for depths in gaps:
        with pytest.raises(TerrainError, match="do not form a tree"):
            EditedTree.from_bytes(sealed(8, depths))
    for max_depth, version in ((5, 2), (63, 2), (8, 1)):
        with pytest.raises(TerrainError, match="has version"):
            EditedTree.from_bytes(sealed(max_depth, [0], version=version))


def test_what_is_no_tree_or_leaf_of_it_is_refused():
    tree = EditedTree(6)
    tree.reset(2)
    assert tree.cells().tolist() == [0, 16, 32, 48]
    for leaf in (-1, 4):
        with pytest.raises(TerrainError, match="expected 0 .. 3"):
            tree.decode([0, leaf])
    for max_depth in (5, 63, 20.0, "20"):
        with pytest.raises(TerrainError, match="expected a whole number, 6 .. 62"):
            EditedTree(max_depth)


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_edits_do_not_depend_on_threads_or_their_order(threads, eager_threads):
    """Thousands of splits of neighbours and merges of some, in a pool that has to grow meanwhile: the same leaves."""
    for seed in range(4):
        rng, expected, max_depth = np.random.default_rng(seed), np.ones(1, np.uint64), (26, 62)[seed % 2]
        tree = ConcurrentBinaryTree(max_depth, threads)
        for _ in range(12):
            split = rng.random(len(expected)) < 0.8
            tree.split(rng.permutation(expected[split]))
            merged = expected[split][rng.random(split.sum()) < 0.2]
            children = expected[split, None] * np.uint64(2) + np.array([0, 1], np.uint64)
            expected = np.concatenate([expected[~split], children.ravel()])
            expected = np.sort(expected << (max_depth - depths_of(expected)).astype(np.uint64))
            assert tree.leaf_count == len(expected)
            assert (tree.cells() + np.uint64(tree.cell_count) == expected).all()
            tree.merge(rng.permutation(np.repeat(merged, 2)))  # each twice, as the leaves of a diamond do
            assert tree.leaf_count == len(expected) - len(merged)
            expected = tree.leaves()
        copy = ConcurrentBinaryTree.from_bytes(tree.to_bytes())
        assert (copy.leaves() == expected).all()


def test_memory_is_reused_after_it_has_grown():
    """Leaves that move through a deep tree for hundreds of frames need no more memory than at first."""
    rng, tree, sizes = np.random.default_rng(4), ConcurrentBinaryTree(30), []
    for _ in range(200):
        reference = random_tree(rng, 30, 60)
        tree.set_depths(np.array([n.bit_length() - 1 for n in reference.in_order()]))
        sizes.append(tree.nbytes)
        assert_same(EditedTree.of(tree), reference)
    assert sizes[-1] == sizes[60] <= 2**19
