# SPDX-License-Identifier: GPL-3.0-or-later
"""The nonzero words of a tree's bitfield: the streams in memory, from cells and back, out to bytes and in again.

`index` int64 [n], ascending: positions of the words in the bitfield. `bits` uint64 [n]: one for the first cell of each
leaf.
"""

import struct
import zlib

import numpy as np
import warp as wp

from ..kernels.tree import END_INDEX
from .buffers import Buffers
from .errors import TerrainError

MIN_DEPTH, MAX_DEPTH = 6, 40
WORD_BITS, BLOCK_BITS = 6, 12  # log2 of the cells in a word and in a block of 64 words

_HEADER = struct.Struct("<4sHHQ")  # magic, version, max_depth, words
_MAGIC, _VERSION = b"ACBT", 1
_CHUNK = 1 << 16  # words expanded at once, so that a listing needs little more memory than its result


class WordStreams:
    """The stream of words that holds now, and memory for the next one.

    A stream lies in parts, (first entry, words) each, that ascend and are not empty; what leads from one to the next is
    in the entry behind its last word, see kernels/tree.py.
    """

    def __init__(self):
        self._now, self._next = Buffers(), Buffers()
        self._parts: list[tuple[int, int]] = []
        self.next()
        self.link([])
        self.advance([])

    @property
    def nbytes(self) -> int:
        """Bytes of both streams' arrays."""
        return self._now.nbytes + self._next.nbytes

    def now(self) -> tuple[wp.array, wp.array]:
        """Memory of the stream that holds, index and bits: the same objects until `advance`."""
        return self._now.get("index", 1, wp.int64), self._now.get("bits", 1, wp.uint64)

    def next(self, room: int = 1) -> tuple[wp.array, wp.array]:
        """Memory of the next stream, at least `room` entries, one behind the words of each part included."""
        return self._next.get("index", room, wp.int64), self._next.get("bits", room, wp.uint64)

    def write(self, slices: list[tuple[np.ndarray, np.ndarray]]) -> list[tuple[int, int]]:
        """Copy consecutive slices of a stream to the next one's memory, and return its parts.

        A word that is cut by a slice's end may be in both.
        """
        index, bits = self._next.numpy("index"), self._next.numpy("bits")
        count = 0
        for slice_index, slice_bits in slices:
            if count and len(slice_index) and index[count - 1] == slice_index[0]:
                bits[count - 1] |= slice_bits[0]
                slice_index, slice_bits = slice_index[1:], slice_bits[1:]
            index[count : count + len(slice_index)] = slice_index
            bits[count : count + len(slice_bits)] = slice_bits
            count += len(slice_index)
        return [(0, count)] if count else []

    def link(self, parts: list[tuple[int, int]]) -> None:
        """Write the entries that lead through the parts of the next stream."""
        index, bits = self._next.numpy("index"), self._next.numpy("bits")
        end = 0
        for first, count in parts:
            if first != end or end > 0:
                index[end], bits[end] = END_INDEX, first
            end = first + count
        index[end], bits[end] = END_INDEX, 0

    def advance(self, parts: list[tuple[int, int]]) -> None:
        """Make the next stream, of these parts, the one that holds."""
        self._now, self._next, self._parts = self._next, self._now, parts

    def joined(self) -> tuple[np.ndarray, np.ndarray]:
        """Index and bits of all words: views if the stream is in one part, else copies."""
        streams = self._now.numpy("index"), self._now.numpy("bits")
        if len(self._parts) == 1:
            first, count = self._parts[0]
            return tuple(stream[first : first + count] for stream in streams)
        return tuple(np.concatenate([s[:0], *(s[first : first + n] for first, n in self._parts)]) for s in streams)

    def within(self, start: int, end: int) -> dict[int, int]:
        """Words from `start` to before `end`, ascending: index to bits."""
        index, bits = self._now.numpy("index"), self._now.numpy("bits")
        words = {}
        for first, count in self._parts:
            if index[first] < end and index[first + count - 1] >= start:
                low, high = first + np.searchsorted(index[first : first + count], [start, end])
                words |= zip(index[low:high].tolist(), bits[low:high].tolist(), strict=True)
        return words


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


def words_to_bytes(max_depth: int, index: np.ndarray, bits: np.ndarray) -> bytes:
    """A header, the words and a checksum, 16 bytes a word."""
    data = _HEADER.pack(_MAGIC, _VERSION, max_depth, len(index))
    data += index.astype("<i8").tobytes() + bits.astype("<u8").tobytes()
    return data + struct.pack("<I", zlib.crc32(data))


def words_from_bytes(data: bytes) -> tuple[int, np.ndarray, np.ndarray]:
    """What `words_to_bytes` was given. Raises TerrainError for anything else, before any large allocation."""
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
    if not _are_of_tree(index, bits, 1 << max_depth):
        raise TerrainError(f"{what} has leaves that do not form a tree; update the terrain to make it anew.")
    return max_depth, index, bits


def _are_of_tree(index: np.ndarray, bits: np.ndarray, cell_count: int) -> bool:
    """Whether the words are those of a tree: leaves of 2**j cells that begin at multiples of 2**j and leave no gap."""
    if len(index) == 0 or index[0] != 0 or index[-1] >= cell_count >> WORD_BITS:
        return False
    if (np.diff(index) <= 0).any() or (bits == 0).any() or int(bits[0]) & 1 == 0:
        return False
    cells = unpack_cells(index, bits)
    sizes = np.diff(cells, append=cell_count)
    return bool(((sizes & (sizes - 1)) == 0).all() and ((cells & (sizes - 1)) == 0).all())
