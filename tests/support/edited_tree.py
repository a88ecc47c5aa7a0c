# SPDX-License-Identifier: GPL-3.0-or-later
"""A tree whose leaves are asked for by heap id and edited one by one: what tests do with a tree, and no frame does.

Id 1 is the root, id n has the children 2n and 2n + 1. Each edit writes all cells anew.
"""

import numpy as np
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.tree.concurrent_tree import ConcurrentBinaryTree
from adaptive_terrain.cbt_terrain.tree.saved import depths_from_bytes


class EditedTree(ConcurrentBinaryTree):
    """A tree that begins as its root. `cells` are views of an array that edits write: copy what is to last."""

    @classmethod
    def of(cls, tree: ConcurrentBinaryTree) -> "EditedTree":
        """The same tree: what is edited here is edited there."""
        edited = cls.__new__(cls)
        edited.__dict__ = tree.__dict__
        return edited

    @classmethod
    def from_bytes(cls, data: bytes) -> "EditedTree":
        """The tree that `to_bytes` wrote."""
        max_depth, depths = depths_from_bytes(data)
        tree = cls(max_depth)
        sizes = np.int64(1) << max_depth - depths.astype(np.int64)
        tree.put(np.cumsum(sizes) - sizes)
        return tree

    def put(self, cells: np.ndarray) -> bool:
        """Replace the leaves by those that begin at `cells`, int64, ascending; returns whether they are others."""
        cells = np.asarray(cells, np.int64)
        self.next_cells(len(cells)).numpy()[: len(cells)] = cells
        changed = self.would_change([(0, len(cells))])
        self.mark([(0, len(cells))])
        return changed

    def reset(self, depth: int = 0) -> None:
        """Make the leaves all the nodes at `depth`."""
        self.put(np.arange(1 << depth, dtype=np.int64) << (self.max_depth - depth))

    def leaves(self) -> np.ndarray:
        """Heap ids of all leaves in order: uint64."""
        return (self.cells() + self.cell_count >> self.max_depth - self.depths().astype(np.int64)).astype(np.uint64)

    def decode(self, leaf: int) -> int:
        """Heap id of leaf number `leaf`."""
        first = self.cell_of_leaf(leaf)
        return (self.cell_count + first) // (self.cell_of_leaf(leaf + 1) - first)

    def leaf_at(self, cell: int) -> int:
        """Heap id of the leaf that covers `cell`."""
        return self.decode(int(np.searchsorted(self.cells(), cell, side="right")) - 1)

    def encode(self, heap_id: int) -> int:
        """Number of the leaf `heap_id`; -1 if it is none."""
        first = (heap_id << self.max_depth + 1 - heap_id.bit_length()) - self.cell_count
        leaf = int(np.searchsorted(self.cells(), first))
        return leaf if leaf < self.leaf_count and self.decode(leaf) == heap_id else -1

    def is_leaf(self, heap_id: int) -> bool:
        return self.encode(heap_id) >= 0

    def split(self, heap_id: int) -> None:
        """Give the leaf `heap_id` its two children."""
        if heap_id >= self.cell_count or not self.is_leaf(heap_id):
            raise TerrainError(f"Node {heap_id} is at the deepest level or is not a leaf of the tree.")
        self.put(np.union1d(self.cells(), [self._second_cell(heap_id)]))

    def merge(self, heap_id: int) -> None:
        """Take the two children of `heap_id` away, which must be leaves: undoes `split`."""
        if not (self.is_leaf(2 * heap_id) and self.is_leaf(2 * heap_id + 1)):
            raise TerrainError(f"Node {heap_id} has not two leaves as children.")
        self.put(np.setdiff1d(self.cells(), [self._second_cell(heap_id)]))

    def _second_cell(self, heap_id: int) -> int:
        """First cell of the second child."""
        return (2 * heap_id + 1 << self.max_depth - heap_id.bit_length()) - self.cell_count
