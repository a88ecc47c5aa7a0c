# SPDX-License-Identifier: GPL-3.0-or-later
"""The concurrent binary tree: a bitfield with one bit a deepest node, and a sum reduction above it (Dupuy 2020).

A leaf sets the bit of its first deepest node, its *cell*. Of the bitfield the cells whose bits are set are kept, in
order, as a *stream*: 8 bytes a leaf however deep the tree. Leaves are counted for blocks of 4,096 cells, for 64 blocks
and so on, in counters of whole bytes: uint16 a block, int64 above. Only what lies above changed cells is summed again.
The counters have their fixed place in memory that the system commits when it is touched.

The tree knows nothing of triangles and cameras.
"""

from functools import cache

import numpy as np
import warp as wp

from ...kernels.refine.sum_reduction import Run, Runs, reduce_changed
from ..errors import TerrainError
from ..run import launch
from ..run.buffers import shared
from .cell_streams import CellStreams
from .saved import MAX_DEPTH, MIN_DEPTH, depths_to_bytes

BLOCK_BITS = 12  # log2 of the cells in a block


class ConcurrentBinaryTree:
    """A binary tree of at most `max_depth` (6 .. 40) levels below its root, kept as the set of its leaves.

    Leaves are numbered 0 .. leaf_count - 1 in the order of their cells, which is the order of a depth-first walk.
    """

    def __init__(self, max_depth: int):
        if not (isinstance(max_depth, int) and MIN_DEPTH <= max_depth <= MAX_DEPTH):
            raise TerrainError(
                f"The tree's depth is {max_depth!r}; expected a whole number, {MIN_DEPTH} .. {MAX_DEPTH}."
            )
        self.max_depth = max_depth
        self.cell_count = 1 << max_depth
        blocks = 1 << max(0, max_depth - BLOCK_BITS)
        self._block_counts = np.zeros(blocks, np.uint16)
        sizes = [-(-blocks >> 6)]
        while sizes[-1] > 1:
            sizes.append(-(-sizes[-1] >> 6))
        self._level_start = np.cumsum([0, *sizes[:-1]], dtype=np.int64)
        self._upper_counts = np.zeros(sum(sizes), np.int64)
        self._changed = np.zeros(1, np.int64)
        # Counters from the root down to the blocks: below entry n are the entries 64 n .. 64 n + 63 of the next array.
        parts = np.split(self._upper_counts, self._level_start[1:])
        self._levels = [*parts[::-1], self._block_counts]
        longs = [shared(array, wp.int64) for array in (self._upper_counts, self._level_start, self._changed)]
        self._counters = [shared(self._block_counts, wp.uint16), *longs]
        self._cells = CellStreams()
        self._recorded: tuple[dict, dict] = {}, {}  # for either of the two streams
        self.next_cells(2).numpy()[0] = 0
        self.mark_written([(0, 1)])

    @property
    def leaf_count(self) -> int:
        """Leaves of the tree, at least 1."""
        return int(self._upper_counts[-1])

    @property
    def nbytes(self) -> int:
        """Address space of all arrays; the system commits what is touched of it."""
        return self._block_counts.nbytes + self._upper_counts.nbytes + self._cells.nbytes

    def cell_of_leaf(self, leaf: int) -> int:
        """First cell of leaf number `leaf`, in O(depth); of `leaf_count`, the end of the curve, 2**max_depth."""
        if leaf == self.leaf_count:
            return self.cell_count
        if not 0 <= leaf < self.leaf_count:
            raise TerrainError(f"Leaf {leaf} does not exist; expected 0 .. {self.leaf_count - 1}.")
        node, left = 0, leaf
        for level in self._levels[1:]:
            node, left = _descend(level, node, left)
        return int(self._cells.within(node << BLOCK_BITS, (node + 1) << BLOCK_BITS)[left])

    def next_cells(self, room: int) -> wp.array:
        """Memory for the next stream of cells, int64, at least [room]: to be written, then `mark_written`.

        What is written and not marked changes nothing.
        """
        return self._cells.next(room)

    def last_cells(self) -> wp.array:
        """Memory of the stream that holds: int64."""
        return self._cells.now()

    def mark_written(self, parts: list[tuple[int, int]], runs: "Runs | None" = None) -> int:
        """Replace the leaves by those of the stream in `next_cells`, and return how many cells are in one of them only.

        `parts`: first entry and number of cells of each part, ascending, as the cells in them are; the entry after a
        part's last cell must be free. `runs`: cells that are the same in both streams and need not be compared.
        """
        parts = [(int(first), int(count)) for first, count in parts if count]
        self._cells.link(parts)
        inputs = [self._cells.next(), self._cells.now(), *self._counters, runs or no_runs()]
        launch.once(reduce_changed, inputs, step="mark", recorded=self._recorded[0])
        self._recorded = self._recorded[::-1]
        self._cells.advance(parts)
        return int(self._changed[0])

    def cells(self) -> np.ndarray:
        """The first cell of each leaf in order, int64 [leaf_count].

        Of a stream in one part it is a view of the tree's own array, valid until the next frame.
        """
        return self._cells.joined()

    def depths(self) -> np.ndarray:
        """Depth of each leaf in order: uint8 [leaf_count]."""
        sizes = np.diff(self.cells(), append=self.cell_count)
        return (self.max_depth - np.searchsorted(1 << np.arange(self.max_depth + 1), sizes)).astype(np.uint8)

    def to_bytes(self) -> bytes:
        """The tree as bytes: a header, a byte for each leaf and a checksum."""
        return depths_to_bytes(self.max_depth, self.depths())


@cache
def no_runs() -> Runs:
    """Nothing known of two streams."""
    runs = Runs()
    runs.runs, runs.counts = wp.zeros(1, dtype=Run, device="cpu"), wp.zeros(1, dtype=wp.int64, device="cpu")
    runs.room = 1
    return runs


def _descend(counters: np.ndarray, group: int, leaf: int) -> tuple[int, int]:
    """Which of the 64 counters of `group` holds leaf number `leaf` of the group, and its number in there."""
    ends = np.cumsum(counters[64 * group : 64 * group + 64], dtype=np.int64)
    child = int(np.searchsorted(ends, leaf, side="right"))
    return 64 * group + child, leaf - (int(ends[child - 1]) if child else 0)
