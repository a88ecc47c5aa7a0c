# SPDX-License-Identifier: GPL-3.0-or-later
"""The nonzero words of a tree's bitfield: from cells and back, out to bytes and in again.

`index` int64 [n], ascending: positions of the words in the bitfield. `bits` uint64 [n]: one for the first cell of each
leaf.
"""

import struct
import zlib

import numpy as np

from ..errors import TerrainError

MIN_DEPTH, MAX_DEPTH = 6, 40
WORD_BITS = 6  # log2 of the cells in a word

_HEADER = struct.Struct("<4sHHQ")  # magic, version, max_depth, words
_MAGIC, _VERSION = b"ACBT", 1
_CHUNK = 1 << 16  # words expanded at once, so that a listing needs little more memory than its result


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
