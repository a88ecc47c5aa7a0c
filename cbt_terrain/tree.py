# SPDX-License-Identifier: GPL-3.0-or-later
"""The concurrent binary tree: a bitfield with one bit a deepest node, and a sum reduction above it (Dupuy 2020).

A leaf sets the bit of its first deepest node, its *cell*. Leaves are counted word by word by population count, then for
blocks of 64 words, for 64 blocks and so on, in counters of whole bytes: uint16 a block, int64 above. Only what lies
above changed words is summed again. Of the bitfield the words that are not zero are kept, in order: 16 bytes a word
however deep the tree, and a population count is cheaper than the byte that would hold it. The counters have their fixed
place, 2 bytes for each 4,096 cells, in memory that the system commits when it is touched.

The tree knows nothing of triangles and cameras. Ids and cells are Python ints: id 1 is the root, id n has the children
2n and 2n + 1, so an id at depth d lies in [2**d, 2**(d+1)).
"""

import struct
import zlib

import numpy as np
import warp as wp

from ..kernels.tree import END_INDEX, reduce_changed
from . import launch
from .buffers import shared
from .errors import TerrainError

MIN_DEPTH, MAX_DEPTH = 6, 40
WORD_BITS, BLOCK_BITS = 6, 12  # log2 of the cells in a word and in a block of 64 words

_HEADER = struct.Struct("<4sHHQ")  # magic, version, max_depth, words
_MAGIC, _VERSION = b"ACBT", 1
_CHUNK = 1 << 16  # words expanded at once, so that a listing needs little more memory than its result


class ConcurrentBinaryTree:
    """A binary tree of at most `max_depth` (6 .. 40) levels below its root, kept as the set of its leaves.

    | group | methods | cost |
    | --- | --- | --- |
    | count | `leaf_count` | O(1) |
    | query one | `decode`, `encode`, `is_leaf`, `leaf_at`, `cell_of_leaf`, `rank` | O(depth) |
    | edit one | `split`, `merge` | O(depth) |
    | write all | `mark`, `reset` | O(words) to compare, O(depth) for each 64 blocks with a change |
    | list all | `words`, `leaves`, `to_bytes`, `from_bytes` | O(leaves) |

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
        # The nonzero words, ended by END, and room for the next ones; `split` and `merge` lay edited blocks over them.
        self._stream = (np.full(1, END_INDEX, np.int64), np.zeros(1, np.uint64))
        self._next = (np.full(1, END_INDEX, np.int64), np.zeros(1, np.uint64))
        self._word_count = 0
        self._shared: dict[int, tuple[np.ndarray, wp.array]] = {}
        self._recorded: dict = {}
        self._edited: dict[int, dict[int, int]] = {}
        self.reset()

    # Count: O(1)

    @property
    def leaf_count(self) -> int:
        """Leaves of the tree, at least 1."""
        return int(self._upper_counts[-1])

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays; those of the counters are committed as they are touched."""
        return sum(a.nbytes for a in [self._block_counts, self._upper_counts, *self._stream, *self._next])

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
        if not self._block(first >> BLOCK_BITS).get(first >> WORD_BITS, 0) >> (first & 63) & 1:
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
        for word, bits in self._block(node).items():
            count = bits.bit_count()
            if left < count:
                for _ in range(left):
                    bits &= bits - 1
                return (word << WORD_BITS) + (bits & -bits).bit_length() - 1
            left -= count
        raise AssertionError("the counters do not agree with the words")

    def rank(self, cell: int) -> int:
        """Leaves that begin before `cell`, 0 .. 2**max_depth."""
        if cell >= self.cell_count:
            return self.leaf_count
        node = cell >> BLOCK_BITS
        total = 0
        for word, bits in self._block(node).items():
            before = min(max(cell - (word << WORD_BITS), 0), 64)
            total += (bits & ((1 << before) - 1)).bit_count()
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

    def mark(self, word_index: np.ndarray, word_bits: np.ndarray) -> int:
        """Replace the leaves by those of a stream of nonzero words, and return how many words differ from before.

        `word_index` int64 [n], ascending: positions of the words in the bitfield. `word_bits` uint64 [n]: their bits,
        one for the first cell of each leaf. The stream is copied.
        """
        return self.mark_slices([(word_index, word_bits)])

    def mark_slices(self, slices: list[tuple[np.ndarray, np.ndarray]]) -> int:
        """As `mark`, of a stream in consecutive slices; a word that is cut by a slice's end may be in both."""
        if self._edited:
            self._fold()
        room = sum(len(index) for index, _ in slices) + 1
        if len(self._next[0]) < room:
            self._next = (np.empty(room + room // 4, np.int64), np.empty(room + room // 4, np.uint64))
        index, bits = self._next
        count = 0
        for slice_index, slice_bits in slices:
            if count and len(slice_index) and index[count - 1] == slice_index[0]:
                bits[count - 1] |= slice_bits[0]
                slice_index, slice_bits = slice_index[1:], slice_bits[1:]
            index[count : count + len(slice_index)] = slice_index
            bits[count : count + len(slice_bits)] = slice_bits
            count += len(slice_index)
        index[count], bits[count] = END_INDEX, 0
        counters = [self._block_counts, self._upper_counts, self._level_start]
        arrays = [*self._next, *self._stream, *counters, self._changed]
        launch.once(reduce_changed, [self._as_warp(a) for a in arrays], step="mark", recorded=self._recorded)
        self._stream, self._next = self._next, self._stream
        self._word_count = count
        return int(self._changed[0])

    def reset(self, depth: int = 0) -> None:
        """Make the leaves all the nodes at `depth`."""
        if not 0 <= depth <= self.max_depth:
            raise TerrainError(f"The tree cannot be reset to depth {depth}; expected 0 .. {self.max_depth}.")
        self.mark(*pack_cells(np.arange(1 << depth, dtype=np.int64) << (self.max_depth - depth)))

    # List all leaves: O(leaves)

    def words(self) -> tuple[np.ndarray, np.ndarray]:
        """The nonzero words of the bitfield in order: index int64 [n] and bits uint64 [n], as `mark` takes them.

        Views of the tree's own arrays, valid until the next edit.
        """
        if self._edited:
            self._fold()
        return self._stream[0][: self._word_count], self._stream[1][: self._word_count]

    def leaves(self) -> np.ndarray:
        """Heap ids of all leaves in order: uint64 [leaf_count]."""
        cells = unpack_cells(*self.words())
        sizes = np.diff(cells, append=self.cell_count)
        shifts = np.searchsorted(1 << np.arange(self.max_depth + 1, dtype=np.int64), sizes)
        return ((cells + self.cell_count) >> shifts).astype(np.uint64)

    def to_bytes(self) -> bytes:
        """The tree as bytes: a header, the nonzero words and a checksum, 16 bytes a word."""
        index, bits = self.words()
        data = _HEADER.pack(_MAGIC, _VERSION, self.max_depth, len(index))
        data += index.astype("<i8").tobytes() + bits.astype("<u8").tobytes()
        return data + struct.pack("<I", zlib.crc32(data))

    @classmethod
    def from_bytes(cls, data: bytes) -> "ConcurrentBinaryTree":
        """The tree that `to_bytes` wrote. Raises TerrainError for anything else, before any large allocation."""
        what = f"The saved tree of {len(data)} bytes"
        if len(data) < _HEADER.size + 4 or data[:4] != _MAGIC:
            raise TerrainError(f"{what} is not one that this add-on wrote; update the terrain to make it anew.")
        _, version, max_depth, count = _HEADER.unpack_from(data)
        if version != _VERSION or not MIN_DEPTH <= max_depth <= MAX_DEPTH:
            raise TerrainError(
                f"{what} has version {version} and depth {max_depth}; expected version {_VERSION} and depth "
                f"{MIN_DEPTH} .. {MAX_DEPTH}; update the terrain to make it anew."
            )
        if len(data) != _HEADER.size + 16 * count + 4 or struct.unpack("<I", data[-4:])[0] != zlib.crc32(data[:-4]):
            raise TerrainError(f"{what} is cut short or damaged ({count} words); update the terrain to make it anew.")
        index = np.frombuffer(data, "<i8", count, _HEADER.size).astype(np.int64)
        bits = np.frombuffer(data, "<u8", count, _HEADER.size + 8 * count).astype(np.uint64)
        if not _is_tree(index, bits, 1 << max_depth):
            raise TerrainError(f"{what} has leaves that do not form a tree; update the terrain to make it anew.")
        tree = cls(max_depth)
        tree.mark(index, bits)
        return tree

    # Inside

    def _as_warp(self, array: np.ndarray) -> wp.array:
        """The array as Warp takes it, made once: that costs as much as a launch."""
        if id(array) not in self._shared:
            alive = [*self._next, *self._stream, self._block_counts, self._upper_counts, self._level_start]
            ids = {id(a) for a in [*alive, self._changed]}
            self._shared = {key: held for key, held in self._shared.items() if key in ids}
            self._shared[id(array)] = array, shared(array, wp.dtype_from_numpy(array.dtype))
        return self._shared[id(array)][1]

    def _cells_of(self, heap_id: int) -> tuple[int, int]:
        """First cell and number of cells of a node."""
        depth = int(heap_id).bit_length() - 1
        if not 0 <= depth <= self.max_depth:
            raise TerrainError(f"Node {heap_id} is outside the tree; expected 1 .. {2 * self.cell_count - 1}.")
        shift = self.max_depth - depth
        return (int(heap_id) << shift) - self.cell_count, 1 << shift

    def _block(self, block: int) -> dict[int, int]:
        """Nonzero words of a block, ascending: index to bits."""
        if block in self._edited:
            return self._edited[block]
        index, bits = self._stream
        first, end = np.searchsorted(index[: self._word_count], [block << 6, (block + 1) << 6])
        return dict(zip(index[first:end].tolist(), bits[first:end].tolist(), strict=True))

    def _flip(self, cell: int) -> None:
        """Turn one bit over and sum again above its word."""
        word, block = cell >> WORD_BITS, cell >> BLOCK_BITS
        words = self._block(block)
        before = words.get(word, 0)
        words[word] = before ^ 1 << (cell & 63)
        self._edited[block] = {w: bits for w, bits in sorted(words.items()) if bits}
        delta = words[word].bit_count() - before.bit_count()
        node = block
        for level in reversed(self._levels):
            level[node] = int(level[node]) + delta
            node >>= 6

    def _fold(self) -> None:
        """Write the edited blocks into the stream of words."""
        index, bits = self._stream[0][: self._word_count], self._stream[1][: self._word_count]
        stays = ~np.isin(index >> 6, np.array(list(self._edited), np.int64))
        words = [item for block in self._edited.values() for item in block.items()]
        index = np.concatenate([index[stays], np.array([w for w, _ in words], np.int64), [END_INDEX]])
        bits = np.concatenate([bits[stays], np.array([b for _, b in words], np.uint64), np.zeros(1, np.uint64)])
        order = np.argsort(index, kind="stable")
        self._stream = (index[order], bits[order])
        self._word_count = len(index) - 1
        self._edited = {}


def pack_cells(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nonzero words of a bitfield whose set bits are `cells` (int64, ascending): index int64 and bits uint64."""
    words = cells >> WORD_BITS
    starts = np.flatnonzero(np.diff(words, prepend=-1))
    bits = np.uint64(1) << (cells & 63).astype(np.uint64)
    return words[starts], np.bitwise_or.reduceat(bits, starts) if len(cells) else bits


def unpack_cells(index: np.ndarray, bits: np.ndarray) -> np.ndarray:
    """The set bits of a stream of words: int64, ascending. Undoes `pack_cells`."""
    cells = [np.empty(0, np.int64)]
    for start in range(0, len(index), _CHUNK):
        octets = bits[start : start + _CHUNK].astype("<u8").view(np.uint8)
        word, bit = np.divmod(np.flatnonzero(np.unpackbits(octets, bitorder="little")), 64)
        cells.append((index[start : start + _CHUNK][word] << WORD_BITS) + bit)
    return np.concatenate(cells)


def _descend(counters: np.ndarray, group: int, leaf: int) -> tuple[int, int]:
    """Which of the 64 counters of `group` holds leaf number `leaf` of the group, and its number in there."""
    ends = np.cumsum(counters[64 * group : 64 * group + 64], dtype=np.int64)
    child = int(np.searchsorted(ends, leaf, side="right"))
    return 64 * group + child, leaf - (int(ends[child - 1]) if child else 0)


def _is_tree(index: np.ndarray, bits: np.ndarray, cell_count: int) -> bool:
    """Whether the words are those of a tree: leaves of 2**j cells that begin at multiples of 2**j and leave no gap."""
    if len(index) == 0 or index[0] != 0 or index[-1] >= cell_count >> WORD_BITS:
        return False
    if (np.diff(index) <= 0).any() or (bits == 0).any() or int(bits[0]) & 1 == 0:
        return False
    cells = unpack_cells(index, bits)
    sizes = np.diff(cells, append=cell_count)
    return bool(((sizes & (sizes - 1)) == 0).all() and ((cells & (sizes - 1)) == 0).all())
