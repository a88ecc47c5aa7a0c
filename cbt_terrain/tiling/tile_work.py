# SPDX-License-Identifier: GPL-3.0-or-later
"""The arrays of a store while they are made by tile, by several processes and in several attempts.

    work.json             the terrain, its digest and its tiles; without it the work cannot be continued
    samples.npy, error.npy, ranges.npy    as in a store (store.py)
    missing.npy           uint8 [height, width], 1 at missing samples; a sparse file, removed after publishing
    borders.npy           uint8 [tiles, 2, n]: codes near the tiles' borders, and kinds of cells; kept with work.json
    finer_*.npy           of finer tiles, if the source has some
    read-*.part, measured-*.part    results of a farm's tasks until they are joined (part_files.py)
    tiles-*.jsonl         records of finished parts (tile_records.py); each process writes its own file
    tiles.jsonl           all records, kept with work.json

A part is a tile that is measured, or a unit of samples that are read at once. It is finished when its record is
written, so a killed process loses one part. Every array is mapped anew for each part, because its pages count as memory
of the process.
"""

import functools
import hashlib
import json
import math
import os
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from ..errors import TerrainError
from ..field import codes, store_folder
from ..field.lattice import TileBox, lattice_for
from ..field.shared_pages import Paged, has_shared_pages, map_pages, read_into, verify_pages
from ..field.store import Draft
from ..field.store_arrays import BLOCK_BYTES, PAGE_BYTES, allocate_array, file_bytes, header, verify_array
from ..run import owned_files, partial_files
from ..run.named_file import open_regular, read_regular, read_start
from .tile_grid import TILE_BITS, TileGrid
from .tile_records import FINER, MEASURED, READ, SEAMS, line_of, record_of

VERSION = 3
STORED = ("samples", "error", "ranges", "borders")
RECORDS_NAME, PREFIX = "tiles.jsonl", "tiles-"
MAX_RECORDS = 1 << 30  # bytes
COPIED_ROWS = 256  # of one mapping: Linux maps up to 2 MB of a file around each row that is read


class NotNumberedError(Exception):
    """A height is no number of the source's steps, so all heights have to be stored as floats."""


@dataclass
class TileWork:
    """A folder of arrays while a store is made by tile.

    Attributes:
        digest: hash of all settings and sources.
        steps: first value, scale and offset of stored 16-bit samples; None for float32.
        holes: whether missing samples are cut out.
        corner: samples along x and y from the origin of the coordinate system to the south-western sample of a mosaic;
            None for another raster.
    """

    folder: Path
    grid: TileGrid
    steps: codes.Steps | None
    holes: bool
    digest: str
    corner: tuple[float, float] | None = None

    def arrays(self) -> dict[str, tuple[tuple, DTypeLike]]:
        """Return shapes and types of the arrays by name.

        They are the files above, and "kinds", those of cells (ground, hole) while borders are joined.
        """
        lattice = self.grid.lattice
        shape = lattice.height, lattice.width
        return {
            "samples": (shape, np.float32 if self.steps is None else np.uint16),
            "error": ((lattice.node_count,), np.uint8),
            "ranges": ((lattice.range_count, 2), np.uint16),
            "borders": ((len(self.grid), 2, len(self.grid.near_border.x)), np.uint8),
            "missing": (shape, np.uint8),
            "kinds": ((lattice.node_count,), np.uint8),
        }

    def attach(self, draft: Draft) -> None:
        """Allocate those arrays of the store that are missing in the folder, as arrays of the draft there."""
        for name in STORED:
            draft.allocate(name, *self.arrays()[name])

    def can_be_continued(self) -> bool:
        """Return whether an import may go on to write in the folder: all arrays are there, and no file is a hard link.

        Raises OSError.
        """
        files = [entry for entry in self.folder.iterdir() if owned_files.is_real_file(entry)]
        return self.has_array("missing") and all(os.lstat(file).st_nlink <= 1 for file in files)

    def describe(self) -> None:
        """Write the file that describes the terrain and its tiles. From now on a later import can continue the work."""
        lattice = self.grid.lattice
        content = {
            "version": VERSION,
            "digest": self.digest,
            "bits": self.grid.bits,
            "holes": self.holes,
            "steps": self.steps and [self.steps.first, self.steps.scale, self.steps.offset],
            "lattice": [lattice.width, lattice.height, lattice.step_x, lattice.step_y],
            "corner": self.corner,
        }
        self._write(store_folder.WORK_NAME, json.dumps(content | {"sum": _sum_of(content)}))

    @property
    def is_described(self) -> bool:
        """Return whether the folder has that description. An import of a single tile has none, since it is short."""
        return os.path.lexists(self.folder / store_folder.WORK_NAME)

    def start_again(self, draft: Draft) -> None:
        """Forget all records and the stored samples, and store heights as floats from now on.

        draft: the unpublished version of the store, whose folder holds the arrays.
        """
        was_described = self.is_described
        owned_files.remove_file(self.folder / store_folder.WORK_NAME)
        self.remove_records()
        draft.remove("samples")
        self.steps = None
        self.attach(draft)  # allocates the samples again
        self.make_sparse("missing")
        if was_described:
            self.describe()

    def remove_records(self) -> None:
        """Remove the records of all parts."""
        for file in self.folder.glob(f"{PREFIX[:-1]}*.jsonl"):
            owned_files.remove_file(file)

    def copy(self, before: "TileWork", units: int) -> None:
        """Copy the arrays and records of an earlier version with the same tiles; nothing if any of them is damaged.

        Two kinds of records are left out: those of units with gaps, because a store does not mark filled samples, and
        those with a number from `units` on, which the source of this work does not have. Raises OSError.

        before: the earlier version. units: the number of units in which the source of this work is read.
        """
        is_whole = False
        try:
            is_whole = before.has_whole_records() and all(self._copy_array(before, name) for name in STORED)
            if is_whole:
                read = before.records(READ).values()
                records = [record for record in read if not record["missing"] and record["number"] < units]
                self.write_records([*records, *before.records(MEASURED).values()])
        finally:
            for name in () if is_whole else STORED:
                with suppress(FileNotFoundError):
                    self.remove(name)

    def has_whole_records(self) -> bool:
        """Return whether the checksum of a store's records holds. Raises OSError."""
        text = read_regular(self.folder / RECORDS_NAME, MAX_RECORDS, links=False)
        first, _, rest = text.partition(b"\n")
        return first == _sum_line(rest)

    def write_records(self, records: Sequence[dict]) -> None:
        """Write the first records of a new work."""
        self._write(RECORDS_NAME, _lines(records))

    def _copy_array(self, before: "TileWork", name: str) -> bool:
        """Copy an array of a published store, and return whether its checksums hold."""
        shape, dtype = self.arrays()[name]
        if has_shared_pages(before.folder, name):
            before.verify(name)
            read_into(before.published(name), allocate_array(self.folder / f"{name}.npy", shape, dtype))
            return True
        nbytes, sums = int(np.prod(shape)) * np.dtype(dtype).itemsize, []
        file = f"{name}.npy"
        with open_regular(before.folder / file) as reader, (self.folder / file).open("wb") as writer:
            writer.write(reader.read(PAGE_BYTES))  # the header
            for first in range(0, nbytes, BLOCK_BYTES):
                block = reader.read(min(BLOCK_BYTES, nbytes - first))
                sums.append(zlib.crc32(block))
                writer.write(block)
            stored = reader.read()  # the checksums, which follow the array
            writer.write(stored)
        return stored == np.array(sums, "<u4").tobytes()

    def _write(self, name: str, text: str) -> None:
        """Write a file that appears when it is complete."""
        partial = self.folder / f"{PREFIX}{partial_files.new_token()}.jsonl"
        partial.write_text(text, encoding="utf-8")
        os.replace(partial, self.folder / name)

    def make_sparse(self, name: str) -> None:
        """Make a file of zeros that takes room only where something else is written."""
        shape, dtype = self.arrays()[name]
        with suppress(FileNotFoundError):
            self.remove(name)
        with (self.folder / f"{name}.npy").open("xb") as file:
            file.write(header(shape, dtype))
            file.truncate(file_bytes(int(np.prod(shape)) * np.dtype(dtype).itemsize))

    def has_array(self, name: str) -> bool:
        """Return whether the file of an array has the header and the size of one. Raises OSError."""
        return self._is_array(name, *self.arrays()[name])

    def allocate(self, draft: Draft, name: str, shape: tuple, dtype: DTypeLike) -> np.ndarray:
        """Allocate an array of a draft in the same folder; the array of an earlier attempt is used if it fits."""
        if os.path.lexists(self.folder / f"{name}.npy") and not self._is_array(name, shape, dtype):
            self.remove(name)
        return draft.allocate(name, shape, dtype)

    def _is_array(self, name: str, shape: tuple, dtype: DTypeLike) -> bool:
        """Return whether the file `name` has the header and the size of an array. Raises OSError."""
        file = self.folder / f"{name}.npy"
        size = file_bytes(math.prod(shape) * np.dtype(dtype).itemsize)
        if not owned_files.is_real_file(file) or os.lstat(file).st_size != size:
            return False
        return read_start(file, PAGE_BYTES, links=False) == header(shape, dtype)

    def remove(self, name: str) -> None:
        """Remove the file of an array."""
        owned_files.remove_file(self.folder / f"{name}.npy")

    def open(self, name: str) -> np.ndarray:
        """Map an array for reading and writing."""
        shape, dtype = self.arrays()[name]
        if not all(shape):
            return np.zeros(shape, dtype)
        file = os.fspath(self.folder / f"{name}.npy")  # numpy would resolve all links of a Path, 0.1 ms
        return np.memmap(file, dtype, "r+", PAGE_BYTES, shape).view(np.ndarray)

    def verify(self, name: str) -> None:
        """Raise TerrainError if an array of a published store is damaged. Its pages may be shared."""
        if has_shared_pages(self.folder, name):
            verify_pages(self.folder, name, *self.arrays()[name])
        else:
            verify_array(self.folder / f"{name}.npy", *self.arrays()[name])

    def published(self, name: str) -> Paged:
        """Map an array of a published store for reading. Its pages may be shared."""
        is_shared = has_shared_pages(self.folder, name)
        return map_pages(self.folder, name, *self.arrays()[name]) if is_shared else self.open(name)

    def raw(self, name: str, box: TileBox) -> np.ndarray:
        """Return a part of an array as a copy: stored samples or marks of missing ones, the last of the box included.

        name: "samples" or "missing". The array is mapped anew for each COPIED_ROWS rows, so that few pages are held.
        """
        copied = np.empty(box.shape, self.arrays()[name][1])
        for row in range(0, len(copied), COPIED_ROWS):
            part, y = copied[row : row + COPIED_ROWS], box.y0 + row
            part[:] = self.open(name)[y : y + len(part), box.x0 : box.x1 + 1]
        return copied

    def border(self, number: int, kind: int) -> np.ndarray:
        """Return what was measured near the border of a tile, uint8, in the order of `TileGrid.near_border`.

        kind: 0 for codes of errors, 1 for kinds of cells (ground, hole).
        """
        return self.open("borders")[number, kind].copy()

    def decoded(self, samples: np.ndarray) -> np.ndarray:
        """Return heights, float32 metres, of stored samples."""
        return samples if self.steps is None else self.steps.heights(samples)

    def height(self, samples: np.ndarray, x: int, y: int) -> float:
        """Return the height at a vertex of the lattice: beyond the border that of the nearest sample.

        samples: the mapped array.
        """
        x, y = min(x, self.grid.lattice.cells_x), min(y, self.grid.lattice.cells_y)
        return float(self.decoded(samples[y : y + 1, x : x + 1])[0, 0])

    def write_heights(self, x: int, y: int, heights: np.ndarray) -> list[float]:
        """Store heights, float32 [rows, columns] with NaN where missing, from sample (x, y) on.

        Missing ones are marked in the array "missing"; their stored height has no meaning. Return the lowest and the
        highest, or [] without any. Raises NotNumberedError if `steps` cannot store a height exactly.
        """
        missing = np.isnan(heights)
        has_gaps = bool(missing.any())
        known = heights[~missing] if has_gaps else heights
        if has_gaps:
            heights = np.where(missing, known[0] if known.size else np.float32(0.0), heights)
        stored = heights
        if self.steps is not None:
            stored = np.zeros(heights.shape, np.uint16)
            if known.size and not codes.number(heights, self.steps, stored):
                raise NotNumberedError
        area = slice(y, y + heights.shape[0]), slice(x, x + heights.shape[1])
        self.open("samples")[area] = stored
        if has_gaps or self.open("missing")[area].any():  # of an earlier attempt
            # Into the file, since a full disk ends a process that writes to the mapping of a sparse one.
            with (self.folder / "missing.npy").open("r+b") as file:
                for row, marks in enumerate(missing, y):
                    file.seek(PAGE_BYTES + row * self.grid.lattice.width + x)
                    file.write(marks.tobytes())
        return [float(known.min()), float(known.max())] if known.size else []

    def note(self, kind: str, number: int, **values: Any) -> None:
        """Write the record of a finished part, a unit or a tile, as a line of this process's file.

        kind: READ, MEASURED or another kind. number: of the part. values: the record's content.
        """
        line = line_of({"kind": kind, "number": number, "at": time.time_ns(), **values})
        with (self.folder / _log_name()).open("a", encoding="utf-8") as file:
            file.write(line)

    def records(self, kind: str, number: int | None = None) -> dict[int, dict]:
        """Return the last record of each part by its number.

        kind: READ for units, MEASURED for tiles, and others. number: of the only part; None for all parts.
        """
        # Only lines with these bytes are parsed.
        marks = [f'"{kind}"'.encode()] if number is None else [f'"{kind}"'.encode(), b'"number": %d,' % number]
        latest: dict[int, dict] = {}
        for record in sorted(self._records_with(marks), key=lambda record: record["at"]):
            if record["kind"] == kind:
                latest[record["number"]] = record
        return latest

    def _records_with(self, marks: list[bytes]) -> Iterator[dict]:
        """Yield the whole records of all processes that worked on tiles; damaged lines are left out.

        marks: bytes that the lines have. The other lines are not parsed, which takes most of the time.
        """
        for file in self.folder.glob(f"{PREFIX[:-1]}*.jsonl"):  # without the hyphen, to find tiles.jsonl, too
            for line in read_regular(file, MAX_RECORDS, links=False).split(b"\n"):
                if all(mark in line for mark in marks) and (record := record_of(line, self.grid)) is not None:
                    yield record

    def keep_records(self) -> None:
        """Replace all files of records by one, with the last record of each part."""
        files = [*self.folder.glob(f"{PREFIX}*.jsonl")]
        lines = _lines([record for kind in (READ, MEASURED, *FINER, SEAMS) for record in self.records(kind).values()])
        self._write(RECORDS_NAME, f"{_sum_line(lines.encode()).decode()}\n{lines}")
        for file in files:
            owned_files.remove_file(file)


@functools.cache
def _log_name() -> str:
    """Return the name of this process's file of records."""
    return f"{PREFIX}{partial_files.new_token()}.jsonl"


def _sum_line(lines: bytes) -> bytes:
    """Return the first line of the records of a store: a checksum of the others."""
    return json.dumps({"sum": hashlib.blake2b(lines, digest_size=16).hexdigest()}).encode()


def _lines(records: Sequence[dict]) -> str:
    """Return records as text, one JSON line each."""
    return "".join(map(line_of, records))


def _sum_of(content: dict) -> str:
    """Return the checksum of a work's description, a hex digest."""
    return hashlib.blake2b(json.dumps(content, sort_keys=True).encode(), digest_size=16).hexdigest()


def work_in(folder: Path) -> TileWork | None:
    """Return the work in a folder of arrays; None if there is none that can be used."""
    try:
        content = json.loads(read_regular(folder / store_folder.WORK_NAME, 1 << 16, links=False))
        if content["version"] != VERSION or content.pop("sum") != _sum_of(content):
            return None
        width, height, step_x, step_y = content["lattice"]
        lattice = lattice_for(int(width), int(height), float(step_x), float(step_y))
        bits, holes, digest = content["bits"], content["holes"], content["digest"]
        steps = codes.Steps(*content["steps"]) if content["steps"] else None
        if (type(bits), type(holes), type(digest)) != (int, bool, str) or not 0 < bits <= TILE_BITS:
            return None
        corner = None if content.get("corner") is None else tuple(map(float, content["corner"]))
        if corner is not None and len(corner) != 2:
            return None
        work = TileWork(folder, TileGrid(lattice, bits), steps, holes, digest, corner)
        is_whole = all(work.has_array(name) or has_shared_pages(folder, name) for name in STORED)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError, ArithmeticError, TerrainError):
        return None
    return work if is_whole else None


class StoredHeights:
    """All heights of a work, read by rows."""

    def __init__(self, work: TileWork) -> None:
        self._work = work
        self.shape: tuple[int, ...] = work.grid.lattice.height, work.grid.lattice.width

    def __getitem__(self, rows: slice) -> np.ndarray:
        return self._work.decoded(self._work.open("samples")[rows].copy())
