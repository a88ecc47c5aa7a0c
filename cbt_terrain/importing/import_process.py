# SPDX-License-Identifier: GPL-3.0-or-later
"""Import in a child process (store_job.py), so that a bad file or a clash of libraries cannot hurt Blender.

`import_source` waits for the child, an `ImportJob` is polled. The child drops the network and writing elsewhere
(guard.py) before it opens a file. The calling process parses no file from outside.
"""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

from ..errors import check_function, check_kind
from ..field import store_folder
from ..field.lands import LANDS
from ..rasters.raster import ImportSettings
from ..sandbox.guard import VARIABLES, guard_import
from ..sandbox.store_job import CHECK_FILE, FREE_MEMORY, READING, JobProgress, StoreJob, Tell, serve, wait_for
from .build_store import run_import
from .earlier_import import finished_import
from .source_list import files_of, may_name_several, names_several
from .tile_crew import start_crew
from .tile_import import ImportPart

MOSAIC = "cbt_terrain.mosaic.import_child"  # the child's module for several files

__all__ = ["ImportJob", "child_main", "import_source"]


class ImportJob(StoreJob):
    """An import that runs in a child process. Raises TerrainError at once for settings that cannot be used."""

    def __init__(self, settings: ImportSettings, store: str | os.PathLike, part: ImportPart | None = None) -> None:
        """Start importing into `store` in a child process, and remove what ended processes have left there.

        No process starts if the store has the content of one file already; for several files the child looks. part: the
        part to do, None for all.
        """
        store_folder.check_target(store)
        store_folder.remove_abandoned(Path(store))
        settings.check()
        several = names_several(settings)
        if several:
            files_of(settings)  # raises TerrainError for a missing one before a process starts
        super().__init__(
            # an archive may hold several files, too
            MOSAIC if may_name_several(settings) else "cbt_terrain.importing.import_process",
            store,
            {"settings": dataclasses.asdict(settings), "part": part and [part.step, sorted(part.numbers)]},
            what=f"The import of {settings.name}",
            fix=FREE_MEMORY if settings.source in LANDS else CHECK_FILE,
            reading=settings.source,
            watched=(JobProgress.message, READING),
            variables=VARIABLES,
            # The files that a tile index names are known to the child alone.
            report=None if several else finished_import(store, settings),
        )


def import_source(
    source: ImportSettings | str | os.PathLike,
    store: str | os.PathLike,
    on_progress: Tell = lambda _fraction, _message: None,
    on_preview: Callable[[dict], None] = lambda _preview: None,
    part: ImportPart | None = None,
) -> dict:
    """Import in a child process, wait, and return the report, with "unchanged" if the store held this source already.

    Args:
        source: settings, or a path or the name of a built-in terrain ("island") to import with default settings.
        on_progress: is called repeatedly with a fraction and a message; an exception from it stops the import.
        on_preview: is called with the report on several files before the long work.
        part: the part to do of the import, for a farm; an import without one then does the rest.

    Raises TerrainError, and leaves the store as it was before.
    """
    check_kind(part, (ImportPart, type(None)), "The part", "an ImportPart or None")
    check_function(on_progress, "on_progress")
    check_function(on_preview, "on_preview")
    if not isinstance(source, ImportSettings):
        source = ImportSettings(os.fspath(source) if isinstance(source, os.PathLike) else source)
    settings = source
    return wait_for(lambda: ImportJob(settings, store, part), on_progress, on_preview)


def child_main() -> None:
    """Import the source in the request on stdin, and report on stdout."""
    serve(import_one, lambda request: f"The import of {request['settings']['source']}")


def part_of(request: dict) -> ImportPart | None:
    """Return the part of an import that a request has, None for all."""
    return ImportPart(request["part"][0], frozenset(request["part"][1])) if request["part"] else None


def import_one(request: dict, on_progress: Tell, begin: Callable[[], None]) -> dict:
    """Import one file in the child process, sandboxed, and return the report. Raises TerrainError.

    request: settings, part, store and folder of ImportJob. begin: says that the child is ready, so threads may start.
    """
    settings, path = ImportSettings(**request["settings"]), Path(request["store"])
    crew = start_crew(settings, "cbt_terrain.importing.tile_crew")  # before the guard: a sandboxed process starts none
    try:
        guard_import(settings, path)
        begin()  # after the guard: threads started before it could still write elsewhere
        return run_import(settings, path, on_progress, request["folder"], crew=crew, part=part_of(request))
    finally:
        crew.close()
