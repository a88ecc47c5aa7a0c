# SPDX-License-Identifier: GPL-3.0-or-later
"""The report on height maps that are not imported; a sandboxed child process reads the files."""

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

from ..field import store_folder
from ..formats.archives import UnpackedFiles
from ..importing.source_info import describe_alone, describe_source
from ..importing.source_list import files_of, has_archives, may_name_several
from ..rasters.raster import ImportSettings
from ..run import child
from ..sandbox.guard import guard_import
from ..sandbox.store_job import READING, Tell, ask, serve
from .import_child import SCANNED, has_several, paths_of, unpacked_sources
from .mosaic_source import check_settings, georeference_of, mosaic_raster, open_composite
from .report import describe_mosaic


def describe_heights(settings: ImportSettings) -> dict:
    """Return the description of a height map or of a mosaic of several, by their headers. Raises TerrainError."""
    return describe_sources(settings) if may_name_several(settings) else describe_source(settings)


def describe_sources(settings: ImportSettings) -> dict:
    """Return the report on a mosaic of the settings' sources, or on the one height map of an archive.

    Raises TerrainError for files that cannot form a mosaic.
    """
    return _ask(settings)


def size_of_heights(settings: ImportSettings) -> tuple[int, int]:
    """Return the columns and rows of the raster that an import makes, by the headers of its files.

    Files are not compared with each other, so it takes less than half the time of `describe_heights`. Raises
    TerrainError like it.
    """
    several = may_name_several(settings)
    report = _ask(settings, only_size=True) if several else describe_source(settings)
    columns, rows = report["raster"]
    return columns, rows


def _ask(settings: ImportSettings, only_size: bool = False) -> dict:
    """Return the report of a child process on several sources. only_size: no more than the raster's size."""
    settings.check()
    files_of(settings)  # raises for sources that are not there, before a process starts
    request = {"settings": dataclasses.asdict(settings), "only_size": only_size}
    return ask("cbt_terrain.mosaic.mosaic_info", request, settings.name)


def child_main() -> None:
    """Answer the request on stdin."""
    serve(_describe, lambda request: f"Reading {request['settings']['source']}")


def _describe(request: dict, on_progress: Tell, *_: Any) -> dict:
    """Return the report, in a child process that first gives up its rights.

    request: the settings, and whether only the size is wanted. A further argument, the function of `serve` that starts
    its thread, is not used.
    """
    settings, scratch = ImportSettings(**request["settings"]), Path(tempfile.gettempdir())
    if not has_several(settings):
        return describe_alone(settings)
    check_settings(settings)
    folder = scratch if has_archives(settings) else None  # the only one in which it may write, for unpacked files
    guard_import(settings, folder, paths_of(settings))
    child.end_with_parent()
    with unpacked_sources(settings, scratch / store_folder.new_data_name()) as files:
        return _report(settings, on_progress, files, request["only_size"])


def _report(settings: ImportSettings, on_progress: Tell, files: UnpackedFiles, only_size: bool) -> dict:
    """Return the report. files: the unpacked height maps of archives. only_size: no more than the raster's size."""
    composite = open_composite(
        settings, store=None, on_progress=lambda done: on_progress(SCANNED * done, READING), unpacked=files
    )
    # Before each piece that is read, tell the parent that this process still works.
    composite.on_piece = lambda: on_progress(SCANNED, READING)
    try:
        raster = mosaic_raster(composite, settings)
        if only_size:
            return {"raster": [raster.width, raster.height]}
        report = describe_mosaic(composite, settings)
        place = georeference_of(composite.grid)
        report["warnings"] = [*report["warnings"], *raster.warnings, *place.warnings, *place.size_warnings]
        return report
    finally:
        composite.close()
