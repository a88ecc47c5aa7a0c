# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of a raster by tile, of a large one in several processes.

Steps: the samples are read in units (tiles of a mosaic, rows of any other raster), missing ones are filled, the tiles
are measured, and their borders are joined. A unit or a tile that was finished before is not made again: after a killed
import, and if only a part of the sources has changed.

A TileWork is the folder of the arrays, with the records of finished units and tiles; a draft makes that folder the
store's content at the end. On a farm other computers leave their results in part files (part_files.py) in that folder.
A TileSource is the opened raster with its settings and position, and a quick import around which tiles are loaded.
"""

from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import TerrainError
from ..field import store_folder
from ..field.build import content_key, no_ground, no_heights
from ..field.heightfield import HeightField, HeightRaster
from ..field.holes import holes_leave_ground
from ..field.store import Draft
from ..run import launch, owned_files
from ..sandbox.store_job import READING
from ..tiling import part_files, tile_steps
from ..tiling.tile_records import MEASURED, READ
from ..tiling.tile_work import StoredHeights, TileWork
from .height_reader import HeightReader, scaling_of
from .import_work import find_work, open_work, start_work
from .read_ahead import find_ahead
from .tile_tasks import (
    TileSource,
    TileTask,
    in_file,
    is_loaded,
    perform,
    perform_apart,
    read_tile_ahead,
    unit_count,
    write_read_parts,
)

MEASURING = "Measuring errors"
PARTS = BEGIN, READ_TILES, FILL, MEASURE = "begin", "read", "fill", "measure"
TILED_PARTS = READ_TILES, MEASURE  # of some tiles each
CHECKED_ROWS = 256
READ_END, FILLED_END, MEASURED_END, JOINED_END = 0.2, 0.25, 0.85, 0.97  # progress at the end of each step


class ImportPart(NamedTuple):
    """A part of an import, for a farm: a step of PARTS, and for TILED_PARTS the numbers of its tiles.

    A raster that is no mosaic has fewer units to read than tiles; further numbers are ignored.
    """

    step: str
    numbers: Collection[int] = ()


class Crew:
    """Processes that do tasks; here the calling process alone."""

    def run(
        self, work: TileWork, source: TileSource, tasks: Sequence[TileTask], on_progress: Callable[[float], None]
    ) -> bool:
        """Do tasks. Return False, before the rest is done, if heights have to be stored as floats. Raises TerrainError.

        on_progress: called with the fraction of finished tasks.
        """
        for number, task in enumerate(tasks):
            if not perform(work, source, task, launch.default_threads(), source.coarse):
                return False
            on_progress((number + 1) / len(tasks))
        return True

    def close(self) -> None:
        """End the processes."""


def do_part(part: ImportPart, wanted: TileWork, source: TileSource) -> dict:
    """Do a part of an import, for several computers that share it, and return a report. Raises TerrainError.

    BEGIN makes the arrays. Then several computers may read different units (READ_TILES) at the same time, each into a
    part file. FILL writes these into the arrays and fills missing samples. Then tiles may be measured (MEASURE) as they
    were read; the rest of the import writes the results into the arrays. While BEGIN or FILL runs, no other part may.

    The report has the number of "tiles", and with numbers of tiles also how many of these exist, as "done". wanted: the
    description of the work before anything is done. A part that was done before has left its own description in the
    folder, which then replaces it.
    """
    numbers, path, crew = part.numbers, wanted.folder.parent, Crew()
    if part.step in (BEGIN, FILL):
        with open_work(wanted, source) as (draft, work):
            if part.step == FILL and work is None:
                raise _not_begun(path)
            work = start_work(work, draft, wanted, source)
            work.describe()  # writes the file by which other computers find the work; a single tile has none otherwise
            if part.step == FILL:
                while not _read_all(work, source, crew, lambda _fraction: None):
                    work.start_again(draft)  # with heights as floats
                part_files.remove_parts(work.folder, READ)
                limits = tile_steps.limits_of(work)
                _check_ground(work, limits, source.settings.source)
                if limits.missing:
                    tile_steps.fill(work, launch.default_threads())
            return {"tiles": len(work.grid)}
    work = find_work(wanted)
    if work is None:
        raise _not_begun(path)
    if part.step == READ_TILES:
        tasks = _tasks_to_read(work, source, numbers)
    else:
        tasks = _tasks_to_measure(work, tile_steps.limits_of(work), numbers)
    for task in tasks:
        perform_apart(work, source, task, launch.default_threads())
    return {"tiles": len(work.grid), "done": sum(int(number < len(work.grid)) for number in numbers)}


def read_ahead(part: ImportPart, work: TileWork, source: TileSource, on_progress: Callable[[float, str], None]) -> dict:
    """Read the tiles that a later import loads around a first picture, each into its own file, and return a report.

    Tiles that were read before are not read again, so a killed process loses one. Without any tile the sources are
    only checked, and the store keeps the catalogue of a mosaic for processes that read. The report has the number of
    the import's "tiles" and how many of the requested ones are "done". work: of that import, which is not begun. Raises
    TerrainError.
    """
    if part.step != READ_TILES:
        raise TerrainError(f"No part {part.step!r} of tiles in view can be done", expected=repr(READ_TILES))
    path = work.folder.parent
    folder = store_folder.named_folder(path)
    numbers = [number for number in _chosen(len(work.grid), part.numbers) if is_loaded(source, number)]
    if not numbers and folder is not None:  # keeps the catalogue
        source.raster.finish(folder)
    for done, number in enumerate(numbers):
        on_progress(done / len(numbers), READING)
        inputs = _inputs(work, source, number)  # digest of all that determines the tile's samples
        if find_ahead(path, work.grid, number, inputs) is None:
            read_tile_ahead(work.grid, source, number, inputs, path)
    return {"tiles": len(work.grid), "done": len(numbers)}


def _not_begun(path: Path) -> TerrainError:
    """Return the error about a part of an import before the import was begun."""
    return TerrainError(
        f"No import of these sources and settings was begun in {path}",
        fix="begin it (--only begin; a farm's job: run it from its first step) with the same sources and options",
    )


def build_by_tile(
    work: TileWork | None,
    draft: Draft,
    wanted: TileWork,
    source: TileSource,
    reader: HeightReader,
    crew: Crew,
    on_progress: Callable[[float, str], None],
) -> HeightField:
    """Build the height field of a raster in the arrays of a draft. Raises TerrainError.

    Args:
        work: an earlier attempt to continue, None for none.
        wanted: description of the work, without any result.
        reader: gets the figures of all samples.
        crew: does the tasks.
        on_progress: gets 0 to 0.99 and a message.
    """
    work = start_work(work, draft, wanted, source)
    while not _read_all(work, source, crew, lambda fraction: on_progress(READ_END * fraction, READING)):
        work.start_again(draft)  # with heights as floats
    # The arrays have all heights now. Collect their figures, and fill missing samples.
    part_files.remove_parts(work.folder, READ)
    for record in work.records(READ).values():
        reader.add(record["figures"], record["missing"])
    limits = tile_steps.limits_of(work)  # of all heights, with the number of missing samples
    _check_ground(work, limits, source.settings.name)
    if limits.missing:
        on_progress(READ_END, MEASURING)
        tile_steps.fill(work, launch.default_threads())
    # Measure the tiles, except those whose results other computers have left in part files.
    span = MEASURED_END - FILLED_END  # fraction of the import that measuring takes
    tile_steps.write_parts(work)
    _measure_tiles(work, source, limits, crew, lambda fraction: on_progress(FILLED_END + span * fraction, MEASURING))
    part_files.remove_parts(work.folder, MEASURED)
    return _completed(work, draft, limits, reader.source_max(), on_progress, source)


def _read_all(work: TileWork, source: TileSource, crew: Crew, on_progress: Callable[[float], None]) -> bool:
    """Read the units (tiles, or rows of the file) that have changed, into the work's arrays.

    Return False, before the rest is read, if heights have to be stored as floats. If a unit then has no record, the
    work is marked as damaged, and TerrainError is raised. crew: processes that read.
    """
    count = unit_count(work.grid, source)
    # First take the units that other computers have read into part files.
    if not write_read_parts(work, lambda number: _inputs(work, source, number), count):
        return False
    tasks = _tasks_to_read(work, source)
    if not crew.run(work, source, tasks, on_progress):
        return False
    if tasks and not work.records(READ).keys() >= set(range(count)):
        raise _give_up(work)
    return True


def _tasks_to_read(work: TileWork, source: TileSource, numbers: Collection[int] | None = None) -> list[TileTask]:
    """Return the tasks to read the units (tiles, or rows of the file) that have changed.

    numbers: those of the units to read, None for all.
    """
    before, tasks = work.records(READ), []
    for number in _chosen(unit_count(work.grid, source), numbers):
        inputs = _inputs(work, source, number)
        if number not in before or before[number]["inputs"] != inputs:
            tasks.append(TileTask(READ, number, inputs))
    return tasks


def _inputs(work: TileWork, source: TileSource, number: int) -> str:
    """Return a digest of all that determines the samples of a unit, a part that is read at once.

    number: of the unit.
    """
    if source.coarse is not None:
        return f"{source.coarse.digest} {number in source.coarse.loaded}"
    if source.raster.inputs is None:
        return work.digest
    window = in_file(work.grid.lattice, source.place, work.grid.owned(work.grid.box(number)))
    return f"{source.raster.inputs(*window)} {scaling_of(source.raster, source.settings)}"


def _check_ground(work: TileWork, limits: tile_steps.TerrainLimits, name: str) -> None:
    """Raise TerrainError for a raster of which nothing would be left.

    limits: lowest and highest height, and the number of missing samples. name: of the source, in the error.
    """
    lattice = work.grid.lattice
    if limits.missing == lattice.width * lattice.height:
        raise no_heights(name)
    if limits.missing and work.holes:  # missing samples are cut out
        rows = range(0, lattice.cells_y, CHECKED_ROWS)  # of cells, which have one more row of samples
        if not any(holes_leave_ground(work.open("missing")[row : row + CHECKED_ROWS + 1] == 0) for row in rows):
            raise no_ground(name)


def _measure_tiles(
    work: TileWork,
    source: TileSource,
    limits: tile_steps.TerrainLimits,
    crew: Crew,
    on_progress: Callable[[float], None],
) -> None:
    """Measure the tiles that have changed, which `tile_steps.measure` decides.

    Raises TerrainError, and gives the work up, if a tile then has no complete record. limits: of all heights. crew:
    processes that measure.
    """
    crew.run(work, source, _tasks_to_measure(work, limits), on_progress)
    measured = work.records(MEASURED)  # a complete one has "errors"
    if not all("errors" in measured.get(number, ()) for number in range(len(work.grid))):
        raise _give_up(work)


def _tasks_to_measure(
    work: TileWork, limits: tile_steps.TerrainLimits, numbers: Collection[int] | None = None
) -> list[TileTask]:
    """Return the tasks to measure tiles. numbers: those of the tiles, None for all.

    A task has the last complete record of its tile, so that nothing is written if the tile has not changed.
    """
    before = {number: record for number, record in work.records(MEASURED).items() if "errors" in record}
    chosen = _chosen(len(work.grid), numbers)
    return [TileTask(MEASURED, number, limits=tuple(limits), before=before.get(number)) for number in chosen]


def _give_up(work: TileWork) -> TerrainError:
    """Mark a work with damaged arrays or records, so that it is not continued, and return the error about it."""
    owned_files.remove_file(work.folder / store_folder.WORK_NAME)
    what = f"What an earlier import has left in {work.folder} is damaged, and is removed"
    return TerrainError(what, fix="check the disk, and import again")


def _chosen(count: int, numbers: Collection[int] | None) -> list[int]:
    """Return the numbers below `count` that are in `numbers`; all for None."""
    return [number for number in range(count) if numbers is None or number in numbers]


def _completed(
    work: TileWork,
    draft: Draft,
    limits: tile_steps.TerrainLimits,
    source_max: float,
    on_progress: Callable[[float, str], None],
    source: TileSource,
) -> HeightField:
    """Join the measured tiles into the draft, and return the height field.

    The work can be continued until the draft is published. source_max: largest error of the source's heights, metres.
    limits: lowest and highest height, and the number of missing samples.
    """
    lattice, span = work.grid.lattice, JOINED_END - MEASURED_END  # span: fraction of the import that joining takes

    def tell(fraction: float) -> None:
        """Report a fraction of the joining of tiles as one of the whole import."""
        on_progress(MEASURED_END + span * fraction, MEASURING)

    joined = tile_steps.join(work, limits, launch.default_threads(), tell, source.coarse)
    # If missing samples are cut out, the field has marks of the others.
    valid = None  # 1 where a sample exists, as opposed to "missing"
    if limits.missing and work.holes:
        valid = work.allocate(draft, "valid", (lattice.height, lattice.width), np.dtype(np.uint8))
        for row in range(0, lattice.height, CHECKED_ROWS):
            valid[row : row + CHECKED_ROWS] = work.open("missing")[row : row + CHECKED_ROWS] ^ 1
    # Keep the records of the tiles and their borders in the store, for the next import.
    if not work.is_described:  # a single tile, too short to be used again
        work.remove_records()
        draft.remove("borders")
    elif source.raster.finer is None:  # else `add_finer_tiles` keeps them, with its own
        work.keep_records()
    key = content_key(StoredHeights(work), lattice, source_max, valid)
    on_progress(0.99, MEASURING)
    base, step = limits.scale  # metres: the ranges of heights are stored as base + number * step
    return HeightField(
        HeightRaster(work.open("samples"), lattice, key, steps=work.steps, filled=limits.missing, valid=valid),
        error=work.open("error"),
        exponents=joined.exponents,  # by group of depths: the power of two that scales the codes of errors
        ranges=work.open("ranges"),
        range_base=base,
        range_step=step,
        min_height=limits.low,
        max_height=limits.high,
        # climbs: largest differences of neighbouring samples, metres
        steepest_x=joined.climbs[0] / lattice.step_x,
        steepest_y=joined.climbs[1] / lattice.step_y,
        source_max=source_max,
    )
