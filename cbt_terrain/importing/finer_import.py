# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of the finer tiles of a mosaic, after its coarser raster is there (mosaic/finer_plan.py).

They are made in the work of that raster (tiling/tile_work.py): a window of tiles that was read, or a tile that was
measured, in a killed import is not made again. Neither is one of the store at the same path, if all that determines it
is the same. Files are read only where they have changed, also for the rings inside their borders.

A finer tile is a square of SIDE x SIDE finer cells, a window a square of WINDOW x WINDOW tiles whose heights are read
together. Records (lines of JSON in the work's folder) mark finished results: FILLED is the kind of a window's heights,
the other kinds are of tiles.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import TerrainError
from ..field import store_folder
from ..field.cleaning import nearest_known
from ..field.finer_build import with_finer_tiles
from ..field.finer_heights import (
    FILLED,
    MEASURED,
    WINDOW,
    Arrays,
    FinerRecords,
    Tile,
    border_margin,
    border_weights,
    raster_heights,
)
from ..field.finer_tiles import SIDE, FinerTiles, tile_shape
from ..field.heightfield import HeightField
from ..field.known_ground import ground_fraction, known_tiles_of
from ..field.lattice import TileBox
from ..field.store import Draft, open_store
from ..rasters.raster import FinerSource
from ..run import launch
from ..tiling.moved_tiles import samples_moved
from ..tiling.tile_records import FIGURES, FINER, SEAMS
from ..tiling.tile_work import TileWork, work_in
from .finer_squares import is_in_squares
from .height_reader import HeightReader, scaling_of


def add_finer_tiles(
    plain: HeightField,
    source: FinerSource,
    reader: HeightReader,
    draft: Draft,
    work: TileWork,
    on_progress: Callable[[float], None],
) -> HeightField:
    """Return the field `plain` of the coarser files with the finer heights of `source`, in the arrays of a draft.

    Near the border of all finer tiles they are mixed with the heights of `plain`. reader: gets their figures (FIGURES:
    largest height and errors). work: of the raster, in the draft's folder. on_progress: called with the fraction that
    is done.
    """
    bits, lattice = source.bits, plain.lattice
    last = lattice.cells_x << bits, lattice.cells_y << bits  # column and row of the last finer sample
    margin = border_margin(bits)  # finer samples in which they are mixed; files are that far inside the tiles' border
    known = known_tiles(source.boxes, margin, last, tile_shape(lattice, bits))  # (column, row) of the finer tiles
    known = {tile for tile in known if is_in_squares(tile, source, lattice)}
    windows = _Windows(source, reader, last, margin if source.continues else 0)
    # Tiles of the store that is replaced can be copied only if the source gives digests of what determines them.
    earlier = _EarlierTiles(draft.path, work, bits) if source.inputs is not None else None
    records = _WorkRecords(work, windows, earlier)
    if source.keep_seams is not None:  # the source keeps records of the borders of its files
        source.keep_seams(records.find_seams, records.note_seams)

    def read(box: TileBox) -> np.ndarray:
        """Return the finer heights of a tile, near the border of all tiles mixed with those of the raster."""
        heights, nearness = windows.heights(box)
        rows, columns = box.shape
        # Weights of the finer heights: from 0 at the border of all tiles to 1 inside the margin.
        weights = border_weights((box.x0 // SIDE, box.y0 // SIDE), known, margin, last)[:rows, :columns]
        weights = np.minimum(weights, nearness)
        if (weights < 1.0).any():
            x, y = np.arange(box.x0, box.x1 + 1), np.arange(box.y0, box.y1 + 1)
            coarse = raster_heights(plain, bits, x, y)
            heights = (coarse + weights * (heights - coarse)).astype(np.float32)
        return heights

    def allocate(name: str, shape: tuple, dtype: np.dtype) -> np.ndarray:
        """Return an array of the draft."""
        return work.allocate(draft, name, shape, dtype)

    field = with_finer_tiles(plain, bits, known, read, allocate=allocate, on_progress=on_progress, records=records)
    work.keep_records()
    if earlier is not None:
        earlier.close()
    return field


class _EarlierTiles:
    """The finer tiles of the store at a path, before it is replaced, and the records of their import.

    Columns and rows of tiles and windows are those of the new raster, which may have grown in the west or south.
    """

    def __init__(self, path: Path, work: TileWork, bits: int):
        """Open the store if windows of its finer tiles are windows of the new raster; a damaged one counts as none.

        work: of the new raster, whose finer tiles have `bits`.
        """
        self._tiles: FinerTiles | None = None
        self._moved = 0, 0  # columns and rows of windows that the earlier ones have further east and north
        self.work: TileWork | None = None
        with suppress(TerrainError, OSError):
            folder = store_folder.named_folder(path)
            before = work_in(folder) if folder is not None else None
            # Columns and rows of samples that the store's have further east and north; None if they do not coincide.
            samples = samples_moved(before, work) if before is not None else None
            tiles = open_store(path).raster.finer if samples is not None else None
            if tiles is None or tiles.bits != bits or samples is None:
                return
            columns, rows = (count << bits for count in samples)  # finer ones
            side = WINDOW * SIDE
            if columns % side == rows % side == 0:
                self._tiles, self.work, self._moved = tiles, before, (columns // side, rows // side)

    def place(self, kind: str, place: Tile) -> Tile:
        """Return column and row in the earlier store of a tile, or of a window, which may be outside of its raster.

        kind: of the record, FILLED for a window.
        """
        # `_moved`: windows by which a window of the earlier store is further east and north in the new raster.
        times = 1 if kind == FILLED else WINDOW
        return place[0] - times * self._moved[0], place[1] - times * self._moved[1]

    def array(self, name: str, tile: Tile) -> np.ndarray | None:
        """Return an array of a tile of the earlier store, None without the tile.

        name: "heights", "errors", "ranges" or "limits", a field of FinerTiles. tile: column and row in the new raster.
        """
        column, row = self.place(MEASURED, tile)  # in the earlier store; MEASURED is a kind of records of tiles
        numbers = self._tiles.numbers if self._tiles is not None else np.zeros((0, 0), np.int32)
        if not (0 <= row < numbers.shape[0] and 0 <= column < numbers.shape[1]) or numbers[row, column] < 0:
            return None
        return getattr(self._tiles, name)[numbers[row, column]]

    def close(self) -> None:
        """Close the arrays, whose files are about to be removed."""
        self._tiles = self.work = None


class _WorkRecords(FinerRecords):
    """The records of a work, and of the store that it replaces; those of windows have the reader's figures, too."""

    def __init__(self, work: TileWork, windows: "_Windows", earlier: _EarlierTiles | None):
        self._work, self._windows, self._earlier = work, windows, earlier
        # By kind and number: records of this import, and of the earlier store.
        self._found = {kind: work.records(kind) for kind in (*FINER, SEAMS)}
        before = earlier.work if earlier is not None else None
        self._before = {kind: before.records(kind) if before is not None else {} for kind in (*FINER, SEAMS)}

    def find(self, kind: str, place: Tile, inputs: str) -> Iterator[tuple[dict[str, Any], Arrays | None]]:
        """Yield the records of a kind for a tile or window: first that of this import, then that of the earlier store.

        A record of the earlier store comes with a function that returns that store's arrays, one of this import with
        None. place: column and row. inputs: is not used here; the caller compares it with the entry of a record.
        """
        found = self._found[kind].get(_number_of(place))
        if found is not None:
            yield found, None
        if self._earlier is not None:
            before = self._before[kind].get(_number_of(self._earlier.place(kind, place)))
            if before is not None:
                yield before, self._earlier.array

    def note(self, kind: str, place: Tile, array: np.ndarray | None = None, **values: Any) -> None:
        """Write a record of a kind for a tile or window; that of a window also has the figures of its reading.

        place: column and row. array: is not used, the store has it. values: content of the record.
        """
        if kind == FILLED:
            values["figures"] = self._windows.figures
        self._work.note(kind, _number_of(place), **values)

    def use(self, kind: str, place: Tile, record: dict[str, Any], is_earlier: bool) -> None:
        """Take over a record: give the reader the figures of a window, and write a record of an earlier store again.

        place: column and row. is_earlier: whether the record is of the store that is replaced.
        """
        if kind == FILLED:
            self._windows.add(record["figures"])
        if is_earlier:
            self._write_again(kind, _number_of(place), record)

    def inputs_of(self, box: TileBox) -> str:
        """Return a digest of the sources and the scaling of a window."""
        return self._windows.inputs_of(box)

    def find_seams(self, row: int, column: int) -> dict[str, Any] | None:
        """Return the record of the seams in a block of finer tiles, None if no record exists.

        row, column: of the block, see `_number_of`. A record of an earlier store is written into the work, too.
        """
        number = _number_of((column, row))
        record = self._found[SEAMS].get(number)
        if record is None and number in self._before[SEAMS]:
            record = self._before[SEAMS][number]
            self._write_again(SEAMS, number, record)
        return record

    def note_seams(self, row: int, column: int, **values: Any) -> None:
        """Write the record of a block's seams."""
        self._work.note(SEAMS, _number_of((column, row)), **values)

    def _write_again(self, kind: str, number: int, record: dict[str, Any]) -> None:
        """Write the values of an earlier store's record into the work."""
        values = {name: value for name, value in record.items() if name not in ("kind", "number", "at")}
        self._work.note(kind, number, **values)


def _number_of(place: Tile) -> int:
    """Return the number of a record by column and row: it does not change when the raster gets wider.

    Blocks of seams may have negative columns and rows. Numbers are unique: a raster has fewer than 2^31 of either.
    """
    column, row = (index % (1 << 31) for index in place)
    return (row << 31) + column


def known_tiles(boxes: np.ndarray, margin: int, last: tuple[int, int], shape: tuple[int, int]) -> set[Tile]:
    """Return column and row of the finer tiles that files meet, with a margin around each file.

    boxes: int64 [files, 4], in columns and rows of the file's grid, whose first row is in the north. margin: finer
    samples around a file that count, too. last: column and row of the last finer sample. shape: rows and columns of
    tiles.
    """
    is_known = np.zeros(shape, bool)
    for west, north, east, south in boxes:  # rows of tiles are counted from the south
        first_x, last_x = max(west - margin, 0) // SIDE, min(east + margin, last[0] - 1) // SIDE
        first_y, last_y = max(last[1] - south - margin, 0) // SIDE, min(last[1] - north + margin, last[1] - 1) // SIDE
        is_known[first_y : last_y + 1, first_x : last_x + 1] = True
    return {(int(column), int(row)) for row, column in np.argwhere(is_known)}


class _Windows:
    """Heights of the finer samples, read by windows of WINDOW x WINDOW tiles, of which the last one is cached.

    Attributes:
        figures: those of the window that was read last (FIGURES): largest height and rounding by float32, metres, and
            largest errors of positions and vertical datums, in the unit of the files' values.
    """

    def __init__(self, source: FinerSource, reader: HeightReader, last: tuple[int, int], margin: int):
        """Prepare the reading.

        last: column and row of the last finer sample. margin: samples from known ones up to which heights continue
        these; 0 if they do not.
        """
        self._source, self._reader, self._last, self._margin = source, reader, last, margin
        # Heights and nearness by column and row of the window, at most one.
        self._kept: dict[tuple[int, int], tuple[np.ndarray, np.ndarray]] = {}
        self.figures: dict[str, float] = {}

    def heights(self, box: TileBox) -> tuple[np.ndarray, np.ndarray]:
        """Return the heights of a tile's samples, float32 metres, row 0 south, and how near known samples are.

        Within the margin heights are those of the nearest known sample, and nearness falls from 1 to 0. Heights are NaN
        farther away, and everywhere in a gap if there is no margin; nearness is then 1.
        """
        wide = WINDOW * SIDE  # finer cells along a window
        key = box.x0 // wide, box.y0 // wide
        if key not in self._kept:
            x1, y1 = (min((n + 1) * wide, end) for n, end in zip(key, self._last, strict=True))
            self._kept = {key: self._continued(TileBox(key[0] * wide, key[1] * wide, x1, y1))}
        x, y = box.x0 - key[0] * wide, box.y0 - key[1] * wide
        heights, nearness = (values[y : y + box.shape[0], x : x + box.shape[1]] for values in self._kept[key])
        return heights, nearness

    def inputs_of(self, box: TileBox) -> str:
        """Return a digest of all that determines the heights of a window."""
        inputs = self._source.inputs
        sources = inputs(*self._in_file(*self._widened(box))) if inputs is not None else ""
        return f"{sources} {scaling_of(self._reader.raster, self._reader.settings)}"

    def _widened(self, box: TileBox) -> TileBox:
        """Return a box with the margin on each side, inside the raster."""
        low = (max(end - self._margin, 0) for end in (box.x0, box.y0))
        high = (min(end + self._margin, last) for end, last in zip((box.x1, box.y1), self._last, strict=True))
        return TileBox(*low, *high)

    def _continued(self, box: TileBox) -> tuple[np.ndarray, np.ndarray]:
        """Read a window, and return heights and nearness as `heights` does."""
        wide = self._widened(box)
        heights = self._read(*wide)
        nearness = np.ones(heights.shape)
        if self._margin and np.isnan(heights).any():
            heights, distances = nearest_known(heights, launch.default_threads())
            nearness = np.maximum(1.0 - distances / self._margin, 0.0)
            heights[nearness == 0.0] = np.nan
        inner = slice(box.y0 - wide.y0, box.y1 - wide.y0 + 1), slice(box.x0 - wide.x0, box.x1 - wide.x0 + 1)
        return heights[inner], nearness[inner]

    def add(self, figures: dict[str, float]) -> None:
        """Give the reader the figures of a window, as the largest height and error that were read."""
        no_values: dict[str, list] = {"marks": [], "values": [math.inf, -math.inf]}  # figures of a window lack these
        self._reader.add(figures | no_values, missing=0)

    def _in_file(self, x0: int, y0: int, x1: int, y1: int) -> tuple[int, int, int, int]:
        """Return first row, rows, first column and columns of finer samples, whose rows are counted from the north."""
        return self._last[1] - y1, y1 - y0 + 1, x0, x1 - x0 + 1

    def _read(self, x0: int, y0: int, x1: int, y1: int) -> np.ndarray:
        """Read finer samples x0 .. x1 and y0 .. y1 from the files. Return heights, float32 metres, row 0 south.

        `figures` then has those of this window, which the reader of the whole import gets, too.
        """
        raster = self._reader.raster
        before = raster.moved, raster.shifted
        raster.moved = raster.shifted = 0.0  # the figures are of this window alone
        reader = HeightReader(raster, self._reader.settings)
        heights = reader.heights(self._source.window(*self._in_file(x0, y0, x1, y1)))[::-1]  # the file begins north
        self.figures = {name: reader.figures()[name] for name in FIGURES}
        raster.moved, raster.shifted = before
        self.add(self.figures)  # to those of the whole import
        return heights


def finer_entries(field: HeightField) -> dict:
    """Return the report entries about finer tiles; {} without any.

    `ground_percent` is the part of a mosaic with wide gaps that has ground.
    """
    finer, lattice = field.raster.finer, field.lattice
    if finer is None:
        return {}
    steps = [step / (1 << finer.bits) for step in (lattice.step_x, lattice.step_y)]
    fraction = ground_fraction(field) if known_tiles_of(field) is not None else None
    ground = {} if fraction is None else {"ground_percent": float(f"{100.0 * fraction:.4g}")}
    return {"finer_tiles": len(finer.heights), "finer_step_m": steps} | ground
