# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights of tiles that are read ahead of the import that loads them, by other computers of a farm.

Each tile has its own file in the store, so computers that share only a disk never write to one file. A file begins
with the record of the tile, as an import by tile writes it (tiling/tile_records.py), which names the sources and has
a checksum of the heights; these follow as float32. The import reads a tile itself if its file is missing or damaged.
"""

import time
import zlib
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import unwritable
from ..field.store_folder import AHEAD, is_ahead_name
from ..run import owned_files, partial_files
from ..run.named_file import read_regular
from ..tiling.tile_grid import TileGrid
from ..tiling.tile_records import READ, line_of, record_of

MAX_RECORD = 1 << 20  # bytes, far more than a record has


class TileAhead(NamedTuple):
    """A tile that was read: its record, and its heights, float32 metres in the order of the terrain."""

    record: dict
    heights: np.ndarray


def write_ahead(store: Path, grid: TileGrid, number: int, record: dict, heights: np.ndarray) -> None:
    """Write the heights of a tile to its own file, from which a later import reads them. Raises TerrainError.

    The file appears when it is complete. record: inputs, missing, limits and figures of the tile. heights: float32, NaN
    where missing. number: of the tile.
    """
    content = np.ascontiguousarray(heights, "<f4").tobytes()
    line = line_of({"kind": READ, "number": number, "at": time.time_ns(), **record, "heights": zlib.crc32(content)})
    assert record_of(line.encode()[:-1], grid) is not None, "it can be read again"
    file = _file_of(store, number)
    try:
        with owned_files.open_folder(file.parent, make=True):  # only makes the folder
            pass
        with partial_files.written_beside(file) as partial:
            partial.write_bytes(line.encode() + content)
    except OSError as reason:
        raise unwritable(f"The store {store}", reason) from reason


def find_ahead(store: Path, grid: TileGrid, number: int, inputs: str) -> TileAhead | None:
    """Return a tile that was read before the import, from its file.

    Return None if the file is missing, damaged or of other sources. inputs: digest of the sources. number: of the tile.
    """
    shape = grid.owned(grid.box(number)).shape
    try:
        data = read_regular(_file_of(store, number), MAX_RECORD + 4 * shape[0] * shape[1], links=False)
    except (OSError, ValueError):
        return None
    line, _, content = data.partition(b"\n")
    record = record_of(line, grid)
    if record is None or (record["kind"], record["number"], record["inputs"]) != (READ, number, inputs):
        return None
    if len(content) != 4 * shape[0] * shape[1] or zlib.crc32(content) != record.get("heights"):
        return None
    return TileAhead(record, np.frombuffer(content, "<f4").astype(np.float32, copy=False).reshape(shape))


def remove_ahead(store: Path) -> None:
    """Remove the files of all tiles that were read ahead, and their folder if it is empty then."""
    with suppress(OSError):
        owned_files.remove_entries(store / AHEAD, is_ahead_name)
        partial_files.remove_abandoned(store / AHEAD)
        owned_files.remove_empty(store / AHEAD)


def share_of(tiles: Iterable[int], part: int, parts: int) -> tuple[int, ...]:
    """Return the tiles of one of several parts of about equal size. part: 1 .. parts."""
    return tuple(sorted(tiles))[part - 1 :: parts]


def _file_of(store: Path, number: int) -> Path:
    """Return the file in which the tile with a number is kept before the import needs it."""
    return store / AHEAD / f"{number}.tile"
