# SPDX-License-Identifier: GPL-3.0-or-later
"""What a child process does before it opens a height map: load what it needs, then give up what it does not.

Loading comes first, because it may write: Warp its kernels, Python its compiled modules.
"""

from pathlib import Path

from ..errors import TerrainError
from ..field import store_folder
from ..run.memory import physical_memory
from ..run.owned_files import open_folder
from . import sandbox
from .gdal_source import DRIVERS, keep_only_drivers
from .raster import ImportSettings

# The child's environment: no network for PROJ, no other threads (they would keep what this one gives up).
VARIABLES = {"PROJ_NETWORK": "OFF", "GDAL_DRIVER_PATH": "disable", "OPENBLAS_NUM_THREADS": "1"}


def guard(suffix: str, folder: Path | None) -> dict[str, str]:
    """Before a file of that suffix is opened. folder: where this process may still write. Returns what was dropped, as
    `sandbox.enter` says it. Raises TerrainError if GDAL cannot be held to the drivers that are needed."""
    if suffix in DRIVERS:
        keep_only_drivers(suffix)
    elif suffix == ".exr":
        import OpenEXR  # noqa: F401
    return {**sandbox.enter(folder), "memory": sandbox.limit_memory(physical_memory() // 2)}


def guard_import(settings: ImportSettings, path: Path) -> None:
    """Before an import into the store `path`, whose folder is made. Raises TerrainError."""
    from ...kernels import remove_temporary_cache
    from ...kernels.field import codes, expand, fill, hierarchy, holes, ranges
    from ..field.lands import LANDS
    from ..run import launch
    from ..run.warmup import load

    for module in (codes, expand, fill, hierarchy, ranges, *([holes] if settings.holes else [])):
        load(module)
    if settings.source in LANDS:
        launch.slices(LANDS[settings.source].kernel, [], step="load")  # loads the kernel and launches nothing
    remove_temporary_cache()
    store_folder.check_target(path)
    try:
        with open_folder(path, make=True):
            pass
    except OSError as reason:
        raise TerrainError(
            f"The store {path} cannot be written ({reason.strerror or reason}): make room or choose another folder."
        ) from reason
    guard(Path(settings.source).suffix.lower(), path)
