# SPDX-License-Identifier: GPL-3.0-or-later
"""Drafts of stores with room on the disk."""

import shutil
from collections.abc import Iterator
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
    layers: int = 0,
    elsewhere: str = "choose another folder",
    doubt: str = "",
    is_begun: bool = False,
    by_tile: bool = False,
    sample_bytes: int = 4,
    finer_tiles: int = 0,
) -> Iterator[store.Draft]:
    """Yield a draft of the store at `path`, and remove it after the block unless the block publishes it.

    Raises TerrainError for a disk with too little room, before a byte is written, and for any OSError of the block.

    Args:
        folder: name of the folder for the new arrays; None for a random one.
        layers: number of layers that will be written.
        elsewhere: remedy if no room can be made, in errors.
        doubt: further remedy if the store is implausibly large, in errors.
        is_begun: whether the folder is there, with all arrays.
        by_tile: whether the store is made by tile: this takes less room, and a block that fails leaves what can be
            completed later, unless the disk is the reason.
        sample_bytes: bytes of a sample of a store that is made by tile.
        finer_tiles: number of finer tiles (field/finer_tiles.py) of a store that is made in one piece.
    """
    draft = None
    try:
        if not is_begun:
            needed = work_bytes(lattice, sample_bytes) if by_tile else store_bytes(lattice, layers, finer_tiles)
            _check_room(path, lattice, needed, elsewhere + doubt)
        draft = store.Draft(path, folder, is_begun)
        yield draft
    except OSError as reason:
        by_tile = False  # no work is left on a disk that fails
        raise unwritable(f"The store {path}", reason, elsewhere) from reason
    finally:
        if draft is not None:
            draft.discard_unless_published(with_work=not by_tile)


def work_bytes(lattice: Lattice, sample_bytes: int) -> int:
    """Return the bytes that a store takes on the disk while it is made by tile, with marks of missing samples."""
    samples = (sample_bytes + 1) * lattice.width * lattice.height
    return samples + lattice.node_count * 9 // 8 + 4 * lattice.range_count


def store_bytes(lattice: Lattice, layers: int, finer_tiles: int = 0) -> int:
    """Return the bytes that a store takes on the disk while it is made in one piece.

    layers, finer_tiles: numbers of its layers and finer tiles.
    """
    # Heights are there as float32 and as 16-bit numbers, errors as float32 and as codes.
    raster = (6 + 4 * layers) * lattice.width * lattice.height + 5 * lattice.node_count + 4 * lattice.range_count
    return raster + TILE_BYTES * finer_tiles


def _check_room(path: Path, lattice: Lattice, needed: int, elsewhere: str) -> None:
    """Raise TerrainError if the `needed` bytes of a store are not free on its disk. elsewhere: remedy in the error."""
    existing = next((p for p in (path, *path.absolute().parents) if p.exists()), Path("."))
    free = shutil.disk_usage(existing).free
    if needed > free:
        raise TerrainError(
            f"A terrain of {lattice.width} x {lattice.height} samples needs {_format_bytes(needed)} in {path}, where "
            f"{_format_bytes(free)} are free",
            fix=f"make room or {elsewhere}",
        )


def _format_bytes(count: int) -> str:
    """Return a number of bytes as text, in GB or MB."""
    return f"{count / 1e9:.2f} GB" if count >= 1e9 else f"{count / 1e6:.0f} MB"
