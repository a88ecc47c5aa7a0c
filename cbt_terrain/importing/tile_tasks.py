# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks of an import by tile: a unit of the source to read, or a tile to measure.

A unit is what one task reads: a tile of a mosaic, or else a group of rows of the file. A tile owns its samples without
those that its eastern and northern neighbours have too. In the order of the terrain row 0 is in the south and column 0
in the west; a file may have another order. Coarse land is a quick import, around which single tiles are loaded.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..field.georeference import Georeference
from ..field.lattice import Lattice, TileBox
from ..rasters.raster import ImportSettings, Raster
from ..tiling import part_files, tile_steps
from ..tiling.coarse_land import CoarseLand
from ..tiling.tile_grid import TileGrid
from ..tiling.tile_records import MEASURED, READ
from ..tiling.tile_work import NotNumberedError, TileWork
from .height_reader import HeightReader
from .read_ahead import find_ahead, write_ahead

STRIP_ROWS = 512  # of a tile that are read together, to save memory
# Of the record of a unit: digest of its sources, number of missing samples, lowest and highest height, and the figures
# that the reader found for the import's report.
READ_ENTRIES = "inputs", "missing", "limits", "figures"


class TileTask(NamedTuple):
    """A part of an import that a process makes: a unit to read or a tile to measure.

    Attributes:
        step: READ or MEASURED.
        number: of the unit or the tile.
        inputs: digest of the sources of a unit.
        limits: low, high and number of missing samples of the terrain, to measure.
        before: last complete record of the tile; None for none.
    """

    step: str
    number: int
    inputs: str = ""
    limits: Sequence[float] = ()
    before: dict | None = None

    def terrain(self) -> tile_steps.TerrainLimits:
        """Return `limits` by their names."""
        low, high, missing = self.limits
        return tile_steps.TerrainLimits(low, high, int(missing))


class TileSource(NamedTuple):
    """What an import by tile reads."""

    raster: Raster
    settings: ImportSettings
    place: Georeference
    coarse: CoarseLand | None = None  # of which some tiles are loaded


def perform(
    work: TileWork, source: TileSource | None, task: TileTask, threads: int, coarse: CoarseLand | None = None
) -> bool:
    """Do one task of an import, to read a unit or to measure a tile, in the arrays of `work`, and write its record.

    Return False if its heights have to be stored as floats. source: None is enough to measure. coarse: the quick import
    whose heights all other tiles keep, if single tiles are loaded; else None. Raises TerrainError, and OSError of the
    arrays.
    """
    if task.step == MEASURED:
        terrain = task.terrain()
        tile_steps.measure(work, task.number, terrain, threads, task.before, coarse=coarse)
        return True
    assert source is not None, "only the measuring of a tile needs none"
    if is_loaded(source, task.number):
        ahead = find_ahead(work.folder.parent, work.grid, task.number, task.inputs)
        if ahead is not None:  # another computer has read it into a file
            box = work.grid.owned(work.grid.box(task.number))
            work.write_heights(box.x0, box.y0, ahead.heights)
            work.note(READ, task.number, **{name: ahead.record[name] for name in READ_ENTRIES})
            return True
    reader, limits = _unit_reader(source), list[float]()  # limits: lowest and highest height of each part
    for box, heights in _read_heights(work.grid, source, task.number, reader):
        try:
            limits += work.write_heights(box.x0, box.y0, heights)
        except NotNumberedError:  # the arrays store numbers of steps, and a height is no multiple of the step
            return False
    work.note(READ, task.number, **_read_record(task.inputs, reader, limits))
    return True


def read_tile_ahead(grid: TileGrid, source: TileSource, number: int, inputs: str, store: Path) -> None:
    """Read a tile that is to be loaded around a quick import, and write its heights into a file of the store.

    A later import takes them from there instead of the source. The file also has the READ_ENTRIES of the tile. number:
    of the tile. inputs: digest of the sources. Raises TerrainError.
    """
    reader, whole = _unit_reader(source), grid.owned(grid.box(number))
    tile_heights = np.empty(whole.shape, np.float32)
    for box, heights in _read_heights(grid, source, number, reader):
        tile_heights[box.y0 - whole.y0 : box.y1 - whole.y0 + 1, box.x0 - whole.x0 : box.x1 - whole.x0 + 1] = heights
    write_ahead(store, grid, number, _read_record(inputs, reader, _limits(tile_heights)), tile_heights)


def perform_apart(work: TileWork, source: TileSource, task: TileTask, threads: int) -> None:
    """Do one task and write its result into a part file; a later step copies these files into the work's arrays.

    So several computers never write to one file. A task whose file is there is not done again, unless the file is of
    other sources. Raises OSError and TerrainError.
    """
    folder, number = work.folder, task.number
    done = part_files.find_record(folder, work.grid, task.step, number)
    if task.step == MEASURED:
        limits = task.terrain()
        # `measured` returns what differs from a record: that of the part file, then that of the work's arrays.
        if done is not None and tile_steps.measured(work, number, limits, threads, done) is None:
            return
        changes = tile_steps.measured(work, number, limits, threads, task.before)
        if changes is not None:
            with part_files.writing_part(folder, MEASURED, number) as writer:
                for name in ("codes", "border", "ranges"):  # of its errors, of its border, and of heights
                    if getattr(changes, name) is not None:
                        writer.add(name, (0, 0), getattr(changes, name))
                writer.record = changes.record
        return
    if done is not None and done["inputs"] == task.inputs:
        return
    reader, extremes = _unit_reader(source), list[float]()
    with part_files.writing_part(folder, READ, number) as writer:
        for box, heights in _read_heights(work.grid, source, number, reader):
            writer.add("heights", (box.x0, box.y0), heights)
            extremes += _limits(heights)
        writer.record = _read_record(task.inputs, reader, extremes)


def write_read_parts(work: TileWork, inputs_of: Callable[[int], str], count: int) -> bool:
    """Copy units that other processes have read from their part files into the arrays of `work`.

    Damaged files and those of other sources are skipped. Return False, before the rest is written, if heights have to
    be stored as floats. inputs_of: returns the digest of the sources of a unit. count: number of units.
    """
    before, lattice = work.records(READ), work.grid.lattice
    for number in part_files.numbers_of(work.folder, READ):
        record = part_files.find_record(work.folder, work.grid, READ, number)
        if record is None or number >= count or record["inputs"] != inputs_of(number):
            continue
        if number in before and before[number]["inputs"] == record["inputs"]:
            continue  # it was written before
        try:
            for block in part_files.blocks_of(work.folder, record):
                (x, y), shape = block.place, block.values.shape
                if len(shape) != 2 or x + shape[1] > lattice.width or y + shape[0] > lattice.height:
                    raise ValueError("it is not a part of the raster")
                work.write_heights(x, y, block.values)
        except NotNumberedError:
            return False
        except (ValueError, OSError):
            continue
        work.note(READ, number, **{name: record[name] for name in READ_ENTRIES})
    return True


def is_loaded(source: TileSource, number: int) -> bool:
    """Return whether a tile is one of those that are loaded around the heights of a quick import."""
    return source.coarse is not None and number in source.coarse.loaded


def _unit_reader(source: TileSource) -> HeightReader:
    """Return a reader whose figures are of one unit alone."""
    source.raster.moved = source.raster.shifted = 0.0
    return HeightReader(source.raster, source.settings)


def _limits(heights: np.ndarray) -> list[float]:
    """Return the lowest and the highest of heights, or [] if all are missing."""
    known = heights[~np.isnan(heights)]
    return [float(known.min()), float(known.max())] if known.size else []


def _read_record(inputs: str, reader: HeightReader, limits: Sequence[float]) -> dict:
    """Return the READ_ENTRIES of a unit. limits: lowest and highest heights of its parts."""
    ends = [min(limits), max(limits)] if limits else None
    return {"inputs": inputs, "missing": reader.missing, "limits": ends, "figures": reader.figures()}


def _read_heights(
    grid: TileGrid, source: TileSource, number: int, reader: HeightReader
) -> Iterator[tuple[TileBox, np.ndarray]]:
    """Yield the boxes of a unit, each with its heights in the order of the terrain, NaN where missing.

    A unit that is not loaded has the heights of the coarse land. number: of the unit. reader: gets the figures of the
    heights.
    """
    if source.coarse is not None and not is_loaded(source, number):
        box = grid.owned(grid.box(number))
        heights = source.coarse.heights(box)
        reader.missing += int(np.count_nonzero(np.isnan(heights)))
        yield box, heights
        return
    for box, values in _pieces(grid, source, number):
        heights = np.empty(box.shape, np.float32)
        source.place.in_file_order(heights)[:] = reader.heights(values)  # a view, turned and mirrored as the file is
        yield box, heights


def unit_count(grid: TileGrid, source: TileSource) -> int:
    """Return the number of units, tiles or groups of rows, in which the samples are read."""
    if _is_by_tile(source):
        return len(grid)
    return -(-source.raster.height // _unit_rows(grid, source.raster))


def _is_by_tile(source: TileSource) -> bool:
    """Return whether a unit is a tile; rows otherwise."""
    return source.raster.inputs is not None or source.coarse is not None


def _unit_rows(grid: TileGrid, raster: Raster) -> int:
    """Return the rows of a unit, a multiple of those that are read together."""
    at_once = raster.rows_at_once
    return -(-grid.side // at_once) * at_once


def _pieces(grid: TileGrid, source: TileSource, number: int) -> Iterator[tuple[TileBox, np.ndarray]]:
    """Yield the parts of a unit: the box of the terrain that each fills, and its values in the order of the file.

    A unit is a tile, without the samples that its eastern and northern neighbours also have, or else rows of the file.
    number: of the unit.
    """
    raster, place = source.raster, source.place
    if _is_by_tile(source):
        tile = grid.owned(grid.box(number))
        assert raster.window is not None
        for y in range(tile.y0, tile.y1 + 1, STRIP_ROWS):
            box = tile._replace(y0=y, y1=min(y + STRIP_ROWS - 1, tile.y1))
            yield box, raster.window(*in_file(grid.lattice, place, box))
        return
    unit_rows, at_once = _unit_rows(grid, raster), raster.rows_at_once
    for first in range(number * unit_rows, min((number + 1) * unit_rows, raster.height), at_once):
        values = raster.read(first, min(at_once, raster.height - first))
        rows = 2 if raster.height == 1 else len(values)  # a single row is repeated
        yield _in_terrain(grid.lattice, place, first, rows), values


def in_file(lattice: Lattice, place: Georeference, box: TileBox) -> tuple[int, int, int, int]:
    """Return first row, number of rows, first column and number of columns in the file of a box of the terrain.

    The file may count from other corners than the terrain, or have rows along y. place: georeference of the file.
    """
    x = lattice.cells_x - box.x1 if place.first_column_east else box.x0
    y = box.y0 if place.first_row_south else lattice.cells_y - box.y1
    across, up = box.x1 - box.x0 + 1, box.y1 - box.y0 + 1
    return (x, across, y, up) if place.transposed else (y, up, x, across)


def _in_terrain(lattice: Lattice, place: Georeference, first: int, rows: int) -> TileBox:
    """Return the box in the terrain of `rows` rows of the file from row `first` on."""
    # Rows of the file are columns of the terrain if it is transposed; `backwards`: they count from the last one.
    backwards = place.first_column_east if place.transposed else not place.first_row_south
    last = lattice.cells_x if place.transposed else lattice.cells_y
    low, high = (last - first - rows + 1, last - first) if backwards else (first, first + rows - 1)
    return TileBox(low, 0, high, lattice.cells_y) if place.transposed else TileBox(0, low, lattice.cells_x, high)
