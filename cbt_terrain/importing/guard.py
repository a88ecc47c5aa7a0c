# SPDX-License-Identifier: GPL-3.0-or-later
"""What a child process does before it opens a height map: load what it needs, then give up what it does not.

Loading comes first, because it may write: Warp its kernels, Python its compiled modules.
"""

import tempfile
from contextlib import contextmanager
from pathlib import Path

from ...kernels import remove_temporary_cache
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
    """Drop this process's rights before a file of that suffix is opened; returns the report of `sandbox.enter`.

    folder: where this process may still write. Raises TerrainError if GDAL keeps other drivers than the needed ones.
    """
    if suffix in DRIVERS:
        keep_only_drivers(suffix)
    elif suffix == ".exr":
        import OpenEXR  # noqa: F401
    remove_temporary_cache()  # later this process may not
    return {**sandbox.enter(folder), "memory": sandbox.limit_memory(physical_memory() // 2)}


def guard_import(settings: ImportSettings, path: Path) -> None:
    """Load kernels, make the folder of the store `path`, and drop rights before an import. Raises TerrainError."""
    from ...kernels.field import codes, expand, fill, hierarchy, holes, ranges
    from ..field.lands import LANDS
    from ..run import launch
    from ..run.warmup import load

    with _removed_scratch():
        for module in (codes, expand, fill, hierarchy, ranges, *([holes] if settings.holes else [])):
            load(module)
        if settings.source in LANDS:
            launch.slices(LANDS[settings.source].kernel, [], step="load")  # loads the kernel and launches nothing
    store_folder.check_target(path)
    try:
        with open_folder(path, make=True):
            pass
    except OSError as reason:
        raise TerrainError(
            f"The store {path} cannot be written ({reason.strerror or reason}): make room or choose another folder."
        ) from reason
    guard(Path(settings.source).suffix.lower(), path)


@contextmanager
def _removed_scratch():
    """Remove temporary files of the block, such as Warp's precompiled headers: later this process may not."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as scratch:
        tempfile.tempdir = scratch
        try:
            yield
        finally:
            tempfile.tempdir = None
