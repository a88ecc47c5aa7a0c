# SPDX-License-Identifier: GPL-3.0-or-later
"""The concurrent binary tree: a bitfield with one bit a deepest node, and a sum reduction above it (Dupuy 2020).

A leaf sets the bit of its first deepest node, its *cell*. Of the bitfield the cells whose bits are set are kept, in
order, as a *stream*: 8 bytes a leaf however deep the tree. Leaves are counted for blocks of 4,096 cells, for 64 blocks
and so on, in counters of whole bytes: uint16 a block, int64 above. Only what lies above changed cells is summed again.
The counters have their fixed place in memory that the system commits when it is touched.

The tree knows nothing of triangles and cameras. Ids and cells are Python ints: id 1 is the root, id n has the children
2n and 2n + 1, so an id at depth d lies in [2**d, 2**(d+1)).
"""

from functools import cache

import numpy as np
import warp as wp

from ...kernels.refine.sum_reduction import Run, Runs, reduce_changed
from ..errors import TerrainError
from ..run import launch
from ..run.buffers import shared
from .cell_streams import CellStreams
from .saved import MAX_DEPTH, MIN_DEPTH, depths_from_bytes, depths_to_bytes

BLOCK_BITS = 12  # log2 of the cells in a block


class ConcurrentBinaryTree:
    """A binary tree of at most `max_depth` (6 .. 40) levels below its root, kept as the set of its leaves.

    | group | methods | cost |
    | --- | --- | --- |
    | count | `leaf_count` | O(1) |
    | query one | `decode`, `encode`, `is_leaf`, `leaf_at`, `cell_of_leaf`, `rank` | O(depth) |
    | edit one | `split`, `merge` | O(depth) |
    | write all | `mark`, `reset`, `mark_written` | O(leaves) to compare, O(depth) for each 64 blocks with a change |
    | list all | `cells`, `depths`, `leaves`, `to_bytes`, `from_bytes` | O(leaves) |

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
        self._edited: dict[int, np.ndarray] = {}  # blocks that `split` and `merge` lay over the stream
        self._recorded: tuple[dict, dict] = {}, {}  # for either of the two streams
        self.reset()

    # Count: O(1)

    @property
    def leaf_count(self) -> int:
        """Leaves of the tree, at least 1."""
        return int(self._upper_counts[-1])

    @property
    def nbytes(self) -> int:
        """Address space of all arrays; the system commits what is touched of it."""
        return self._block_counts.nbytes + self._upper_counts.nbytes + self._cells.nbytes

    @property
    def stamp(self) -> object:
        """The same object as long as no leaf is written or edited, and `last_cells` holds the same."""
        return self._stamp

    # Query one leaf: O(depth)

    def decode(self, leaf: int) -> int:
        """Heap id of leaf number `leaf`."""
        first = self.cell_of_leaf(leaf)
        size = self.cell_of_leaf(leaf + 1) - first
        return (self.cell_count + first) // size

    def encode(self, heap_id: int) -> int:
        """Number of the leaf `heap_id`."""
        if not self.is_leaf(heap_id):
            raise TerrainError(f"Node {heap_id} is not a leaf of the tree; expected a leaf, as `decode` gives.")
        return self.rank(self._cells_of(heap_id)[0])

    def is_leaf(self, heap_id: int) -> bool:
        """Whether `heap_id` is a leaf, neither split nor below a leaf."""
        first, size = self._cells_of(heap_id)
        if first not in self._block(first >> BLOCK_BITS):
            return False
        return self.cell_of_leaf(self.rank(first) + 1) - first == size

    def leaf_at(self, cell: int) -> int:
        """Heap id of the leaf that covers `cell`, 0 .. 2**max_depth - 1."""
        if not 0 <= cell < self.cell_count:
            raise TerrainError(f"Cell {cell} is outside the tree; expected 0 .. {self.cell_count - 1}.")
        return self.decode(self.rank(cell + 1) - 1)

    def cell_of_leaf(self, leaf: int) -> int:
        """First cell of leaf number `leaf`; of `leaf_count`, the end of the curve, 2**max_depth."""
        if leaf == self.leaf_count:
            return self.cell_count
        if not 0 <= leaf < self.leaf_count:
            raise TerrainError(f"Leaf {leaf} does not exist; expected 0 .. {self.leaf_count - 1}.")
        node, left = 0, leaf
        for level in self._levels[1:]:
            node, left = _descend(level, node, left)
        return int(self._block(node)[left])

    def rank(self, cell: int) -> int:
        """Leaves that begin before `cell`, 0 .. 2**max_depth."""
        if cell >= self.cell_count:
            return self.leaf_count
        node = cell >> BLOCK_BITS
        total = int(np.searchsorted(self._block(node), cell))
        for level in self._levels[:0:-1]:
            total += int(level[node & ~63 : node].sum(dtype=np.int64))
            node >>= 6
        return total

    # Edit one node: O(depth)

    def split(self, heap_id: int) -> None:
        """Give the leaf `heap_id` its two children."""
        if heap_id >= self.cell_count:
            raise TerrainError(f"Node {heap_id} is at the deepest level, {self.max_depth}; it cannot be split.")
        if not self.is_leaf(heap_id):
            raise TerrainError(f"Node {heap_id} is not a leaf of the tree; only a leaf can be split.")
        self._flip(self._cells_of(2 * heap_id + 1)[0])

    def merge(self, heap_id: int) -> None:
        """Take the two children of `heap_id` away, which must be leaves: undoes `split`."""
        if not (0 < heap_id < self.cell_count and self.is_leaf(2 * heap_id) and self.is_leaf(2 * heap_id + 1)):
            raise TerrainError(f"Node {heap_id} has not two leaves as children; only such a node can be merged.")
        self._flip(self._cells_of(2 * heap_id + 1)[0])

    # Write all leaves

    def mark(self, cells: np.ndarray) -> int:
        """Replace the leaves by those that begin at `cells`, and return how many differ from before.

        `cells` int64 [n], ascending: the first cell of each leaf. They are copied.
        """
        return self.mark_slices([cells])

    def mark_slices(self, slices: list[np.ndarray]) -> int:
        """As `mark`, of consecutive slices."""
        self.next_cells(sum(len(cells) for cells in slices) + 1)
        return self.mark_written(self._cells.write(slices))

    def next_cells(self, room: int) -> wp.array:
        """Memory for the next stream of cells, int64, at least [room]: to be written, then `mark_written`.

        What is written and not marked changes nothing.
        """
        if self._edited:
            self._fold()
        return self._cells.next(room)

    def last_cells(self) -> wp.array:
        """Memory of the stream as it was written, without what was edited since: int64."""
        return self._cells.now()

    def mark_written(self, parts: list[tuple[int, int]], runs: "Runs | None" = None) -> int:
        """Replace the leaves by those of the stream in `next_cells`, and return how many cells are in one of them only.

        `parts`: first entry and number of cells of each part, ascending, as the cells in them are; the entry after a
        part's last cell must be free, and the tree not edited since `next_cells`. `runs`: cells that are the same in
        both streams and need not be compared.
        """
        parts = [(int(first), int(count)) for first, count in parts if count]
        self._cells.link(parts)
        inputs = [self._cells.next(), self._cells.now(), *self._counters, runs or no_runs()]
        launch.once(reduce_changed, inputs, step="mark", recorded=self._recorded[0])
        self._recorded = self._recorded[::-1]
        self._cells.advance(parts)
        self._stamp = object()
        return int(self._changed[0])

    def reset(self, depth: int = 0) -> None:
        """Make the leaves all the nodes at `depth`."""
        if not 0 <= depth <= self.max_depth:
            raise TerrainError(f"The tree cannot be reset to depth {depth}; expected 0 .. {self.max_depth}.")
        self.mark(np.arange(1 << depth, dtype=np.int64) << (self.max_depth - depth))

    # List all leaves: O(leaves)

    def cells(self) -> np.ndarray:
        """The first cell of each leaf in order, int64 [leaf_count], as `mark` takes them.

        Of a stream in one part it is a view of the tree's own array, valid until the next edit.
        """
        if self._edited:
            self._fold()
        return self._cells.joined()

    def depths(self) -> np.ndarray:
        """Depth of each leaf in order: uint8 [leaf_count]."""
        sizes = np.diff(self.cells(), append=self.cell_count)
        return (self.max_depth - np.searchsorted(1 << np.arange(self.max_depth + 1), sizes)).astype(np.uint8)

    def leaves(self) -> np.ndarray:
        """Heap ids of all leaves in order: uint64 [leaf_count]."""
        return (self.cells() + self.cell_count >> self.max_depth - self.depths().astype(np.int64)).astype(np.uint64)

    def to_bytes(self) -> bytes:
        """The tree as bytes: a header, a byte for each leaf and a checksum."""
        return depths_to_bytes(self.max_depth, self.depths())

    @classmethod
    def from_bytes(cls, data: bytes) -> "ConcurrentBinaryTree":
        """The tree that `to_bytes` wrote. Raises TerrainError for anything else, before any large allocation."""
        max_depth, depths = depths_from_bytes(data)
        tree = cls(max_depth)
        sizes = np.int64(1) << max_depth - depths.astype(np.int64)
        tree.mark(np.cumsum(sizes) - sizes)
        return tree

    # Inside

    def _cells_of(self, heap_id: int) -> tuple[int, int]:
        """First cell and number of cells of a node."""
        depth = int(heap_id).bit_length() - 1
        if not 0 <= depth <= self.max_depth:
            raise TerrainError(f"Node {heap_id} is outside the tree; expected 1 .. {2 * self.cell_count - 1}.")
        shift = self.max_depth - depth
        return (int(heap_id) << shift) - self.cell_count, 1 << shift

    def _block(self, block: int) -> np.ndarray:
        """Cells of the leaves that begin in a block, int64, ascending."""
        if block in self._edited:
            return self._edited[block]
        return self._cells.within(block << BLOCK_BITS, (block + 1) << BLOCK_BITS)

    def _flip(self, cell: int) -> None:
        """Turn one bit over and count again above it."""
        node = cell >> BLOCK_BITS
        before = self._block(node)
        self._edited[node] = np.setxor1d(before, [cell])
        self._stamp = object()
        delta = len(self._edited[node]) - len(before)
        for level in reversed(self._levels):
            level[node] = int(level[node]) + delta
            node >>= 6

    def _fold(self) -> None:
        """Write the edited blocks into the stream."""
        cells = self._cells.joined()
        stays = cells[~np.isin(cells >> BLOCK_BITS, np.array(list(self._edited), np.int64))]
        cells = np.sort(np.concatenate([stays, *self._edited.values()]))
        self._cells.next(len(cells) + 1)
        parts = self._cells.write([cells])
        self._cells.link(parts)
        self._cells.advance(parts)
        self._edited = {}


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
