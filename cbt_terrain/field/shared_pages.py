# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays in pages that store each run of equal pages once, as over a sea.

Errors and ranges of heights are images in pages of PAGE x PAGE vertices (lattice.py). Over seas and lakes, which are
level, and in gaps most pages of a row are equal. A table finds the stored page of each page:

    NAME_pages.npy    the stored pages, one after the other
    NAME_places.npy   int32: for each page of the array the number of its stored page

Both are mapped. Kernels look an entry up by `stored_entry` (kernels/field/layout.py); an array without a table costs
them one comparison.
"""

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike

from ..errors import TerrainError
from ..run import owned_files
from ..run.buffers import flat, shared
from .lattice import PAGE
from .store_arrays import (
    AGAIN,
    CAN_REMOVE_MAPPED,
    allocate_array,
    append_checksums,
    map_array,
    release_pages,
    verify_array,
    write_array,
)

if TYPE_CHECKING:
    import warp as wp

ENTRIES = PAGE * PAGE  # of a page
NAMES = ("error", "ranges")  # arrays of a store that may have a table
PARTS = ("pages", "places")  # files of such an array: NAME_PART.npy
# Pages are shared if that saves this many bytes and this fraction of the array.
MIN_SAVED, MIN_FRACTION = 1 << 20, 0.25
SPARE_BYTES = 1 << 24  # of a disk that stay free for what is written after the pages
READ_PAGES = 4096  # that are read at once


@dataclass(frozen=True, eq=False)
class SharedPages:
    """An array that is read like a numpy array, by slices without a step and by arrays of entries, as a copy.

    Attributes:
        stored: the stored pages, [pages * ENTRIES, ...].
        places: int32, the number of the stored page for each page of the array.
    """

    stored: np.ndarray
    places: np.ndarray

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape of the whole array."""
        return len(self.places) * ENTRIES, *self.stored.shape[1:]

    @property
    def dtype(self) -> np.dtype:
        """Return the type of the entries."""
        return self.stored.dtype

    @property
    def nbytes(self) -> int:
        """Return the bytes of the stored pages and of the table."""
        return self.stored.nbytes + self.places.nbytes

    def __len__(self) -> int:
        return len(self.places) * ENTRIES

    def __getitem__(self, index: slice | np.ndarray) -> np.ndarray:
        if isinstance(index, slice):
            first, end, step = index.indices(len(self))
            if step != 1:
                raise IndexError(f"shared pages have no slices with the step {step}")
            pages = _pages_of(self.stored)[self.places[first // ENTRIES : -(-end // ENTRIES)]]
            return pages.reshape(-1, *self.shape[1:])[first % ENTRIES :][: max(end - first, 0)]
        return self.stored[self.places[index // ENTRIES].astype(np.int64) * ENTRIES + index % ENTRIES]

    def __array__(self, dtype: DTypeLike = None, copy: bool | None = None) -> np.ndarray:
        return self[:].astype(dtype or self.dtype, copy=False)


Paged = np.ndarray | SharedPages  # an array of pages, with a table or without


def parts_of(array: Paged) -> list[np.ndarray]:
    """Return the arrays in memory of an array of pages."""
    return [array.stored, array.places] if isinstance(array, SharedPages) else [array]


def stored_from(array: Paged, first: int) -> np.ndarray:
    """Return a view of the stored entries of an array from an entry on: each shared page once.

    first: a multiple of ENTRIES below the array's length.
    """
    if isinstance(array, SharedPages):
        return array.stored[int(array.places[first // ENTRIES]) * ENTRIES :]  # the numbers never fall
    return array[first:]


def image_pages(array: Paged, entries: slice, pages: int, y: slice, x: slice) -> np.ndarray:
    """Return some pages of an image in an array, [rows, columns, ENTRIES, ...]: a view, or a copy of shared pages.

    entries: those of the image. pages: in a row of it. y, x: rows and columns of pages.
    """
    if isinstance(array, SharedPages):
        places = array.places[entries.start // ENTRIES : entries.stop // ENTRIES]
        return _pages_of(array.stored)[places.reshape(-1, pages)[y, x]]
    return array[entries].reshape(-1, pages, ENTRIES, *array.shape[1:])[y, x]


def pack_pages(array: Paged, dtype: Any) -> tuple["wp.array", "wp.array"]:
    """Return an array of pages and its table as kernels read them; the table is empty if no pages are shared.

    dtype: of Warp. Memory is shared.
    """
    from ...kernels import wp

    if isinstance(array, SharedPages):
        return flat(array.stored, dtype), shared(array.places, wp.int32)
    return flat(array, dtype), shared(np.empty(0, np.int32), wp.int32)


def read_into(array: Paged, out: np.ndarray) -> None:
    """Copy all entries of an array of pages into another array, some pages at a time."""
    for first in range(0, len(array), READ_PAGES * ENTRIES):
        out[first : first + READ_PAGES * ENTRIES] = array[first : first + READ_PAGES * ENTRIES]


def share_pages(folder: Path, name: str, array: np.ndarray) -> bool:
    """Write the pages and the table of a store's array, if that saves enough; return whether it does.

    array: the whole pages, mapped from NAME.npy in the folder. That file stays until the store is published, so that an
    import that is killed can be continued. Nothing is shared where the file could not be removed then, nor on a disk
    that the pages would fill. Raises OSError.
    """
    for part in PARTS:
        owned_files.remove_file(folder / f"{name}_{part}.npy")  # of an import that was killed
    if not CAN_REMOVE_MAPPED or not len(array):
        return False
    places, stored = _find_places(array)
    saved = array.nbytes * (1 - len(stored) / len(places)) - places.nbytes
    if saved < max(MIN_SAVED, MIN_FRACTION * array.nbytes):
        return False
    file, pages = folder / f"{name}_pages.npy", _pages_of(array)
    if shutil.disk_usage(folder).free < len(stored) * pages[0].nbytes + places.nbytes + SPARE_BYTES:
        return False
    try:
        out = allocate_array(file, (len(stored) * ENTRIES, *array.shape[1:]), array.dtype)
        for first in range(0, len(stored), READ_PAGES):
            _pages_of(out)[first : first + READ_PAGES] = pages[stored[first : first + READ_PAGES]]
        append_checksums(file, out)
        write_array(folder / f"{name}_places.npy", places)
    except OSError:
        owned_files.remove_file(file)
        return False
    return True


def _pages_of(array: np.ndarray) -> np.ndarray:
    """Return a view of an array of pages, [pages, ENTRIES, ...]."""
    return array.reshape(-1, ENTRIES, *array.shape[1:])


def _find_places(array: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of the stored page of each page, int32, and the pages that are stored, int64."""
    pages = array.reshape(len(array) // ENTRIES, -1).view(np.uint64)
    is_stored = np.ones(len(pages), bool)
    for first in range(1, len(pages), READ_PAGES):
        part = pages[first - 1 : first + READ_PAGES]  # with the page before
        is_stored[first : first + READ_PAGES] = (part[1:] != part[:-1]).any(axis=1)
        release_pages(array)
    return (np.cumsum(is_stored) - 1).astype(np.int32), np.flatnonzero(is_stored)


def has_shared_pages(folder: Path, name: str) -> bool:
    """Return whether a folder has an array of a store as shared pages alone."""
    return os.path.lexists(folder / f"{name}_places.npy") and not os.path.lexists(folder / f"{name}.npy")


def map_pages(folder: Path, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> SharedPages:
    """Map the stored pages and the table of an array of this shape and type.

    The whole table is checked, since kernels read by it. Raises FileNotFoundError, and TerrainError for another fault.
    """
    file = folder / f"{name}_places.npy"
    places = map_array(file, (shape[0] // ENTRIES,), np.int32)
    steps = np.diff(places, prepend=np.int32(-1))
    # Each page is the stored one before or the next one.
    is_valid = len(steps) > 0 and steps[0] == 1 and ((steps == 0) | (steps == 1)).all()
    if not is_valid:
        raise TerrainError(f"{file} is damaged (its numbers do not rise by 0 or 1)", fix=AGAIN)
    count = int(places[-1]) + 1  # of stored pages
    return SharedPages(map_array(folder / f"{name}_pages.npy", (count * ENTRIES, *shape[1:]), dtype), places)


def verify_pages(folder: Path, name: str, shape: tuple[int, ...], dtype: DTypeLike) -> dict[str, int]:
    """Check all checksums of an array with shared pages; return the number of blocks by file. Raises as `map_pages`."""
    array = map_pages(folder, name, shape, dtype)
    files = {f"{name}_pages.npy": array.stored, f"{name}_places.npy": array.places}
    return {file: verify_array(folder / file, part.shape, part.dtype) for file, part in files.items()}
