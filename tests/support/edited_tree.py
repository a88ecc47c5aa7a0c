# SPDX-License-Identifier: GPL-3.0-or-later
"""A tree with checked access to single leaves, for the older tests."""

import numpy as np
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.tree.concurrent_binary_tree import ConcurrentBinaryTree


class EditedTree(ConcurrentBinaryTree):
    """A tree that begins as its root."""

    @classmethod
    def of(cls, tree: ConcurrentBinaryTree) -> "EditedTree":
        """Return an editable view that shares the memory of a tree."""
        edited = cls.__new__(cls)
        edited.__dict__ = tree.__dict__
        return edited

    def put(self, cells: np.ndarray) -> bool:
        """Replace the leaves by those that begin at `cells`, ascending; returns whether they are others."""
        sizes = np.diff(np.asarray(cells, np.int64), append=self.cell_count)
        return self.set_depths(self.max_depth - np.searchsorted(1 << np.arange(self.max_depth + 1), sizes))

    def decode(self, leaf):
        """Heap id of leaf number `leaf`, or those of several."""
        return super().decode(leaf) if np.ndim(leaf) else int(super().decode([leaf])[0])

    def leaf_at(self, cell: int) -> int:
        """Heap id of the leaf that covers `cell`."""
        return int(self.find([cell])[1][0])

    def encode(self, heap_id: int) -> int:
        """Number of the leaf `heap_id`; -1 if it is none."""
        return int(self.find(self.cells_of(np.array([heap_id], np.uint64)))[0][0]) if self.is_leaf(heap_id) else -1

    def is_leaf(self, heap_id):
        found = super().is_leaf(np.atleast_1d(heap_id))
        return found if np.ndim(heap_id) else bool(found[0])

    def split(self, heap_id: int) -> None:
        """Give the leaf `heap_id` its two children."""
        if heap_id >= self.cell_count or not self.is_leaf(heap_id):
            raise TerrainError(f"Node {heap_id} is at the deepest level or is not a leaf of the tree.")
        super().split([heap_id])

    def merge(self, heap_id: int) -> None:
        """Take the two children of `heap_id` away, which must be leaves: undoes `split`."""
        if not self.is_leaf(np.array([2 * heap_id, 2 * heap_id + 1])).all():
            raise TerrainError(f"Node {heap_id} has not two leaves as children.")
        super().merge([heap_id])
