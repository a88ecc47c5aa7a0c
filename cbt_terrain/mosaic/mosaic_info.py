# SPDX-License-Identifier: GPL-3.0-or-later
"""The report on a mosaic that is not imported; a sandboxed child process reads the files."""

import dataclasses
from typing import Any

from ...kernels.mosaic import resample
from ..importing.build_store import READING
from ..importing.guard import guard_import
from ..importing.import_process import what_of
from ..importing.raster import ImportSettings
from ..importing.source_list import files_of
from ..importing.store_job import Tell, ask, serve
from ..run import child
from .import_child import SCANNED, paths_of
from .mosaic_source import check_settings, georeference_of, mosaic_raster, open_composite
from .report import describe_mosaic


def describe_sources(settings: ImportSettings) -> dict:
    """Return the report on a mosaic of the settings' sources. Raises TerrainError for files that cannot form one."""
    check_settings(settings)
    files_of(settings)
    request = {"settings": dataclasses.asdict(settings)}
    return ask("cbt_terrain.mosaic.mosaic_info", request, what_of(settings.sources).removeprefix("The import of "))


def child_main() -> None:
    """Answer the request on stdin."""
    serve(_describe, lambda request: f"Reading {request['settings']['source']}")


def _describe(request: dict, on_progress: Tell, *_: Any) -> dict:
    """Return the report, in a child process that first gives up its rights."""
    settings = ImportSettings(**request["settings"])
    guard_import(settings, None, paths_of(settings), (resample,))
    child.end_with_parent()
    composite = open_composite(settings, None, lambda done: on_progress(SCANNED * done, READING))
    composite.on_piece = lambda: on_progress(SCANNED, READING)
    try:
        raster = mosaic_raster(composite, settings)
        report = describe_mosaic(composite, settings)
        place = georeference_of(composite.grid)
        report["warnings"] = [*report["warnings"], *raster.warnings, *place.warnings, *place.size_warnings]
        return report
    finally:
        composite.close()
