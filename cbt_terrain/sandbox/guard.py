# SPDX-License-Identifier: GPL-3.0-or-later
"""Preparation of a child process before it opens a height map: load libraries and kernels, then drop rights.

Loading comes first, because Warp writes kernels and Python writes compiled modules.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path

from ..errors import TerrainError, shown, unwritable
from ..field import store_folder
from ..formats.format_choice import inner_formats
from ..formats.gdal_source import keep_only_drivers
from ..rasters.raster import ImportSettings
from ..rasters.source_formats import SourceFormat, drivers_of
from ..run.memory import physical_memory
from ..run.owned_files import open_folder
from . import sandbox

# The child's environment: no network for PROJ, and no other threads, which would keep their rights.
VARIABLES = {"PROJ_NETWORK": "OFF", "GDAL_DRIVER_PATH": "disable", "OPENBLAS_NUM_THREADS": "1"}


def guard(paths: Iterable[Path], folder: Path | None) -> dict[str, str]:
    """Drop this process's rights before files are opened, and return the report of `sandbox.enter`, with "memory".

    paths: the files. folder: existing one, where this process may still write; None for no folder.

    Raises TerrainError if GDAL keeps drivers that the files do not need, and for a format with a large parser if a
    right remains.
    """
    from ...kernels import remove_temporary_cache

    forms: dict[str, tuple[SourceFormat, Path]] = {}
    drivers: set[str] = set()
    for path, form in [(each, form) for each in paths for form in inner_formats(each)]:
        forms[form.title] = form, path  # one file of each format, for errors
    for form, _path in forms.values():
        form.load()
        drivers |= drivers_of(form)
    if drivers:
        keep_only_drivers(drivers)
    remove_temporary_cache()  # not possible later
    rights = sandbox.enter(folder)
    for form, path in forms.values():
        if form.is_large:
            _check_rights(path, form, rights)
    return {**rights, "memory": sandbox.limit_memory(physical_memory() // 2)}


def _check_rights(path: Path, form: SourceFormat, rights: dict[str, str]) -> None:
    """Raise TerrainError if this process keeps a right, since the parser of the format is too large to trust.

    rights: report of `sandbox.enter`.
    """
    right = next((f"{name} {text}" for name, text in rights.items() if text != "dropped"), "")
    if right:
        raise TerrainError(
            f"{shown(path)} is not read here, because the parser of {form.title} is large and runs only in a process "
            f"without any rights ({right})",
            expected="Linux 5.19 or later with Landlock and seccomp",
            fix="import it there, or convert it to a GeoTIFF (gdal_translate) if you trust it",
        )


def guard_import(settings: ImportSettings, path: Path | None, files: Sequence[Path] = ()) -> None:
    """Load kernels, make the folder of the store `path`, and drop rights before an import. Raises TerrainError.

    Args:
        settings: of the import. `source` is a file or the name of a built-in terrain (LANDS), which has kernels, too.
        path: None for a process that writes nothing.
        files: the files of a mosaic; by default that of the settings.
    """
    from ...kernels.field import codes, expand, fill, hierarchy, holes, ranges, window_errors
    from ...kernels.mosaic import resample
    from ..field.lands import LANDS
    from ..run.warmup import load

    for module in (
        codes,
        expand,
        fill,
        hierarchy,
        ranges,
        window_errors,
        *([holes] if settings.holes else []),
        *([resample] if settings.source not in LANDS else []),  # also of one file, if it is sheared or reprojected
    ):
        load(module)
    if settings.source in LANDS:
        LANDS[settings.source].load()
    if path is not None:
        store_folder.check_target(path)
        try:
            with open_folder(path, make=True):
                pass
        except OSError as reason:
            raise unwritable(f"The store {path}", reason) from reason
    guard(files or [Path(settings.source)], path)
