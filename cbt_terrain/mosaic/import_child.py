# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of a mosaic in a child process, sandboxed before it opens a file."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from ..field import store_folder
from ..formats.archives import UnpackedFiles, height_maps, unpacking
from ..formats.sources import check_file
from ..importing.build_store import import_raster
from ..importing.earlier_import import finished_import
from ..importing.import_process import import_one, part_of
from ..importing.source_list import INDEX_SUFFIXES, files_of, has_archives, may_name_several, names_several
from ..importing.thinning import stride_of
from ..importing.tile_crew import serve_tasks, start_crew
from ..importing.tile_import import Crew, ImportPart
from ..rasters.raster import ImportSettings, Raster
from ..rasters.source_formats import FORMATS
from ..sandbox.guard import guard_import
from ..sandbox.store_job import READING, Tell, serve
from .catalogue import earlier_paths
from .mosaic_source import mosaic_raster, open_composite
from .report import IMPORT_ENTRIES, covered_entry, describe_mosaic

SCANNED = 0.05  # of the progress: headers are read


def child_main() -> None:
    """Import the sources in the request on stdin, and report on stdout."""
    serve(_import, lambda request: f"The import of {ImportSettings(**request['settings']).name}")


def has_several(settings: ImportSettings) -> bool:
    """Return whether the sources are several files or one archive of several tiles. Raises TerrainError."""
    path = Path(settings.source)
    # Only a single .zip has to be opened to know it.
    if names_several(settings) or not may_name_several(settings):
        return names_several(settings)
    check_file(path)  # one archive
    return len(height_maps(path)) > 1


def paths_of(settings: ImportSettings) -> list[Path]:
    """Return the files that the import may open, by whose suffixes the sandbox keeps drivers.

    Files in a tile index are unknown before it is read, so a made-up name stands for each kind that it may name.
    """
    paths = files_of(settings)
    if any(path.suffix.lower() in INDEX_SUFFIXES for path in paths):
        paths += [Path(f"any{suffix}") for suffix, form in FORMATS.items() if form.may_be_indexed]
    return paths


@contextmanager
def unpacked_sources(settings: ImportSettings, folder: Path) -> Iterator[UnpackedFiles]:
    """Yield the unpacked height maps of the settings' archives; `folder` is made for the block if there are any."""
    if has_archives(settings):
        with unpacking(folder) as files:
            yield files
    else:
        yield UnpackedFiles()


def run_mosaic_import(
    settings: ImportSettings,
    path: Path,
    on_progress: Tell = lambda *_: None,
    folder: str | None = None,
    crew: Crew | None = None,
    part: ImportPart | None = None,
) -> dict:
    """Import a mosaic in this process and return the report. Raises TerrainError.

    Args:
        path: the store's folder.
        on_progress: gets a fraction and a message, and once also a report on the mosaic (`describe_mosaic`), unless the
            store has it already; an exception from it cancels the import.
        folder: name of the folder of arrays that is made in the store; None to choose a name.
        crew: processes that read and measure tiles; None for this process alone.
        part: the part of an import that this process does, if several share it; None for all.
    """
    store_folder.check_target(path)
    settings.check()
    folder = folder or store_folder.new_data_name()
    reached: tuple = (0.0, READING)  # the last progress: fraction and message; files are scanned in the first SCANNED

    def tell(done: float, message: str) -> None:
        """Pass progress on, and keep it, to be repeated while a piece of the mosaic takes long."""
        nonlocal reached
        reached = SCANNED + (1.0 - SCANNED) * done, message
        on_progress(*reached)

    def open_mosaic(settings: ImportSettings) -> Raster:
        """Return the composite of the sources as a raster.

        Report on it first, unless this process does a part of the import, the import leaves samples out, or the store
        has it already.
        """
        composite = open_composite(settings, path, lambda done: on_progress(SCANNED * done, READING), files)
        composite.on_piece = lambda: on_progress(*reached)  # may raise, which cancels the import
        raster = mosaic_raster(composite, settings)
        # By the paths that an older version has recorded, a mosaic that has not changed is recognised.
        raster.earlier_paths = lambda: earlier_paths(path, settings)
        whole = replace(settings, quick=0)  # a quick import of few samples is complete, too
        is_whole = not settings.quick or stride_of(raster.width, raster.height, settings.quick) == 1
        if part is None and is_whole and finished_import(path, whole, raster) is None:
            details = describe_mosaic(composite, settings)
            raster.warnings += details["warnings"]
            on_progress(SCANNED, READING, details | {"warnings": raster.warnings})
            raster.details |= {name: details[name] for name in IMPORT_ENTRIES if name in details}
        if part is None:
            raster.details |= covered_entry(composite)
        return raster

    with unpacked_sources(settings, path / store_folder.scratch_name(folder)) as files:
        file = Path(settings.source)
        return import_raster(settings, file, path, folder, tell, open_raster=open_mosaic, crew=crew, part=part)


def _import(request: dict, on_progress: Tell, begin: Callable[[], None]) -> dict:
    """Import in the child process, and return the report.

    on_progress: raises to cancel the import. begin: starts the thread that waits for the end of the parent (`serve`).
    """
    settings, path = ImportSettings(**request["settings"]), Path(request["store"])
    if not has_several(settings):
        return import_one(request, on_progress, begin)
    # Before the guard, because a sandboxed process starts none. With archives this process works alone, so that they
    # are unpacked once.
    crew = Crew() if has_archives(settings) else start_crew(settings, "cbt_terrain.mosaic.import_child")
    try:
        guard_mosaic(settings, path)
        begin()  # after the guard: threads started before it could still write elsewhere
        return run_mosaic_import(settings, path, on_progress, request["folder"], crew=crew, part=part_of(request))
    finally:
        crew.close()


def guard_mosaic(settings: ImportSettings, path: Path) -> None:
    """Drop this process's rights before the files of a mosaic are opened. path: the store's folder."""
    guard_import(settings, path, paths_of(settings))


def idle_main(line: bytes) -> None:
    """Do the tasks of a mosaic in an idle process (tile_crew.py)."""
    serve_tasks(line, guard_mosaic, lambda settings, folder: mosaic_raster(open_composite(settings, folder), settings))
