# SPDX-License-Identifier: GPL-3.0-or-later
"""Any sequence of edits of the tree against a plain set of leaves."""

import bisect

import numpy as np
from adaptive_terrain.cbt_terrain.tree.concurrent_tree import ConcurrentBinaryTree
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule


class TreeMachine(RuleBasedStateMachine):
    """The model: the set of leaves' heap ids, and their first cells in order."""

    @initialize(max_depth=st.sampled_from([6, 7, 11, 12, 13, 18, 25, 40]))
    def plant(self, max_depth):
        self.max_depth = max_depth
        self.tree = ConcurrentBinaryTree(max_depth)
        self.leaves = {1}

    def cell(self, heap_id):
        return (heap_id << self.max_depth + 1 - heap_id.bit_length()) - (1 << self.max_depth)

    def in_order(self):
        return sorted(self.leaves, key=self.cell)

    @rule(pick=st.integers(0, 10**6), deep=st.booleans())
    def split(self, pick, deep):
        heap_id = max(self.leaves) if deep else self.in_order()[pick % len(self.leaves)]
        if heap_id >> self.max_depth:
            return
        self.tree.split(heap_id)
        self.leaves.remove(heap_id)
        self.leaves |= {2 * heap_id, 2 * heap_id + 1}

    @rule(pick=st.integers(0, 10**6))
    def merge(self, pick):
        pairs = [n >> 1 for n in self.in_order() if n > 1 and not n & 1 and n + 1 in self.leaves]
        if not pairs:
            return
        heap_id = pairs[pick % len(pairs)]
        self.tree.merge(heap_id)
        self.leaves -= {2 * heap_id, 2 * heap_id + 1}
        self.leaves.add(heap_id)

    @rule(seed=st.integers(0, 2**32), count=st.integers(1, 150), cuts=st.integers(0, 3))
    def mark(self, seed, count, cuts):
        rng = np.random.default_rng(seed)
        leaves = {1}
        while len(leaves) < count:
            above = sorted(n for n in leaves if n >> self.max_depth == 0)
            if not above:
                break
            heap_id = above[-1] if rng.random() < 0.3 else above[rng.integers(len(above))]
            leaves.remove(heap_id)
            leaves |= {2 * heap_id, 2 * heap_id + 1}
        before = set(self.tree.cells().tolist())
        self.leaves = leaves
        cells = np.array([self.cell(n) for n in self.in_order()], np.int64)
        places = np.sort(rng.integers(0, len(cells) + 1, cuts))
        changed = self.tree.mark_slices(np.split(cells, places))
        assert changed == len(before ^ set(cells.tolist()))

    @rule(depth=st.integers(0, 8))
    def reset(self, depth):
        depth = min(depth, self.max_depth)
        self.tree.reset(depth)
        self.leaves = set(range(1 << depth, 2 << depth))

    @rule()
    def bytes_out_and_in(self):
        data = self.tree.to_bytes()
        self.tree = ConcurrentBinaryTree.from_bytes(data)
        assert self.tree.to_bytes() == data

    @rule(cell=st.integers(0, 2**40 - 1))
    def query(self, cell):
        cell %= 1 << self.max_depth
        in_order = self.in_order()
        cells = [self.cell(n) for n in in_order]
        covering = bisect.bisect_right(cells, cell) - 1
        assert self.tree.leaf_at(cell) == in_order[covering]
        assert self.tree.rank(cell) == bisect.bisect_left(cells, cell)
        assert self.tree.decode(covering) == in_order[covering] and self.tree.encode(in_order[covering]) == covering
        assert self.tree.is_leaf(in_order[covering]) and self.tree.cell_of_leaf(covering) == cells[covering]
        assert in_order[covering] == 1 or not self.tree.is_leaf(in_order[covering] >> 1)

    @invariant()
    def the_leaves_are_those_of_the_model(self):
        if not hasattr(self, "tree"):
            return
        assert self.tree.leaf_count == len(self.leaves)
        assert [self.tree.decode(k) for k in range(0, len(self.leaves), 7)] == self.in_order()[::7]

    def teardown(self):
        if hasattr(self, "tree"):
            assert self.tree.leaves().tolist() == self.in_order()


TreeMachine.TestCase.settings = settings(stateful_step_count=30)
TestTree = TreeMachine.TestCase
