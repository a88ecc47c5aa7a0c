# SPDX-License-Identifier: GPL-3.0-or-later
"""The concurrent binary tree (Dupuy 2020).

It is a bitfield with a bit for the first deepest cell of each leaf, and a sum reduction above it.
kernels/tree/bitfield.py describes how the bits are stored.

The tree knows nothing of triangles and cameras.
"""

from typing import NamedTuple

import numpy as np
import warp as wp

from ...kernels.tree import bitfield, edits, queries, reduction
from ...kernels.tree import set_leaves as writing
from ...kernels.tree.bitfield import MAX_DEPTH
from ..errors import TerrainError
from ..run import launch
from ..run.buffers import bind, shared
from .saved import MIN_DEPTH, depths_from_bytes, depths_to_bytes

SLOTS = 64  # words of a page
FIRST_PAGES = 2  # page 0 stays empty, page 1 holds the highest word
FEW_CHANGED = 500  # words that one thread sums sooner than several launches
ARRAYS = {"words": wp.uint64, "stored": wp.uint64, "counts": wp.int32, "pages": wp.int32, "changed": wp.int32}
DECODE_COST = 5.0  # of a leaf, in array lookups (15 ns); small jobs stay on one thread


class LeafPart(NamedTuple):
    """Consecutive leaves by the codes that hold their depths, up to a deepest cell where the next part begins."""

    codes: wp.array  # uint16, an entry for each leaf; see `set_leaves`
    first: int  # entry of the first leaf
    count: int  # type: ignore[assignment]  # hides tuple.count
    end: int  # the deepest cell behind the last one
    same: wp.array | None = None  # SameLeaves: nodes whose leaves are those that the tree has already, ascending
    first_same: int = 0  # those of this part begin at this entry of `same`
    num_same: int = 0  # their number; 0: all leaves are written


class ConcurrentBinaryTree:
    """A binary tree of at most `max_depth` (6 .. 62) levels below its root. It begins as its root.

    | group | methods | cost |
    | --- | --- | --- |
    | count | `leaf_count`, `nbytes` | O(1) |
    | query | `decode`, `find`, `is_leaf` | O(depth) a leaf |
    | edit | `split`, `merge`, `edit` | O(depth) a node, then a sum for each word that changed |
    | write all | `set_leaves`, `reset` | O(leaves), and a comparison with the words that there were |
    | list all | `leaves`, `depths`, `cells`, `to_bytes` | O(leaves * depth) |

    Node 1 is the root, node n has the children 2n and 2n + 1. A *deepest cell* is a node of depth `max_depth`;
    they are numbered along the curve, from 0. Leaves are numbered in the order of their cells, which is the order of a
    depth-first walk. Kernels read and edit `bits`.

    Queries and edits run on `threads` threads; the tree does not depend on how many, or in which order they write.
    Memory grows by doubling: 28 bytes for each word that a page has room for.
    """

    def __init__(self, max_depth: int, threads: int | None = 1) -> None:
        """Make a tree whose root is its only leaf. Raises TerrainError for a depth outside of 6 .. 62.

        threads: for queries and edits; None for `launch.default_threads`.
        """
        if not (isinstance(max_depth, int) and MIN_DEPTH <= max_depth <= MAX_DEPTH):
            raise TerrainError(
                f"The tree's depth is {max_depth!r}", expected=f"a whole number, {MIN_DEPTH} .. {MAX_DEPTH}"
            )
        self.max_depth, self.cell_count, self.threads = max_depth, 1 << max_depth, threads
        self.bits = bitfield.Bitfield()
        self._state = np.zeros(5, np.int32)  # counters and flags by bitfield.PAGES_USED and the like
        self.bits.state = shared(self._state, wp.int32)
        # `top`: level of the highest word; a word of 64 bits covers 6 levels of the tree
        self.bits.max_depth, self.bits.top = max_depth, (max_depth - 1) // 6
        self._arrays: dict[str, np.ndarray] = {}
        self._runs: list[writing.LeafRun] = []  # kept for the next `set_leaves`
        self._recorded: dict = {}  # launches that are recorded once, see `launch.slices`
        self._clear(FIRST_PAGES)

    # Count: O(1)

    @property
    def leaf_count(self) -> int:
        """Return the number of leaves of the tree, at least 1."""
        return int(self._arrays["counts"][SLOTS]) + 1

    @property
    def nbytes(self) -> int:
        """Return the address space of all arrays in bytes; the system commits the pages that are touched."""
        return sum(array.nbytes for array in self._arrays.values())

    # Query: O(depth) a leaf

    def decode(self, numbers: np.ndarray) -> np.ndarray:
        """Return the heap ids of leaves by their numbers: uint64.

        Raises TerrainError for numbers that are not in 0 .. leaf_count - 1.
        """
        numbers = np.ascontiguousarray(numbers, np.int32)
        low, high = numbers.min(initial=0), numbers.max(initial=0)
        if low < 0 or high >= self.leaf_count:
            raise TerrainError(f"The tree has no leaves {low} .. {high}", expected=f"0 .. {self.leaf_count - 1}")
        ids = np.empty(len(numbers), np.uint64)
        self._launch(queries.decode_leaves, len(ids), [shared(numbers, wp.int32), shared(ids, wp.uint64)])
        return ids

    def find(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the number (int32) and heap id (uint64) of the leaf that covers each deepest cell.

        cells: numbers of deepest cells (nodes of the deepest level along the curve), 0 .. cell_count - 1, which are not
        checked.
        """
        cells = np.ascontiguousarray(cells, np.uint64)
        numbers, ids = np.empty(len(cells), np.int32), np.empty(len(cells), np.uint64)
        arrays = shared(cells, wp.uint64), shared(numbers, wp.int32), shared(ids, wp.uint64)
        self._launch(queries.find_leaves, len(cells), [*arrays])
        return numbers, ids

    def is_leaf(self, heap_ids: np.ndarray) -> np.ndarray:
        """Return whether nodes are leaves, neither split nor below one: bool."""
        heap_ids = np.asarray(heap_ids, np.uint64)
        return self.find(self.cells_of(heap_ids))[1] == heap_ids

    def cells_of(self, heap_ids: np.ndarray) -> np.ndarray:
        """Return the first deepest cell of nodes: uint64."""
        return (heap_ids << (self.max_depth - depths_of(heap_ids)).astype(np.uint64)) - np.uint64(self.cell_count)

    # Edit: O(depth) a node

    def split(self, heap_ids: np.ndarray) -> None:
        """Replace leaves above the deepest level by their two children each. heap_ids: ids of the leaves, uint64."""
        ids = np.ascontiguousarray(heap_ids, np.uint64)
        self.edit(edits.split_leaves, len(ids), [shared(ids, wp.uint64)])

    def merge(self, heap_ids: np.ndarray) -> None:
        """Remove the two children of nodes, which must be leaves; the nodes become leaves. It undoes `split`."""
        ids = np.ascontiguousarray(heap_ids, np.uint64)
        self.edit(edits.merge_leaves, len(ids), [shared(ids, wp.uint64)])

    def edit(self, kernel: wp.Kernel, count: int, inputs: list) -> None:
        """Run a kernel over `count` items that splits and merges nodes of `bits`, then sum above the changed words.

        inputs: its arguments after the tree's arrays. The kernel runs again after the pool of pages was full, so a
        repeated run must give the same result.
        """
        if 2 * self._pages_used > self.bits.num_pages:  # writing anew frees the pages of words that are gone
            depths = self.depths()
            self._clear(self.bits.num_pages)
            self.set_depths(depths)
        self._state[bitfield.REPEATS] = 0
        self._launch(kernel, count, inputs)
        while self._state[bitfield.IS_FULL]:
            self._resize(2 * self.bits.num_pages)
            self._state[bitfield.REPEATS] = 1
            self._launch(kernel, count, inputs)
        self._reduce()

    # Write all leaves: O(leaves)

    def set_leaves(self, parts: list[LeafPart], shift: int = 0, levels: int | None = None) -> bool:
        """Replace the leaves by those of the parts; a thread writes each part.

        Return whether the tree has changed; also True if the pool of pages was full, because then nothing is compared.

        shift: a leaf's depth is in the bits `shift` .. `shift` + 5 of its code. levels: a leaf has 2^(levels - depth)
        deepest cells; `max_depth` by default. Nodes that a part lists as `same` have their leaves already.
        """
        parts, start = [part for part in parts if part.count], 0
        while len(self._runs) < len(parts):
            self._runs.append(writing.LeafRun())
        runs = self._runs[: len(parts)]
        for run, part in zip(runs, parts, strict=True):
            bind(run, codes=part.codes, first=part.first, count=part.count, start=start, end=part.end, shift=shift)
            bind(run, cell_depth=self.max_depth if levels is None else levels)
            bind(run, first_same=part.first_same, end_same=part.first_same + part.num_same)
            if part.num_same:
                bind(run, same=part.same)
            start = part.end
        estimated_pages = sum(int(part.count) for part in parts) // SLOTS  # fewer words than leaves
        if estimated_pages > self.bits.num_pages:
            self._resize(max(estimated_pages, 2 * self.bits.num_pages))
        self._state[bitfield.DIFFERS] = 0
        num_pages, is_empty = self.bits.num_pages, False
        while True:
            launch.slices(writing.set_leaves, [[self.bits, run] for run in runs], step="tree", recorded=self._recorded)
            if not self._state[bitfield.IS_FULL]:
                break
            # Begin anew with an empty pool, which frees the pages of words that are gone; then with larger ones.
            num_pages *= 2 if is_empty else 1
            self._clear(num_pages)
            self._state[bitfield.DIFFERS] = is_empty = True
            for run in runs:
                run.end_same = run.first_same  # an empty tree has no leaves to keep
        self._reduce()
        if 2 * self._pages_used > self.bits.num_pages and is_empty:  # later edits need room
            self._resize(2 * num_pages)
        return bool(self._state[bitfield.DIFFERS])

    def set_depths(self, depths: np.ndarray) -> bool:
        """Replace the leaves by those of these depths, which leave no gap; return the result of `set_leaves`."""
        codes = shared(np.ascontiguousarray(depths, np.uint16), wp.uint16)
        return self.set_leaves([LeafPart(codes, first=0, count=len(depths), end=self.cell_count)])

    def reset(self, depth: int = 0) -> None:
        """Replace the leaves by all the nodes at `depth`, bisections below the root."""
        self.set_depths(np.full(1 << depth, depth))

    # List all leaves: O(leaves * depth)

    def leaves(self) -> np.ndarray:
        """Return the heap ids of all leaves: uint64."""
        return self.decode(np.arange(self.leaf_count, dtype=np.int32))

    def depths(self) -> np.ndarray:
        """Return the depth of each leaf: uint8."""
        return depths_of(self.leaves())

    def cells(self) -> np.ndarray:
        """Return the first deepest cell of each leaf: uint64."""
        return self.cells_of(self.leaves())

    def to_bytes(self) -> bytes:
        """Return the tree as bytes: a header, a byte for each leaf and a checksum."""
        return depths_to_bytes(self.max_depth, self.depths())

    @classmethod
    def from_bytes(cls, data: bytes) -> "ConcurrentBinaryTree":
        """Return the tree that `to_bytes` wrote. Raises TerrainError for anything else."""
        max_depth, depths = depths_from_bytes(data)
        tree = cls(max_depth)
        tree.set_depths(depths)
        return tree

    # Inside

    @property
    def _pages_used(self) -> int:
        """Return the number of pages of the pool that hold words of the bitfield."""
        return int(self._state[bitfield.PAGES_USED])

    def _launch(self, kernel: wp.Kernel, count: int, inputs: list) -> None:
        """Launch a kernel over `count` items on the tree's threads; inputs: its arguments after the tree's arrays."""
        launch.spread(kernel, count, [self.bits, *inputs], step="tree", threads=self.threads, cost=DECODE_COST)

    def _reduce(self) -> None:
        """Sum the changed words again, level by level from the lowest, and empty their list."""
        changed = int(self._state[bitfield.NUM_CHANGED])
        if changed > FEW_CHANGED:
            for level in range(self.bits.top + 1):
                self._launch(reduction.reduce_level, changed, [level])
            self._state[bitfield.NUM_CHANGED] = 0
        elif changed:  # one thread, which also empties the list
            launch.once(reduction.reduce_words, [self.bits], step="tree", recorded=self._recorded)

    def _clear(self, num_pages: int) -> None:
        """Make the root the only leaf, in a pool of `num_pages` pages."""
        used = SLOTS * self._pages_used
        self._resize(num_pages)
        for array in self._arrays.values():
            array[:used] = 0
        self._arrays["words"][SLOTS] = 1  # the first bit of the highest word: the root's
        self._state[:] = 0
        self._state[bitfield.PAGES_USED] = FIRST_PAGES

    def _resize(self, num_pages: int) -> None:
        """Give the pool room for `num_pages` pages, no fewer than it has; they keep their content."""
        # A kernel that finds the pool full has counted pages that it did not get.
        self._state[bitfield.PAGES_USED] = min(self._pages_used, self.bits.num_pages)
        self._state[bitfield.IS_FULL] = 0
        if num_pages != self.bits.num_pages:
            for name, dtype in ARRAYS.items():
                array = np.zeros(SLOTS * num_pages, wp.dtype_to_numpy(dtype))
                if name in self._arrays:
                    array[: len(self._arrays[name])] = self._arrays[name]
                self._arrays[name] = array
                setattr(self.bits, name, shared(array, dtype))
            self.bits.num_pages = num_pages


def depths_of(heap_ids: np.ndarray) -> np.ndarray:
    """Return the depths of nodes: uint8."""
    high = heap_ids >> np.uint64(32)  # float64 rounds ids of more than 53 bits, perhaps up to the next power of two
    bits = np.frexp(np.where(high, high, heap_ids).astype(np.float64))[1]
    return (bits - 1 + np.where(high, 32, 0)).astype(np.uint8)
