# SPDX-License-Identifier: GPL-3.0-or-later
"""Drafts of stores with room on the disk."""

import math
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import TerrainError, unwritable
from ..field import store
from ..field.finer_tiles import TILE_BYTES
from ..field.lattice import Lattice


@contextmanager
def open_draft(
    path: Path,
    folder: str | None,
    lattice: Lattice,
    needed: int | None,
    elsewhere: str = "choose another folder",
    doubt: str = "",
) -> Iterator[store.Draft]:
    """Yield a draft of the store at `path`, and remove it after the block unless the block publishes it.

    Work of an import that can be continued stays, unless the disk has failed.

    Raises TerrainError for a disk with too little room, before a byte is written, and for any OSError of the block.

    Args:
        folder: name of the folder for the new arrays; None for a random one.
        lattice: grid of the samples, of which errors give the size.
        needed: bytes that the store takes on the disk while it is made; None if the folder is there, with all arrays.
        elsewhere: remedy if no room can be made, in errors.
        doubt: further remedy if the store is implausibly large, in errors.
    """
    draft, with_work = None, False
    try:
        if needed is not None:
            _check_room(path, lattice, needed, elsewhere + doubt)
        draft = store.Draft(path, folder, may_exist=needed is None)
        yield draft
    except OSError as reason:
        with_work = True  # the disk has failed, so the unfinished work is removed, too
        raise unwritable(f"The store {path}", reason, elsewhere) from reason
    finally:
        if draft is not None:
            draft.discard_unless_published(with_work)


def work_bytes(lattice: Lattice, sample_bytes: int) -> int:
    """Return the bytes that an import's store takes on the disk while it is made, with marks of missing samples."""
    samples = (sample_bytes + 1) * lattice.width * lattice.height
    # An error is a byte, with an eighth more for small files, as of tiles' borders. A range is two numbers of 16 bits.
    return samples + lattice.node_count * 9 // 8 + 4 * lattice.range_count


def shaped_bytes(lattice: Lattice, layers: int, finer_tiles: int) -> int:
    """Return the bytes that a store whose heights operators have changed takes on the disk while it is made.

    layers, finer_tiles: numbers of its layers and finer tiles.
    """
    # Heights are there as float32 with marks of holes (4 + 1 bytes), layers as float32, errors as float32 and as codes
    # (4 + 1). A range is two numbers of 16 bits.
    raster = (5 + 4 * layers) * lattice.width * lattice.height + 5 * lattice.node_count + 4 * lattice.range_count
    return raster + TILE_BYTES * finer_tiles


def _check_room(path: Path, lattice: Lattice, needed: int, elsewhere: str) -> None:
    """Raise TerrainError if the `needed` bytes of a store are not free on its disk. elsewhere: remedy in the error."""
    existing = next((p for p in (path, *path.absolute().parents) if p.exists()), Path("."))
    free = shutil.disk_usage(existing).free
    if needed > free:
        raise TerrainError(
            f"A terrain of {lattice.width} x {lattice.height} samples needs {_format_bytes(needed, math.ceil)} in "
            f"{path}, where {_format_bytes(free, math.floor)} are free",
            fix=f"make room or {elsewhere}",
        )


def _format_bytes(count: int, rounded: Callable[[float], int]) -> str:
    """Return a number of bytes as text, in GB or MB. rounded: math.ceil or math.floor, for tenths of the unit."""
    size, unit = (1e9, "GB") if count >= 1e9 else (1e6, "MB")
    return f"{rounded(count / size * 10) / 10:.1f} {unit}"
