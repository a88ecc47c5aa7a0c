# SPDX-License-Identifier: GPL-3.0-or-later
"""`adaptive-terrain shape`: a stack of effects on heights applied to a store, into another store and into rasters."""

import time
from pathlib import Path

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.height_operators.shape_process import ShapeJob
from ...cbt_terrain.height_operators.stack import read_stack
from ...cbt_terrain.height_operators.tiles import tiles_seen
from ...cbt_terrain.sandbox.store_job import wait_for
from ..text.console import Progress
from .maps_command import views_along

# A larger raster is shaped as a whole only on request (`whole`).
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
    """Shape a store into the store `out`, wait for the end, and return the report.

    Args:
        stack: JSON file of height operators.
        path: camera path whose visible tiles are shaped; None for all tiles.
        frames: numbers of frames of the path, None for all.
        resolution: pixels of the path's camera.
        pixel_error: pixels of change below which visible tiles get no finer level.
        whole: allow shaping all tiles of a large raster.
        finish_early_s: seconds after which the levels that are done suffice.
        show_progress: whether there is a progress bar, None for one in a terminal only.
    """
    tiles, operators = None, read_stack(stack)  # None: all tiles
    field = open_store(store)
    if path is not None:
        tiles = tiles_seen(field, views_along(path, frames, resolution), pixel_error=pixel_error)
    elif not whole and field.samples.size > WHOLE_SAMPLES:
        raise TerrainError(
            f"The store {store} has {field.lattice.width} x {field.lattice.height} samples",
            fix="say which views count (--path FILE.json), or --whole for all of it",
        )
    started = time.monotonic()
    job = None

    def start_job() -> ShapeJob:
        """Start the child process and keep its handle for `on_progress`."""
        nonlocal job
        job = ShapeJob(store, operators, out, tiles)
        return job

    def on_progress(fraction: float, _message: str) -> None:
        """Move the progress bar, and let the job finish early once its time is over."""
        nonlocal finish_early_s
        bar.to(fraction)
        if finish_early_s is not None and time.monotonic() - started > finish_early_s:
            job.finish_early()
            finish_early_s = None

    with Progress(1.0, "shape", show_progress) as bar:
        return wait_for(start_job, on_progress)
