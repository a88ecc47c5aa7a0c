# SPDX-License-Identifier: GPL-3.0-or-later
"""`adaptive-terrain shape`: a stack of effects on heights applied to a store, into another store and into rasters."""

import time
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.height_operators.export import check_export, export_raster
from ...cbt_terrain.height_operators.shape_process import ShapeJob
from ...cbt_terrain.height_operators.stack import read_stack
from ...cbt_terrain.height_operators.tiles import tiles_seen
from ...cbt_terrain.importing.store_job import wait_for
from ..text.console import Progress
from .maps_command import views_of

__all__ = ["check_export", "export", "run"]

# A larger raster is shaped as a whole only where someone says so.
WHOLE_SAMPLES = 4097 * 4097


def run(
    store: Path,
    stack: Path,
    out: Path,
    *,
    path: Path | None = None,
    frames=None,
    resolution: tuple[int, int] = (1920, 1080),
    pixel_error: float = 1.0,
    whole: bool = False,
    finish_early_s: float | None = None,
    show_progress: bool | None = None,
) -> dict:
    """Shape and wait; return the report. path, frames: of the camera whose tiles are shaped, None for all tiles."""
    wanted, given = None, read_stack(stack)
    field = open_store(store)
    if path is not None:
        wanted = tiles_seen(field, views_of(path, frames, resolution), pixel_error=pixel_error)
    elif not whole and field.samples.size > WHOLE_SAMPLES:
        raise TerrainError(
            f"The store {store} has {field.lattice.width} x {field.lattice.height} samples",
            fix="say which views count (--path FILE.json), or --whole for all of it",
        )
    started = time.monotonic()
    bar = Progress(1.0, "shape", show_progress)
    job = None

    def start() -> ShapeJob:
        nonlocal job
        job = ShapeJob(store, given, out, wanted)
        return job

    def on_progress(fraction: float, _message: str) -> None:
        nonlocal finish_early_s
        bar.to(fraction)
        if finish_early_s is not None and time.monotonic() - started > finish_early_s:
            job.finish_early()
            finish_early_s = None

    try:
        return wait_for(start, on_progress)
    finally:
        bar.close()


def export(out: Path, file: Path) -> list[Path]:
    """Write heights and layers of the shaped store as rasters; return their paths."""
    return export_raster(out, file)
