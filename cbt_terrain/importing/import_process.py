# SPDX-License-Identifier: GPL-3.0-or-later
"""An import in a child process (store_job.py): a bad file or a clash of libraries cannot hurt the calling one, Blender.

`import_source` waits for it, an `ImportJob` is polled. The child gives up the network and writing elsewhere (guard.py)
before it opens a file, and nothing of a file from outside is parsed in the calling process.
"""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

from ..field import store_folder
from .build_store import READING, finished_before, run_import, source_digest
from .guard import VARIABLES, guard_import
from .raster import ImportSettings
from .store_job import Progress, StoreJob, Tell, serve, wait_for

__all__ = ["ImportJob", "Progress", "child_main", "import_source"]


class ImportJob(StoreJob):
    """An import that runs in a child process. Raises TerrainError at once for settings that cannot be used."""

    def __init__(self, settings: ImportSettings, store: str | os.PathLike):
        store_folder.check_target(store)
        store_folder.remove_abandoned(Path(store))
        super().__init__(
            "cbt_terrain.importing.import_process",
            store,
            {"settings": dataclasses.asdict(settings)},
            what=_what(settings.source),
            blame="the file may be damaged, or memory may have run out",
            reading=settings.source,
            watched=(Progress.message, READING),
            variables=VARIABLES,
            report=finished_before(store, source_digest(settings)),
        )


def _what(source: str) -> str:
    return f"The import of {source}"


def import_source(
    source: ImportSettings | str | os.PathLike,
    store: str | os.PathLike,
    on_progress: Tell = lambda _fraction, _message: None,
) -> dict:
    """Import in a child process and wait; returns the report, with "unchanged" if the store held this source already.

    source: settings, or a path or a built-in land, as "island", where their defaults do. on_progress(fraction, message)
    is called as it goes on; what it raises stops the import. Raises TerrainError. The store is then as it was before.
    """
    settings = source if isinstance(source, ImportSettings) else ImportSettings(os.fspath(source))
    return wait_for(lambda: ImportJob(settings, store), on_progress)


def child_main() -> None:
    """Read a request from stdin, import, and say on stdout how it goes."""
    serve(_import, lambda request: _what(request["settings"]["source"]))


def _import(request: dict, on_progress: Tell, begin: Callable[[], None]) -> dict:
    settings, path = request["settings"], Path(request["store"])
    for name in ("raw_size", "extent"):
        settings[name] = tuple(settings[name]) if settings[name] is not None else None
    guard_import(ImportSettings(**settings), path)
    begin()  # after the guard: a thread that was there before it would still be able to write elsewhere
    return run_import(ImportSettings(**settings), path, on_progress, request["folder"])
