# SPDX-License-Identifier: GPL-3.0-or-later
"""A saved tree: the depths of its leaves in order, which say where each begins and ends. A byte a leaf."""

import struct
import zlib

import numpy as np

from ..errors import TerrainError

MIN_DEPTH, MAX_DEPTH = 6, 40

_HEADER = struct.Struct("<4sHHQ")  # magic, version, max_depth, leaves
_MAGIC, _VERSION = b"ACBT", 2


def depths_to_bytes(max_depth: int, depths: np.ndarray) -> bytes:
    """A header, the depths (uint8) and a checksum."""
    data = _HEADER.pack(_MAGIC, _VERSION, max_depth, len(depths)) + depths.tobytes()
    return data + struct.pack("<I", zlib.crc32(data))


def depths_from_bytes(data: bytes) -> tuple[int, np.ndarray]:
    """What `depths_to_bytes` was given. Raises TerrainError for anything else, before any large allocation."""
    what = f"The saved tree of {len(data)} bytes"
    if len(data) < _HEADER.size + 4 or data[:4] != _MAGIC:
        raise TerrainError(f"{what} is not one that this add-on wrote; save it again.")
    _, version, max_depth, count = _HEADER.unpack_from(data)
    if version != _VERSION or not MIN_DEPTH <= max_depth <= MAX_DEPTH:
        raise TerrainError(
            f"{what} has version {version} and depth {max_depth}; expected version {_VERSION} and depth "
            f"{MIN_DEPTH} .. {MAX_DEPTH}; save it again."
        )
    if len(data) != _HEADER.size + count + 4 or struct.unpack("<I", data[-4:])[0] != zlib.crc32(data[:-4]):
        raise TerrainError(f"{what} is cut short or damaged ({count} leaves); save it again.")
    depths = np.frombuffer(data, np.uint8, count, _HEADER.size)
    if not _are_of_tree(depths, max_depth):
        raise TerrainError(f"{what} has leaves that do not form a tree; save it again.")
    return max_depth, depths


def _are_of_tree(depths: np.ndarray, max_depth: int) -> bool:
    """Whether leaves of these depths, one after the other, leave no gap: a leaf of 2**j cells begins at a multiple of
    2**j, and the last one ends where the tree does."""
    counts = np.bincount(depths, minlength=1).tolist()
    if len(counts) > max_depth + 1 or sum(int(n) << max_depth - d for d, n in enumerate(counts)) != 1 << max_depth:
        return False
    sizes = np.int64(1) << max_depth - depths.astype(np.int64)
    return not ((np.cumsum(sizes) - sizes) & (sizes - 1)).any()
