# SPDX-License-Identifier: GPL-3.0-or-later
"""A saved tree: the depths of its leaves in order, one byte a leaf. They give the begin and end of every leaf."""

import struct
import zlib

import numpy as np

from ...kernels.tree.bitfield import MAX_DEPTH
from ..errors import TerrainError, check_kind

MIN_DEPTH = 6

_HEADER = struct.Struct("<4sHHQ")  # magic, version, max_depth, leaves
_MAGIC, _VERSION = b"ACBT", 2


def depths_to_bytes(max_depth: int, depths: np.ndarray) -> bytes:
    """Return a header, the depths (uint8) and a checksum as bytes."""
    data = _HEADER.pack(_MAGIC, _VERSION, max_depth, len(depths)) + depths.tobytes()
    return data + struct.pack("<I", zlib.crc32(data))


def depths_from_bytes(data: bytes) -> tuple[int, np.ndarray]:
    """Return the tree's depth, and the leaves' depths as a read-only view of the bytes that `depths_to_bytes` wrote.

    Raises TerrainError for other bytes, before any large allocation.
    """
    check_kind(data, bytes, "The saved tree", "bytes, as Terrain.saved returns them")
    what, fix = f"The saved tree of {len(data)} bytes", "save it again"
    if len(data) < _HEADER.size + 4 or data[:4] != _MAGIC:
        raise TerrainError(f"{what} was not written by this add-on", fix=fix)
    _, version, max_depth, count = _HEADER.unpack_from(data)
    if version != _VERSION or not MIN_DEPTH <= max_depth <= MAX_DEPTH:
        raise TerrainError(
            f"{what} has version {version} and depth {max_depth}",
            expected=f"version {_VERSION} and depth {MIN_DEPTH} .. {MAX_DEPTH}",
            fix=fix,
        )
    if len(data) != _HEADER.size + count + 4 or struct.unpack("<I", data[-4:])[0] != zlib.crc32(data[:-4]):
        raise TerrainError(f"{what} is cut short or damaged", where=f"{count} leaves", fix=fix)
    depths = np.frombuffer(data, np.uint8, count, _HEADER.size)
    if not _form_a_tree(depths, max_depth):
        raise TerrainError(f"{what} has leaves that do not form a tree", fix=fix)
    return max_depth, depths


def _form_a_tree(depths: np.ndarray, max_depth: int) -> bool:
    """Return whether leaves of these depths in order fill the tree.

    A leaf of 2**j deepest cells begins at a multiple of 2**j, and the last leaf ends at the end of the tree.
    """
    counts = np.bincount(depths, minlength=1).tolist()
    if len(counts) > max_depth + 1 or sum(int(n) << max_depth - d for d, n in enumerate(counts)) != 1 << max_depth:
        return False
    sizes = np.int64(1) << max_depth - depths.astype(np.int64)
    return not ((np.cumsum(sizes) - sizes) & (sizes - 1)).any()
