# SPDX-License-Identifier: GPL-3.0-or-later
"""One array of a store as a file: a .npy whose header is a page long, and behind the data a checksum for every block.

    a page    the header of a .npy file, always the same bytes for one shape and dtype: it is compared, never parsed
    data      in C order, little endian
    checksums uint32, crc32 of every BLOCK_BYTES of the data; numpy's own readers do not look at them

Checksums find what a disk or a copy has damaged. Who writes damage on purpose writes checksums that fit: that nothing
in a store makes a kernel leave its arrays is seen to in the kernels.
"""

import mmap
import os
import struct
import zlib
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..run import launch, owned_files, partial_files
from ..run.named_file import cause, open_regular

PAGE_BYTES = 4096
BLOCK_BYTES = 1 << 18
# Blocks of each array that are checked when it is opened: the first, the last, and evenly between. 4 x 0.1 ms.
SAMPLED = 4

AGAIN = "import or shape the terrain again"


def header(shape: tuple[int, ...], dtype) -> bytes:
    """The header of a .npy file, as long as a page of memory, so that a page of the hierarchy is one (layout.py)."""
    plain = {"descr": np.lib.format.dtype_to_descr(np.dtype(dtype)), "fortran_order": False, "shape": tuple(shape)}
    magic = np.lib.format.magic(1, 0)
    text = repr(plain).encode().ljust(PAGE_BYTES - len(magic) - 3) + b"\n"
    return magic + struct.pack("<H", len(text)) + text


def block_count(nbytes: int) -> int:
    return -(-nbytes // BLOCK_BYTES)


def file_bytes(nbytes: int) -> int:
    """Size of the file of an array of so many bytes."""
    return PAGE_BYTES + nbytes + 4 * block_count(nbytes)


def checksums(array: np.ndarray, blocks, threads: int = 1) -> np.ndarray:
    """uint32 [len(blocks)]: the checksums of these blocks of a contiguous array."""
    data, found = memoryview(array.reshape(-1).view(np.uint8)), np.zeros(len(blocks), np.uint32)

    def sum_up(first: int) -> None:
        for k in range(first, len(blocks), threads):
            found[k] = zlib.crc32(data[blocks[k] * BLOCK_BYTES : (blocks[k] + 1) * BLOCK_BYTES])

    launch.together([partial(sum_up, first) for first in range(threads)])
    return found


def all_checksums(array: np.ndarray) -> bytes:
    """What stands behind the data."""
    threads = launch.default_threads()
    return checksums(array, range(block_count(array.nbytes)), threads).astype("<u4").tobytes()


def write_array(file: Path, array: np.ndarray) -> None:
    """Write a contiguous array as such a file, which stands there when it is complete. Raises OSError."""
    with partial_files.written_beside(file) as partial, partial.open("wb") as handle:
        handle.write(header(array.shape, array.dtype))
        array.tofile(handle)
        handle.write(all_checksums(array))


def map_array(file: Path, shape: tuple[int, ...], dtype) -> np.ndarray:
    """Map an array copy-on-write: kernels take it as an ordinary array, and nothing can change the file.

    Some of its blocks are checked. Raises FileNotFoundError, and TerrainError for any other fault. A walk takes single
    pages: what the system would read ahead of them is ten times as much as it needs.
    """
    array, sums = _mapped(file, shape, dtype)
    count = len(sums)
    sample = sorted({k * (count - 1) // (SAMPLED - 1) for k in range(SAMPLED)}) if count else []
    _check(file, array, sums, sample)
    if count and hasattr(mmap, "MADV_RANDOM"):
        array.base._mmap.madvise(mmap.MADV_RANDOM)
    return array


def is_cut_off(array: np.ndarray) -> bool:
    """Whether the file of a mapped array has lost its end since: the system kills who reads there (SIGBUS)."""
    mapped = getattr(array.base, "_mmap", None)
    return mapped is not None and mapped.size() < PAGE_BYTES + array.nbytes


def verify_array(file: Path, shape: tuple[int, ...], dtype) -> int:
    """Check every block; returns how many there are. Raises as `map_array`."""
    array, sums = _mapped(file, shape, dtype)
    _check(file, array, sums, range(len(sums)))
    return len(sums)


def _mapped(file: Path, shape: tuple[int, ...], dtype) -> tuple[np.ndarray, np.ndarray]:
    """The array and its checksums, uint32, as the file has them."""
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
        raise TerrainError(f"{file} is damaged ({cause(reason)}): import the terrain again.") from reason
    return array.view(np.ndarray), sums


def _check(file: Path, array: np.ndarray, sums: np.ndarray, blocks) -> None:
    """Raise TerrainError unless these blocks of an array are what was written."""
    threads = launch.default_threads() if len(blocks) > SAMPLED else 1
    wrong = np.flatnonzero(checksums(array, blocks, threads) != sums[list(blocks)])
    if len(wrong):
        block = blocks[wrong[0]]
        first = PAGE_BYTES + block * BLOCK_BYTES
        last = min(first + BLOCK_BYTES, PAGE_BYTES + array.nbytes) - 1
        more = f", and so do {len(wrong) - 1} more" if len(wrong) > 1 else ""
        raise TerrainError(
            f"{file} is damaged (block {block + 1} of {len(sums)}, bytes {first} to {last}, differs from its "
            f"checksum{more}): import the terrain again."
        )
