# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of a source into a store, within the calling process."""

import dataclasses
import hashlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import TerrainError
from ..field import codes, store, store_folder
from ..field.build import build
from ..field.georeference import LARGEST_EXTENT, SMALLEST_EXTENT, Georeference, to_crs
from ..field.heightfield import HeightField
from ..field.lands import LANDS
from ..field.lattice import Lattice, lattice_for
from ..field.packing import copy_store
from ..formats.archives import is_archive, unpacked
from ..formats.sources import check_file, check_named, open_source
from ..rasters.raster import ImportSettings, Raster
from ..rasters.rounding import half_step, rounding_warnings
from ..rasters.sidecars import sidecars
from ..sandbox.store_job import READING, Tell
from ..tiling.coarse_land import CoarseLand
from ..tiling.tile_work import work_in
from .drafts import common_report_entries
from .finer_import import add_finer_tiles, finer_entries
from .height_range import fit_heights
from .height_reader import HeightReader, scaling_of
from .plausibility import ValueCheck, relief_warning
from .refining import coarse_land, first_picture, refined
from .source_list import file_stat, files_of, names_several
from .thinning import LOADED, REFINED, loaded_entries, loaded_steps, thinned
from .tile_import import (
    MEASURING,
    Crew,
    ImportPart,
    build_by_tile,
    check_tiled,
    do_part,
    is_tiled,
    open_work,
)
from .tile_tasks import TileSource

COARSE_SHARE = 0.4  # of the progress of a raster with finer tiles
FINER = "Reading finer files"  # message meanwhile
METHOD = 2  # increased when the same source gives a different store
DOUBT = ", or check that the header of {} has its true size"
# Settings that older versions lack. A digest has only their other values, so that it is that of an older version.
ADDED_SETTINGS = ("more_sources", "priority", "step", "blend", "encoding", "cell", "quick", "loaded_tiles")


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
    closes; None for this process. part: the part to do of an import by tile, which has the report of `do_part`; None
    for all that is not done yet. Raises TerrainError.
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
    open_raster: opens the source of the settings; its raster is closed here. Others: as of `run_import`.
    """
    started = time.monotonic()
    settings = dataclasses.replace(given, source=str(file)) if file != Path(given.source) else given
    raster = open_raster(settings)
    try:
        # The sources of a mosaic are known only now. For all other files the caller has checked this already.
        report = finished_import(path, given, raster) if raster.sources else None
        if report is not None:
            return report
        land = _first_picture(given, raster, path) if settings.loaded_tiles else None
        if land is not None:
            raster = refined(raster, settings, land)
        elif settings.quick:
            raster = thinned(raster, settings)
            if raster.full_size is None:
                given, settings = (dataclasses.replace(each, quick=0) for each in (given, settings))
        digest = source_digest(given, raster.sources, raster.method)
        place = place_of(settings, raster)
        width, height = (max(count, 2) for count in _size(raster, place))
        lattice = lattice_for(width, height, place.step_x, place.step_y, settings.name)
        fitted, notes = fit_heights(settings, raster, place.step_x * (width - 1))
        raster.warnings += notes
        if land is not None and fitted is not settings:  # the first picture has another range of values
            raise TerrainError(f"The heights of {settings.name} depend on all samples", fix="import all of it")
        settings = fitted
        source, doubt = TileSource(raster, settings, place, land), DOUBT.format(settings.name)
        if part is not None:
            check_tiled(raster, lattice, settings.name)
            return do_part(part, path, folder, source, lattice, digest, doubt)
        reader, crew = HeightReader(raster, settings), crew or Crew()
        by_tile = land is not None or is_tiled(raster, lattice)
        with open_work(path, folder, source, lattice, digest, by_tile, doubt) as (draft, work):
            begin = 0.0
            if land is not None and work is None:
                copy_store(first_picture(path), draft.folder / store_folder.FIRST)
            if raster.original is not None:  # resampling mixes marks of missing samples with heights
                begin = 0.1
                for share, rows in raster.original.blocks():
                    reader.check.add(rows)
                    on_progress(begin * share, READING)

            end = 1.0 if raster.finer is None else COARSE_SHARE

            def tell(share: float, message: str) -> None:
                on_progress(begin + (end - begin) * share, message)

            if by_tile:
                field = build_by_tile(work, draft, source, lattice, digest, reader, _source_max, crew, tell)
            else:
                field = _build(reader, place, draft, lattice, tell)
            field = field.with_raster(
                origin=np.array([*place.middle, 0.0]),
                crs=place.crs,
                place=place.place,
                provenance=_provenance(given, raster, place, land),
            )
            if raster.finer is not None:
                field = _add_finer_tiles(field, HeightReader(raster, settings), draft, on_progress)
            report = _import_report(field, raster, place)
            if settings.source not in LANDS:
                report["warnings"] += _value_warnings(raster, settings, place, report, reader.check)
            report["warnings"] = [text.replace(str(file), given.source) for text in report["warnings"]]
            report["seconds"] = round(time.monotonic() - started, 3)
            raster.finish(draft.folder)
            if land is not None:
                _first_picture(given, raster, path)  # a complete import has ended meanwhile if it is gone
            draft.publish(field, digest, report)
        return report
    finally:
        raster.close()


def _add_finer_tiles(field: HeightField, reader: HeightReader, draft: store.Draft, on_progress: Tell) -> HeightField:
    """Return the field with a mosaic's finer files in arrays of a draft. on_progress: gets COARSE_SHARE to 0.99."""
    source = reader.raster.finer
    assert source is not None, "the raster has finer files"
    share, work = (COARSE_SHARE, 0.99 - COARSE_SHARE), work_in(draft.folder)
    assert work is not None, "a raster with finer files is imported by tile"
    field = add_finer_tiles(
        field, source, reader, draft, work, lambda done: on_progress(share[0] + share[1] * done, FINER)
    )
    return dataclasses.replace(field, source_max=max(field.source_max, _source_max(reader)))


def _build(
    reader: HeightReader, place: Georeference, draft: store.Draft, lattice: Lattice, on_progress: Tell
) -> HeightField:
    """Build the height field of a raster in one piece, in the arrays of a draft.

    place: georeference. on_progress: gets 0 to 0.99 and a message. Raises TerrainError, as if all samples are missing.
    """
    raster, settings = reader.raster, reader.settings
    steps = codes.steps_of(np.dtype(raster.stored), *scaling_of(raster, settings))
    shape = lattice.height, lattice.width
    heights = draft.allocate("samples" if steps is None else "raster", shape, np.dtype(np.float32))
    _read_heights(reader, place, heights, lambda f: on_progress(0.5 * f, READING))
    field = build(
        heights,
        place.step_x,
        place.step_y,
        missing=reader.missing,
        holes=settings.holes,
        source_max=_source_max(reader),
        name=settings.name,
        allocate=draft.allocate,
        on_progress=lambda f: on_progress(0.5 + 0.49 * f, MEASURING),
    )
    return field if steps is None else field.with_raster(**_encode_samples(field, draft, steps))


def _first_picture(settings: ImportSettings, raster: Raster, path: Path) -> CoarseLand:
    """Return the land of the first picture in the store at `path`. Raises TerrainError if it is of another source."""
    before, picture = dataclasses.replace(settings, loaded_tiles=()), first_picture(path)
    if finished_before(picture, source_digest(before, raster.sources, raster.method)) is None:
        raise TerrainError(f"The store {path} has no first picture of {settings.name}", fix="import quickly first")
    return coarse_land(settings, picture)


def _provenance(settings: ImportSettings, raster: Raster, place: Georeference, land: CoarseLand | None) -> dict:
    """Return the origin of a store's heights as JSON, with which the import can be repeated.

    land: the coarse land around loaded tiles, of which LOADED has the step; None if all tiles are loaded.
    """
    values = dataclasses.asdict(settings)
    values["no_data"] = None if settings.no_data is None else str(settings.no_data)
    loaded: dict = {} if raster.full_size is None else {LOADED: loaded_steps(raster, place)}
    if land is not None:
        step, full = loaded[LOADED]
        loaded = {LOADED: [step * 2.0**land.bits, full], REFINED: [step, len(land.loaded)]}
    return {"settings": values, "format": raster.format, "stored": raster.stored, **loaded}


def source_digest(settings: ImportSettings, sources: tuple[Path, ...] = (), method: int = 0) -> str:
    """Return a hex digest of the settings and of the paths, sizes and modification times of the source's files.

    sources: files that the source names. method: version of the method that makes the samples, 0 for none. Raises
    TerrainError for a missing source and for settings that cannot be used.
    """
    settings.check()
    values = dataclasses.asdict(settings)
    for field in dataclasses.fields(settings):
        if field.name in ADDED_SETTINGS and values[field.name] == field.default:
            del values[field.name]
    parts = [METHOD, store.VERSION, values, *([method] if method else [])]
    if names_several(settings):
        for file in [*files_of(settings), *sources]:
            check_named(file)
            parts.append(file_stat(file))
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()
    settings.check_file()
    if settings.source not in LANDS:
        source = Path(settings.source)
        check_file(source)
        for file in [source, *sidecars(source), *sources]:
            if os.path.isfile(file):  # Path.is_file raises if the suffix makes a name too long
                parts.append(file_stat(file.resolve()))
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def finished_import(path: str | os.PathLike, settings: ImportSettings, raster: Raster | None = None) -> dict | None:
    """Return the report of an earlier import with the same settings and files, or for a quick one of a complete import.

    None if there is none. raster: the opened source, which knows the files that it names; None if it names none.
    """
    complete = dataclasses.replace(settings, quick=0, loaded_tiles=())
    files, method = (raster.sources, raster.method) if raster is not None else ((), 0)
    for wanted in (complete, settings) if settings.quick else (settings,):
        report = finished_before(path, source_digest(wanted, files, method))
        if report is not None:
            return report
    return None


def finished_before(path: str | os.PathLike, digest: str) -> dict | None:
    """Return a store's report, with "unchanged", if it has this digest; None otherwise, also for a damaged store."""
    try:
        content = store.read_json(Path(path))
        if content["digest"] != digest:
            return None
        store.open_store(path)
        return content["report"] | {"unchanged": True}
    except (TerrainError, KeyError):
        return None


def describe(path: str | os.PathLike) -> dict:
    """Return a store's report with further facts, a flat dict of numbers, texts and lists. Raises TerrainError."""
    content = store.read_json(Path(path))
    field = store.open_store(path)
    num_bytes = sum(array.nbytes for array in (field.samples, field.error, field.ranges))
    # A parent's error is at least its children's, so the coarsest group holds the largest.
    group = field.lattice.group(1)
    errors = field.error[codes.parts(field.lattice, len(field.error))[group]]
    return {
        "path": str(path),
        "source": content["provenance"].get("settings", {}).get("source", ""),
        **_border(field),
        **content["report"],
        "origin": content["origin"],
        "largest_error_m": float(field.table[group][errors.max()]),
        "bytes_per_sample": round(num_bytes / field.samples.size, 2),
        "key": field.raster.digest,
    }


def _border(field: HeightField) -> dict:
    """Return the entry with the coordinates of the outermost samples, {} without a system or for a rotated raster."""
    place = field.raster.place
    if place is None or not field.crs or place[1] or place[3]:
        return {}
    west, south, east, north = field.lattice.rectangle()
    corners = to_crs(place, np.array([[west, south], [east, north]]))
    return {"west_south_east_north": corners.ravel().tolist()}


def place_of(settings: ImportSettings, raster: Raster) -> Georeference:
    """Return the raster's georeference, or 1 m a sample, with the steps of the extent if one is given.

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


def _encode_samples(field: HeightField, draft: store.Draft, steps: codes.Steps) -> dict:
    """Store the samples as uint16 codes if these decode to bit-identical heights.

    Otherwise keep the float32 array "raster" under the name "samples". Return the raster's new `samples` and `steps`,
    or {}.
    """
    numbers = draft.allocate("samples", field.samples.shape, np.dtype(np.uint16))
    if codes.number(field.samples, steps, numbers):
        return {"samples": numbers, "steps": steps}
    del numbers
    draft.remove("samples")
    draft.rename("raster", "samples")
    return {}


def _read_heights(reader: HeightReader, place: Georeference, heights: np.ndarray, on_progress: Callable) -> None:
    """Fill `heights` (row 0 south) from a raster; `reader` gets the figures, `on_progress` the fraction of rows."""
    first = 0
    in_file_order = place.in_file_order(heights)
    for share, values in reader.raster.blocks():
        rows = reader.heights(values)
        in_file_order[first : first + len(rows)] = rows
        first += len(rows)
        on_progress(share)


def _source_max(reader: HeightReader) -> float:
    """Return the largest distance, metres, by which rounding and resampling have moved the heights that were read."""
    raster, settings = reader.raster, reader.settings
    if settings.source in LANDS:
        return 0.0
    scaling = scaling_of(raster, settings)
    step = half_step(tuple(rounding.scaled(*scaling) for rounding in raster.roundings), reader.largest)
    return step + reader.converted + (raster.moved + raster.shifted) * abs(scaling[0])


def _value_warnings(
    raster: Raster, settings: ImportSettings, place: Georeference, report: dict, check: ValueCheck
) -> list[str]:
    """Return warnings about values that are probably no heights in metres. report: figures of the import."""
    if settings.no_data is not None and np.isnan(settings.no_data):  # every value is a height
        return []
    found = check.warnings()
    if found or place.size_warnings:  # possible causes of heights that are too large for the extent
        return found
    is_sized = settings.extent is not None or raster.is_sized
    return relief_warning(report["lowest_m"], report["highest_m"], report["extent_m"], is_sized)


def _import_report(field: HeightField, raster: Raster, place: Georeference) -> dict:
    """Return an import's report: format, sizes, and the warnings of raster, georeference and rounding."""
    warnings = [*raster.warnings, *place.warnings, *place.size_warnings]
    largest = max(abs(field.min_height), abs(field.max_height))
    warnings += rounding_warnings(raster.roundings, largest, field.source_max)
    against = ""  # the file's raster
    if raster.projected_from:
        against = f"the raster as reprojected from {raster.projected_from} to {place.crs or 'a straight one'}, bilinear"
    return {
        "format": raster.format,
        "raster": [raster.width, raster.height],
        **common_report_entries(field),
        "rotation_deg": place.rotation_deg,
        "bounds_against": against,
        **finer_entries(field),
        **raster.details,
        **(loaded_entries(raster, field.provenance) if raster.full_size is not None else {}),  # replace bounds_against
        "warnings": warnings,
    }
