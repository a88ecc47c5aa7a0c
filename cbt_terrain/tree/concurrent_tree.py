# SPDX-License-Identifier: GPL-3.0-or-later
"""The concurrent binary tree (Dupuy 2020), kept as the set of its leaves.

A leaf stands for its first deepest node, its *cell*. The reference sets a bit for each, and finds leaf k by a sum
reduction above the bits. Here a walk writes the leaves in the order of the curve, so that the cells whose bits are set
lie in a row, 8 bytes a leaf however deep the tree is: leaf k is entry k, and nothing need be summed.

The tree knows nothing of triangles and cameras.
"""

import numpy as np
import warp as wp

from ..errors import TerrainError
from ..run.buffers import Buffers
from .saved import MAX_DEPTH, MIN_DEPTH, depths_to_bytes


class ConcurrentBinaryTree:
    """A binary tree of at most `max_depth` (6 .. 40) levels below its root.

    Leaves are numbered 0 .. leaf_count - 1 in the order of their cells, which is the order of a depth-first walk. Their
    cells lie where the threads of a walk have written them: in parts, (first entry, cells) each, that ascend.
    """

    def __init__(self, max_depth: int):
        if not (isinstance(max_depth, int) and MIN_DEPTH <= max_depth <= MAX_DEPTH):
            raise TerrainError(
                f"The tree's depth is {max_depth!r}; expected a whole number, {MIN_DEPTH} .. {MAX_DEPTH}."
            )
        self.max_depth = max_depth
        self.cell_count = 1 << max_depth
        self._now, self._next = Buffers(), Buffers()
        self._parts: list[tuple[int, int]] = []
        self.last_cells()
        self.next_cells(1).numpy()[0] = 0
        self.mark([(0, 1)])

    @property
    def leaf_count(self) -> int:
        """Leaves of the tree, at least 1."""
        return sum(int(count) for _, count in self._parts)

    @property
    def nbytes(self) -> int:
        """Address space of all arrays; the system commits what is touched of it."""
        return self._now.nbytes + self._next.nbytes

    def cell_of_leaf(self, leaf: int) -> int:
        """First cell of leaf number `leaf`; of `leaf_count`, the end of the curve, 2**max_depth."""
        if leaf == self.leaf_count:
            return self.cell_count
        if not 0 <= leaf < self.leaf_count:
            raise TerrainError(f"Leaf {leaf} does not exist; expected 0 .. {self.leaf_count - 1}.")
        ends = np.cumsum([count for _, count in self._parts])
        part = int(np.searchsorted(ends, leaf, side="right"))
        first, count = self._parts[part]
        return int(self._now.numpy("cells")[first + count - (int(ends[part]) - leaf)])

    def next_cells(self, room: int) -> wp.array:
        """Memory for the next leaves' cells, int64, at least [room]: to be written, then marked. What is written and
        not marked changes nothing."""
        return self._next.get("cells", room, wp.int64)

    def last_cells(self) -> wp.array:
        """Memory of the cells that hold, int64: the same object until `mark`."""
        return self._now.get("cells", 1, wp.int64)

    def mark(self, parts: list[tuple[int, int]]) -> None:
        """Make the cells in these parts of `next_cells` the tree's leaves: first entry and number of cells of each,
        ascending, as the cells in them are."""
        parts = [(int(first), int(count)) for first, count in parts if count]
        self._now, self._next, self._parts = self._next, self._now, parts

    def would_change(self, parts: list[tuple[int, int]]) -> bool:
        """Whether `mark` with these parts would make another tree of this one."""
        cells = self._next.numpy("cells")
        if sum(int(count) for _, count in parts) != self.leaf_count:
            return True
        return not np.array_equal(_joined(cells, parts), self.cells())

    def cells(self) -> np.ndarray:
        """The first cell of each leaf in order, int64 [leaf_count]: if they lie in one part a view of the tree's own
        array, valid until the next frame."""
        return _joined(self._now.numpy("cells"), self._parts)

    def depths(self) -> np.ndarray:
        """Depth of each leaf in order: uint8 [leaf_count]."""
        sizes = np.diff(self.cells(), append=self.cell_count)
        return (self.max_depth - np.searchsorted(1 << np.arange(self.max_depth + 1), sizes)).astype(np.uint8)

    def to_bytes(self) -> bytes:
        """The tree as bytes: a header, a byte for each leaf and a checksum."""
        return depths_to_bytes(self.max_depth, self.depths())


def _joined(cells: np.ndarray, parts: list[tuple[int, int]]) -> np.ndarray:
    slices = [cells[first : first + count] for first, count in parts]
    return slices[0] if len(slices) == 1 else np.concatenate(slices)
