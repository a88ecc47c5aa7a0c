# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of a source into a store, within the calling process.

A TileWork is the description of an import's arrays and tiles, and the folder where they are made. The folder is that of
a draft, which becomes the store's content when it is published. A first picture is a quick import of few samples.
"""

import dataclasses
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..field import store, store_folder
from ..field.georeference import LARGEST_EXTENT, SMALLEST_EXTENT, Georeference
from ..field.heightfield import LOADED, HeightField
from ..field.lattice import Lattice, lattice_for
from ..field.packing import copy_store
from ..formats.archives import is_archive, unpacked
from ..formats.sources import check_file, open_source
from ..rasters.raster import ImportSettings, Raster
from ..sandbox.store_job import READING, Tell
from ..tiling.coarse_land import CoarseLand
from ..tiling.tile_work import TileWork, work_in
from .earlier_import import finished_import, import_before, source_digest
from .finer_import import add_finer_tiles
from .finer_squares import finer_provenance
from .height_range import fit_heights
from .height_reader import HeightReader
from .import_report import report_of
from .import_work import open_work, work_of
from .plausibility import ValueCheck
from .read_ahead import remove_ahead
from .refining import coarse_land, first_picture, refined
from .source_list import absolute_source
from .thinning import REFINED, loaded_steps, thinned
from .tile_import import (
    Crew,
    ImportPart,
    build_by_tile,
    do_part,
    read_ahead,
)
from .tile_tasks import TileSource

ORIGINAL_PROGRESS = 0.1  # of the progress of a resampled raster
COARSE_PROGRESS = 0.4  # of the progress of a raster with finer tiles
FINER = "Reading finer files"  # message meanwhile


def run_import(
    settings: ImportSettings,
    path: str | os.PathLike,
    on_progress: Callable[[float, str], None] = lambda _fraction, _message: None,
    folder: str | None = None,
    crew: Crew | None = None,
    part: ImportPart | None = None,
) -> dict:
    """Import one file in this process and return the report; the store at `path` changes at the very end or not at all.

    This process keeps its rights, so import untrusted files with import_process.py. An archive is unpacked first.

    on_progress: gets a fraction and a message; an exception from it stops the import. folder: name of the folder for
    the new arrays; None for a random one. crew: processes that read and measure a large raster, which the caller
    closes; None for this process. part: the part of an import to do, if several computers share it; the report then
    has only numbers of tiles. None for all that is not done yet. Raises TerrainError.
    """
    store_folder.check_target(path)
    settings.check()
    path, source, folder = Path(path), Path(settings.source), folder or store_folder.new_data_name()
    if is_archive(source):
        check_file(source)
    with unpacked(source, path / store_folder.scratch_name(folder)) as file:
        return import_raster(settings, file, path, folder, on_progress, crew=crew, part=part)


def import_raster(
    given: ImportSettings,
    file: Path,
    path: Path,
    folder: str,
    on_progress: Callable[[float, str], None],
    open_raster: Callable[[ImportSettings], Raster] = open_source,
    crew: Crew | None = None,
    part: ImportPart | None = None,
) -> dict:
    """Import the raster of the settings in this process into the store at `path`, and return the report.

    If the store has the same mosaic already, its report is returned. file: the source, or its unpacked height map.
    folder: name of the folder for the new arrays. on_progress: gets a fraction and a message; may raise to stop.
    open_raster: opens the source of the settings; its raster is closed here. crew: processes that read and measure,
    None for this one alone. part: the step and tiles that this computer does if several share the import, None for all.
    """
    started = time.monotonic()
    settings = dataclasses.replace(given, source=str(file)) if file != Path(given.source) else given
    raster = open_raster(settings)
    try:
        # The sources of a mosaic are known only now. For all other files the caller has checked this already.
        report = finished_import(path, given, raster) if raster.sources else None
        if report is not None:
            return report
        # With tiles to load in more detail, the store has a first picture (land), whose heights all other tiles keep.
        land = _first_picture(given, raster, path) if settings.loaded_tiles else None
        if land is not None:
            raster = refined(raster, settings, land)
        elif settings.quick:
            raster = thinned(raster, settings)
            if raster.full_size is None:  # it has so few samples that all are read
                given, settings = (dataclasses.replace(each, quick=0) for each in (given, settings))
        # Describe the arrays: position, lattice, scale of heights, and the tiles to make.
        digest = source_digest(given, raster.sources, raster.method)
        place = place_of(settings, raster)
        width, height = (max(count, 2) for count in _size(raster, place))  # a single line of samples is repeated
        lattice = lattice_for(width, height, place.step_x, place.step_y, settings.name)
        fitted, notes = fit_heights(settings, raster, place.step_x * (width - 1))
        raster.warnings += notes
        if land is not None and fitted is not settings:  # the first picture has another range of values
            raise TerrainError(f"The heights of {settings.name} depend on all samples", fix="import all of it")
        settings, source = fitted, TileSource(raster, fitted, place, land)
        wanted = work_of(path / folder, source, lattice, digest)  # nothing of it is done yet
        # Do a part alone. Of tiles to load, each is read into its own file, which the import itself takes later.
        if part is not None and land is not None:
            return read_ahead(part, wanted, source, on_progress)
        if part is not None:
            return do_part(part, wanted, source)
        reader, crew = HeightReader(raster, settings), crew or Crew()
        with open_work(wanted, source) as (draft, work):  # work: that of a killed import of the same, or None
            if land is not None and work is None:
                copy_store(first_picture(path), draft.folder / store_folder.FIRST)
            field = _build_coarse(reader, source, wanted, draft, work, crew, on_progress)
            field = field.with_raster(
                origin=np.array([*place.middle, 0.0]),
                crs=place.crs,
                place=place.place,
                provenance=_provenance(given, raster, place, land, lattice),
            )
            if raster.finer is not None:
                field = _add_finer_tiles(field, HeightReader(raster, settings), draft, on_progress)
            report = report_of(field, source, reader.check)
            # Warnings name the file that the user gave, not its unpacked copy.
            report["warnings"] = [text.replace(str(file), given.source) for text in report["warnings"]]
            report["seconds"] = round(time.monotonic() - started, 3)
            raster.finish(draft.folder)
            if land is not None:
                _first_picture(given, raster, path)  # raises if it is gone: a complete import has ended meanwhile
            draft.publish(field, digest, report)
        if land is not None:
            remove_ahead(path)  # the files of tiles that were read before, which are in the store now
        return report
    finally:
        raster.close()


def _build_coarse(
    reader: HeightReader,
    source: TileSource,
    wanted: TileWork,
    draft: store.Draft,
    work: TileWork | None,
    crew: Crew,
    on_progress: Tell,
) -> HeightField:
    """Check and build the height field of a raster, without its finer tiles, in the arrays of a draft.

    reader: gets the figures of the heights that are read. wanted: the work to do, from its beginning. work: that of an
    unfinished import, to continue; None without one. on_progress: gets the fraction of the whole import.
    """
    raster = reader.raster
    # begin, end: fractions of the import at which the tiles are begun and done
    begin = _check_original(raster, reader.check, on_progress)  # of a resampled raster, whose values it has read
    end = 1.0 if raster.finer is None else COARSE_PROGRESS

    def tell(fraction: float, message: str) -> None:
        """Report a fraction of this step as one of the whole import."""
        on_progress(begin + (end - begin) * fraction, message)

    return build_by_tile(work, draft, wanted, source, reader, crew, tell)


def _check_original(raster: Raster, check: ValueCheck, on_progress: Tell) -> float:
    """Check the values of a resampled raster before its resampling, which mixes marks of missing samples with heights.

    Return the fraction of the progress that this took: 0 for a raster that is not resampled.
    """
    if raster.original is None:
        return 0.0
    for fraction, rows in raster.original.blocks():
        check.add(rows)
        on_progress(ORIGINAL_PROGRESS * fraction, READING)
    return ORIGINAL_PROGRESS


def _add_finer_tiles(field: HeightField, reader: HeightReader, draft: store.Draft, on_progress: Tell) -> HeightField:
    """Return the field with a mosaic's finer files in arrays of a draft. on_progress: gets COARSE_PROGRESS to 0.99.

    reader: gets the figures of the heights that are read.
    """
    source = reader.raster.finer
    assert source is not None, "the raster has finer files"
    work = work_in(draft.folder)
    assert work is not None, "its tiles were made there"

    def tell(done: float) -> None:
        """Report a fraction of this step as one of the whole import."""
        on_progress(COARSE_PROGRESS + (0.99 - COARSE_PROGRESS) * done, FINER)

    field = add_finer_tiles(field, source, reader, draft, work, tell)
    return dataclasses.replace(field, source_max=max(field.source_max, reader.source_max()))


def _first_picture(settings: ImportSettings, raster: Raster, path: Path) -> CoarseLand:
    """Return the coarse heights of the quick import in the store at `path`, around which tiles are loaded.

    Raises TerrainError if the store is of another source.
    """
    # A first picture of the same files has the same settings, without tiles to load.
    before, picture = dataclasses.replace(settings, loaded_tiles=(), loaded_finer=()), first_picture(path)
    if import_before(picture, before, raster) is None:
        raise TerrainError(
            f"The store {path} has no first picture of {settings.name}",
            expected="one of the same files, with the same paths and times, and of the same options",
            fix="import quickly first",
        )
    return coarse_land(settings, picture)


def _provenance(
    settings: ImportSettings, raster: Raster, place: Georeference, land: CoarseLand | None, lattice: Lattice
) -> dict:
    """Return the origin of a store's heights as JSON, with which the import can be repeated.

    If samples are left out, LOADED has two steps, metres: between those of the first picture, and between all samples
    of the source. REFINED has the step, metres, and the number of the loaded tiles.

    land: the heights of the first picture around loaded tiles; None if all tiles have one step.
    """
    values = dataclasses.asdict(settings)
    values["source"], *more = map(absolute_source, settings.sources)
    values["more_sources"] = tuple(more)
    values["no_data"] = None if settings.no_data is None else str(settings.no_data)
    loaded: dict = {} if raster.full_size is None else {LOADED: loaded_steps(raster, place)}
    if land is not None:
        step, full_step = loaded[LOADED]
        # A cell of the first picture has 2^land.bits cells of the loaded tiles a side.
        loaded = {LOADED: [step * 2.0**land.bits, full_step], REFINED: [step, len(land.loaded)]}
        loaded |= finer_provenance(raster, lattice, full_step)  # the same of squares of finer files, if any are loaded
    return {"settings": values, "format": raster.format, "stored": raster.stored, **loaded}


def place_of(settings: ImportSettings, raster: Raster) -> Georeference:
    """Return the raster's georeference; without one, samples are 1 m apart. An extent in the settings gives the steps.

    Raises TerrainError if the file's georeference gives a size that no terrain can have.
    """
    place = raster.georeference or Georeference(first_row_south=settings.first_row_south)
    width, height = _size(raster, place)
    if settings.extent is None:
        extent = place.step_x * max(width - 1, 1), place.step_y * max(height - 1, 1)
        if not all(SMALLEST_EXTENT < e < LARGEST_EXTENT for e in extent):
            raise TerrainError(
                f"{settings.name} is {extent[0]:g} x {extent[1]:g} m large by its georeference",
                expected=f"lengths between {SMALLEST_EXTENT:g} and {LARGEST_EXTENT:g} m",
                fix="give the extent in metres",
            )
        return place
    step_x, step_y = settings.extent[0] / max(width - 1, 1), settings.extent[1] / max(height - 1, 1)
    return dataclasses.replace(place, step_x=step_x, step_y=step_y, size_warnings=())


def _size(raster: Raster, georeference: Georeference) -> tuple[int, int]:
    """Return the numbers of a raster's samples along x and y of the terrain."""
    return (raster.height, raster.width) if georeference.transposed else (raster.width, raster.height)
