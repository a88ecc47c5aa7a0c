# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of a store's arrays: a .npy with a header of one page, followed by a checksum for every block.

    a page    the header of a .npy file, always the same bytes for one shape and dtype: it is compared, never parsed
    data      in C order, little endian
    checksums uint32, crc32 of every BLOCK_BYTES of the data; numpy's readers ignore them

Checksums detect damage by disks and copies. An attacker can write valid checksums, so kernels stay within their arrays
for any content.
"""

import math
import mmap
import os
import struct
import zlib
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import DTypeLike

from ..errors import TerrainError
from ..run import launch, owned_files, partial_files
from ..run.named_file import cause, open_regular

PAGE_BYTES = 4096
BLOCK_BYTES = 1 << 18
ROWS = 256  # rows that are tested together
# Blocks of each array that are checked when it is opened, evenly from the first to the last. They take 4 x 0.1 ms.
SAMPLED = 4
SUMMED = 256  # blocks of a file that is being written, after which its pages are released

CAN_REMOVE_MAPPED = os.name != "nt"  # Windows removes no file that is mapped
AGAIN = "import or shape the terrain again"


def header(shape: tuple[int, ...], dtype: DTypeLike) -> bytes:
    """Return the header of a .npy file, a page of memory long, so that pages of a hierarchy are aligned (layout.py)."""
    descr, sizes = np.lib.format.dtype_to_descr(np.dtype(dtype)), tuple(map(int, shape))
    plain = {"descr": descr, "fortran_order": False, "shape": sizes}
    magic = np.lib.format.magic(1, 0)
    text = repr(plain).encode().ljust(PAGE_BYTES - len(magic) - 3) + b"\n"  # 3: two bytes of length, one line end
    return magic + struct.pack("<H", len(text)) + text


def block_count(nbytes: int) -> int:
    """Return the number of blocks with a checksum in `nbytes` bytes."""
    return -(-nbytes // BLOCK_BYTES)


def file_bytes(nbytes: int) -> int:
    """Return the size of the file of an array of `nbytes` bytes."""
    return PAGE_BYTES + nbytes + 4 * block_count(nbytes)


def checksums(array: np.ndarray, blocks: Sequence[int], threads: int = 1) -> np.ndarray:
    """Return the CRC-32 of some blocks of a contiguous array, uint32 [len(blocks)].

    blocks: numbers of blocks of BLOCK_BYTES each; the last block of the array may be shorter.
    """
    data, sums = array.reshape(-1).view(np.uint8).data, np.zeros(len(blocks), np.uint32)

    def sum_up(first: int) -> None:
        """Compute every `threads`-th checksum, from number `first` on."""
        for k in range(first, len(blocks), threads):
            sums[k] = zlib.crc32(data[blocks[k] * BLOCK_BYTES : (blocks[k] + 1) * BLOCK_BYTES])

    launch.together([partial(sum_up, first) for first in range(threads)])
    return sums


def all_checksums(array: np.ndarray) -> bytes:
    """Return the checksums of an array as the bytes that follow its data in the file. Its pages are released."""
    threads, count, sums_of_parts = launch.default_threads(), block_count(array.nbytes), []
    for first in range(0, count, SUMMED):
        sums_of_parts.append(checksums(array, range(first, min(first + SUMMED, count)), threads).astype("<u4"))
        release_pages(array)
    return b"".join(sums.tobytes() for sums in sums_of_parts)


def release_pages(array: np.ndarray) -> None:
    """Release the memory of a mapped array, which counts as memory of the process; its content is in the file."""
    mapped = getattr(array.base, "_mmap", None)
    if mapped is not None and hasattr(mmap, "MADV_DONTNEED"):
        mapped.madvise(mmap.MADV_DONTNEED)


def write_array(file: Path, array: np.ndarray) -> None:
    """Write the file of a contiguous array, which appears when it is complete. Raises OSError."""
    with partial_files.written_beside(file) as partial, partial.open("wb") as handle:
        handle.write(header(array.shape, array.dtype))
        handle.write(array.data)  # `tofile` would not name the reason of a failure
        handle.write(all_checksums(array))


def allocate_array(file: Path, shape: tuple[int, ...], dtype: DTypeLike, huge_pages: bool = False) -> np.ndarray:
    """Return a zeroed array in a new file, or the array in the file that is there, mapped for writing.

    `append_checksums` completes the file. An array without entries is in memory.

    Its space on disk is allocated now. Raises OSError (ENOSPC) if the disk is full, because a mapped page without space
    would kill the process later. huge_pages: ask the system for pages of 2 MiB. Not all file systems have
    them; without, access to distant rows takes up to a fifth longer.
    """
    if not os.path.lexists(file):
        file.write_bytes(header(shape, dtype))
    if not np.prod(shape):
        return np.empty(shape, dtype)
    nbytes = file_bytes(math.prod(shape) * np.dtype(dtype).itemsize)
    with file.open("r+b") as handle:
        handle.truncate(nbytes)
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(handle.fileno(), 0, nbytes)
    array = np.load(file, mmap_mode="r+")
    mapped = getattr(array, "_mmap", None)
    if huge_pages and mapped is not None and hasattr(mmap, "MADV_HUGEPAGE"):
        with suppress(OSError):
            mapped.madvise(mmap.MADV_HUGEPAGE)
    return array.view(np.ndarray)


def append_checksums(file: Path, array: np.ndarray) -> None:
    """Write the checksums of an array of `allocate_array` after its data in its file. Raises OSError."""
    with file.open("r+b") as handle:
        handle.seek(PAGE_BYTES + array.nbytes)
        handle.write(all_checksums(array))


def all_finite(array: np.ndarray) -> bool:
    """Return whether all numbers of an array are finite; its rows are read some at a time."""
    return all(np.isfinite(array[row : row + ROWS]).all() for row in range(0, len(array), ROWS))


def map_array(file: Path, shape: tuple[int, ...], dtype: DTypeLike) -> np.ndarray:
    """Map an array copy-on-write: kernels use it like any other array, and nothing can change the file.

    At most SAMPLED of its blocks are checked. Raises FileNotFoundError, and TerrainError for any other fault. The
    system may read ahead: more bytes, but far fewer waits for the disk.
    """
    array, sums = _map_unchecked(file, shape, dtype)
    count = len(sums)
    sample = sorted({k * (count - 1) // (SAMPLED - 1) for k in range(SAMPLED)}) if count else []
    _check_blocks(file, array, sums, sample)
    return array


def is_cut_off(array: np.ndarray) -> bool:
    """Return whether the file of a mapped array was truncated since; reading there would kill the process (SIGBUS)."""
    whole = array
    while whole.base is not None and isinstance(whole.base, np.ndarray):  # of a view of a view
        whole = whole.base
    mapped = getattr(whole, "_mmap", None)
    return mapped is not None and mapped.size() < PAGE_BYTES + whole.nbytes


def verify_array(file: Path, shape: tuple[int, ...], dtype: DTypeLike) -> int:
    """Check the checksum of every block of an array's file; return the number of blocks.

    Raises FileNotFoundError, and TerrainError for any other fault.
    """
    array, sums = _map_unchecked(file, shape, dtype)
    _check_blocks(file, array, sums, range(len(sums)))
    return len(sums)


def _map_unchecked(file: Path, shape: tuple[int, ...], dtype: DTypeLike) -> tuple[np.ndarray, np.ndarray]:
    """Return the array of a file, mapped and copied on write, and its stored checksums, uint32 [blocks].

    Only the header (the first PAGE_BYTES) and the length are checked, not the checksums. Raises FileNotFoundError, and
    TerrainError for any other fault.
    """
    dtype = np.dtype(dtype)
    nbytes = int(np.prod(shape, dtype=object)) * dtype.itemsize
    owned_files.check_no_link(file, AGAIN)
    try:
        with open_regular(file) as handle:
            if handle.read(PAGE_BYTES) != header(shape, dtype):
                raise ValueError(f"its header is not that of {dtype} {shape}")
            size = os.fstat(handle.fileno()).st_size
            if size != file_bytes(nbytes):
                raise ValueError(f"it has {size} bytes, expected {file_bytes(nbytes)}")
            handle.seek(PAGE_BYTES + nbytes)
            sums = np.frombuffer(handle.read(), "<u4")
            array = np.memmap(handle, dtype, "c", PAGE_BYTES, shape) if nbytes else np.empty(shape, dtype)
    except FileNotFoundError:
        raise
    except (OSError, ValueError) as reason:
        raise TerrainError(f"{file} is damaged ({cause(reason)})", fix="import the terrain again") from reason
    return array.view(np.ndarray), sums


def _check_blocks(file: Path, array: np.ndarray, sums: np.ndarray, blocks: Sequence[int]) -> None:
    """Raise TerrainError if one of some blocks of an array differs from its checksum. blocks: their numbers.

    sums: stored checksums of all blocks.
    """
    threads = launch.default_threads() if len(blocks) > SAMPLED else 1
    wrong = np.flatnonzero(checksums(array, blocks, threads) != sums[list(blocks)])
    if len(wrong):
        block = blocks[wrong[0]]
        first = PAGE_BYTES + block * BLOCK_BYTES
        last = min(first + BLOCK_BYTES, PAGE_BYTES + array.nbytes) - 1
        more = f", and so do {len(wrong) - 1} more" if len(wrong) > 1 else ""
        raise TerrainError(
            f"{file} is damaged (block {block + 1} of {len(sums)}, bytes {first} to {last}, differs from its "
            f"checksum{more})",
            fix="import the terrain again",
        )
