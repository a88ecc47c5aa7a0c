# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of a farm's tasks in separate files, until one process writes them into the arrays of a work.

Computers that map one array on a network disk write whole pages of memory back, also the bytes in them that another
computer has written meanwhile. Tiles share pages: rows of samples are longer than a tile. So no two tasks that may run
at the same time write to one file.

    blocks     the bytes of arrays, one after the other
    record     a line of tile_records.py; its "blocks" are [name, place, shape, checksum] of each array
    length     of the record, 8 bytes
"""

import math
import os
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from ..run import owned_files, partial_files
from ..run.named_file import open_regular
from .tile_grid import TileGrid
from .tile_records import line_of, record_of

MAX_RECORD = 1 << 28  # bytes
LENGTH_BYTES = 8
TYPES = {"heights": "<f4", "codes": "|u1", "border": "|u1", "ranges": "<u2"}  # of blocks, by name


class Block(NamedTuple):
    """An array of a part, and where it belongs: the first sample (x, y) of heights, (0, 0) for others."""

    name: str
    place: tuple[int, int]
    values: np.ndarray


class PartWriter:
    """Writer of the file of a part. Set `record` before it ends: the record without kind, number and time."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self.blocks = file, list[list]()
        self.record: dict[str, Any] = {}

    def add(self, name: str, place: tuple[int, int], values: np.ndarray) -> None:
        """Write an array. name: one of TYPES. place: the first sample (x, y) of heights, (0, 0) for others."""
        content = np.ascontiguousarray(values, TYPES[name]).tobytes()
        self._file.write(content)
        self.blocks.append([name, list(place), list(values.shape), zlib.crc32(content)])


@contextmanager
def writing_part(folder: Path, kind: str, number: int) -> Iterator[PartWriter]:
    """Yield the writer of a part: the file with the results of one task.

    The file appears when the block has ended without an error. kind, number: of the task, as in its record
    (tile_records.py). Raises OSError.
    """
    with partial_files.written_beside(_file_of(folder, kind, number)) as partial, partial.open("wb") as file:
        writer = PartWriter(file)
        yield writer
        # "at" is the time at which other records were written; a part has none.
        line = line_of({"kind": kind, "number": number, "at": 0, **writer.record, "blocks": writer.blocks}).encode()
        file.write(line + len(line).to_bytes(LENGTH_BYTES, "little"))


def find_record(folder: Path, grid: TileGrid, kind: str, number: int) -> dict | None:
    """Return the record of a part that has a file in `folder`; None without one, and for a damaged one.

    grid: tiles of the terrain, to check the record. kind, number: of the part, as in the record.
    """
    try:
        with open_regular(_file_of(folder, kind, number)) as file:
            end = file.seek(-LENGTH_BYTES, os.SEEK_END)
            length = int.from_bytes(file.read(LENGTH_BYTES), "little")
            if not 0 < length <= min(end, MAX_RECORD):
                return None
            file.seek(end - length)
            record = record_of(file.read(length)[:-1], grid)
    except (OSError, ValueError):
        return None
    if record is None or (record["kind"], record["number"]) != (kind, number):
        return None
    return record if _is_whole(record.get("blocks"), end - length) else None


def _is_whole(blocks: object, nbytes: int) -> bool:
    """Return whether the blocks of a record fill a file up to its record, each a (name, place, shape, checksum).

    place: two numbers, where the array belongs. nbytes: bytes before the record.
    """
    try:
        total = 0
        for name, place, shape, checksum in blocks:  # type: ignore[attr-defined]
            numbers = [*place, *shape, checksum]
            if len(place) != 2 or not all(type(number) is int and 0 <= number < 1 << 48 for number in numbers):
                return False
            total += math.prod(shape) * np.dtype(TYPES[name]).itemsize
        return total == nbytes
    except (TypeError, ValueError, KeyError):
        return False


def blocks_of(folder: Path, record: dict) -> Iterator[Block]:
    """Yield the arrays of a part of `find_record`. Raises ValueError for a damaged one, and OSError."""
    with open_regular(_file_of(folder, record["kind"], record["number"])) as file:
        for name, place, shape, checksum in record["blocks"]:
            kind = np.dtype(TYPES[name])
            content = file.read(math.prod(shape) * kind.itemsize)
            if zlib.crc32(content) != checksum:
                raise ValueError(f"the {name} of part {record['number']} differ from their checksum")
            yield Block(name, (place[0], place[1]), np.frombuffer(content, kind).reshape(shape))


def numbers_of(folder: Path, kind: str) -> list[int]:
    """Return the numbers of the parts of a kind that have a file, in ascending order."""
    names = (file.name.removeprefix(f"{kind}-").removesuffix(".part") for file in folder.glob(f"{kind}-*.part"))
    return sorted(int(number) for number in names if number.isdecimal())


def remove_parts(folder: Path, kind: str) -> None:
    """Remove the files of all parts of a kind."""
    for number in numbers_of(folder, kind):
        with suppress(FileNotFoundError):
            owned_files.remove_file(_file_of(folder, kind, number))


def _file_of(folder: Path, kind: str, number: int) -> Path:
    """Return the file of a part. folder: of the work. kind, number: of the task."""
    return folder / f"{kind}-{number}.part"
