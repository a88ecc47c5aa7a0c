# SPDX-License-Identifier: GPL-3.0-or-later
"""Recognition of a store that an earlier import has made of the same settings and files."""

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from ..errors import TerrainError
from ..field import store
from ..field.lands import LANDS
from ..formats.sources import check_file, check_named
from ..rasters.raster import ImportSettings, Raster
from ..rasters.sidecars import sidecars
from .source_list import absolute_source, file_stat, files_of, may_name_several, names_several

METHOD = 2  # increased when the same source gives a different store
RESAMPLING = 1  # increased when the same reprojected file gives a different store
HOLES = 1  # increased when the same file with holes cut out gives a different store
MASKS = 1  # increased when the same mask beside a file (.msk) gives a different store
# Settings that older versions lack. A digest has only their other values, so that it is that of an older version.
ADDED_SETTINGS = (
    *("more_sources", "priority", "step", "blend"),
    *("encoding", "cell", "quick", "loaded_tiles", "loaded_finer"),
)


def finished_import(path: str | os.PathLike, settings: ImportSettings, raster: Raster | None = None) -> dict | None:
    """Return the report of an earlier import with the same settings and files, None if there is none.

    For a quick import a complete one counts, too. raster: the opened source, which knows the files that it names; None
    if it names none.
    """
    complete = dataclasses.replace(settings, quick=0, loaded_tiles=(), loaded_finer=())
    for wanted in (complete, settings) if settings.quick else (settings,):
        report = import_before(path, wanted, raster)
        if report is not None:
            return report
    return None


def import_before(path: str | os.PathLike, settings: ImportSettings, raster: Raster | None = None) -> dict | None:
    """Return the report of an earlier import with exactly these settings and files, None if there is none.

    Older versions had other texts in a digest: the sources as they were written, often relative to an unknown folder,
    and paths of several files with `..`. So a second digest is tried, with the recorded sources and earlier paths.
    raster: the opened source, which knows the files that it names; None if it names none.
    """
    files, method = (raster.sources, raster.method) if raster is not None else ((), 0)
    report = finished_before(path, source_digest(settings, files, method))
    if report is None and (names := _recorded_sources(Path(path))) is not None:
        paths = raster.earlier_paths() if raster is not None else {}
        has_other_texts = paths or list(map(absolute_source, settings.sources)) != names
        if len(names) == len(settings.sources) and has_other_texts:
            report = finished_before(path, source_digest(settings, files, method, names, paths))
    return report


def _recorded_sources(path: Path) -> list[str] | None:
    """Return the sources in the record of a store, None for a store without a valid one."""
    try:
        recorded = store.read_json(path)["provenance"]["settings"]
        names = [recorded["source"], *recorded.get("more_sources", ())]
    except (TerrainError, KeyError, TypeError):
        return None
    return names if all(isinstance(name, str) for name in names) else None


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


def source_digest(
    settings: ImportSettings,
    sources: tuple[Path, ...] = (),
    method: int = 0,
    names: Sequence[str] | None = None,
    paths: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return a hex digest of the settings and of the paths, sizes and modification times of the source's files.

    sources: files that the source names. method: version of the method that makes the samples, 0 for none. names: texts
    for the sources in the digest; None for their absolute paths. paths: texts for the paths of several files in the
    digest, where they differ. Raises TerrainError for a missing source and for settings that cannot be used.
    """
    settings.check()
    values = dataclasses.asdict(settings)
    values["source"], *more = names or map(absolute_source, settings.sources)
    values["more_sources"] = tuple(more)
    # A new setting that is not used leaves the digest as older versions have it.
    for field in dataclasses.fields(settings):
        if field.name in ADDED_SETTINGS and values[field.name] == field.default:
            del values[field.name]
    parts = [METHOD, store.VERSION, values, *([method] if method else [])]  # what the digest is of, as JSON
    parts += [{"holes": HOLES}] if settings.holes else []
    if names_several(settings):  # a mosaic, whose `sources` have the further files of its tiles
        for file in [*files_of(settings), *sources]:
            check_named(file)
            name, size, changed_ns = file_stat(file)
            parts.append((paths.get(name, name), size, changed_ns))
        parts += [{"masks": MASKS}] if any(map(_is_mask, sources)) else []
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()
    # One file: the files that belong to it (sidecars) count as well.
    parts += [RESAMPLING] if settings.project else []
    if not may_name_several(settings):
        settings.check_file()
    if settings.source not in LANDS:
        source = Path(settings.source)
        check_file(source)
        files = [source, *sidecars(source), *sources]
        parts += [{"masks": MASKS}] if any(map(_is_mask, files)) else []
        for file in files:
            if os.path.isfile(file):  # Path.is_file raises if the suffix makes a name too long
                parts.append(file_stat(file.resolve()))
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _is_mask(path: Path) -> bool:
    """Return whether a file beside a raster is its mask, by its name."""
    return path.suffix.lower() == ".msk"
