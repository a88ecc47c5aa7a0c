# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of files: a GeoTIFF imported and reopened, and a raster that is larger than what a frame should touch."""

import os
import shutil
import statistics
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ...cbt_terrain.field.build import build
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.store import Draft, open_store
from ...cbt_terrain.field.store_folder import remove_store
from ...cbt_terrain.importing.import_process import import_source
from ...cbt_terrain.importing.raster import ImportSettings
from ...cbt_terrain.run.owned_files import remove_file
from ..rig import scenes
from ..rig.child import run_child
from ..rig.measure import BLOCKS, RUNS, Row, stopwatch

REOPEN_LIMIT_MS = 50.0
IMPORT_RUNS = 9
LARGE_SAMPLES = 16_385
LARGE_SIZES = (50_000, 1_000_000)
# Bytes a sample of a store, and some room.
STORE_BYTES = 18


def import_rows(tiff: Path, folder: Path) -> Iterator[Row]:
    """The GeoTIFF to a store, hierarchy included, in the import's own process as users have it; and opening that."""
    store, times = folder / "imported", []
    for _ in range(IMPORT_RUNS):
        remove_store(store)  # an import of what is there already would do nothing
        with stopwatch() as elapsed:
            import_source(ImportSettings(source=str(tiff)), store)
        times += elapsed
    ms, megabytes = statistics.median(times), tiff.stat().st_size / 1e6
    row = Row("import", scenes.SAMPLES**2, ms, first_ms=times[0])
    row.figures = {"file_mb": megabytes, "mb_per_s": megabytes / ms * 1e3}
    yield row
    ms = statistics.median(_opened(store) for _ in range(BLOCKS * RUNS))
    yield Row("import_reopen", scenes.SAMPLES**2, ms, "50 ms", REOPEN_LIMIT_MS)


def write_tiff(field: HeightField, path: Path) -> Path:
    """A GeoTIFF of metres in UTM, written by a process of its own: GDAL and Blender do not meet."""
    array = path.with_suffix(".npy")
    np.save(array, field.heights())
    run_child("rig.tiff", array, path, field.lattice.step_x)
    remove_file(array, may_be_link=True)
    return path


def large_rows(small_store: Path, folder: Path, note: Callable[[str], None]) -> Iterator[Row]:
    """A raster of 16385 x 16385: opening it, and time and memory of frames beside those of the 4097 x 4097."""
    needed, free = STORE_BYTES * LARGE_SAMPLES**2, shutil.disk_usage(folder).free
    if needed > free:
        note(f"The row large needs {needed / 1e9:.1f} GB in {folder}, where {free / 1e9:.1f} GB are free: left out.")
        return
    store = folder / "large"
    try:
        with stopwatch() as built:
            size_gb = build_large(store) / 1e9
        ms = statistics.median(_opened(store) for _ in range(BLOCKS * RUNS))
        row = Row("large_open", LARGE_SAMPLES**2, ms)
        row.figures = {"store_gb": size_gb, "built_s": built[0] / 1e3}
        yield row
        for size in LARGE_SIZES:
            yield from _large_frames(store, small_store, size)
    finally:
        remove_store(store)


def build_large(store: Path) -> int:
    """Repeat the noise over a raster of LARGE_SAMPLES, written row by row; returns the store's bytes."""
    period = scenes.SAMPLES - 1
    tile = scenes.noise(period)
    draft = Draft(store)
    try:
        samples = draft.allocate("samples", (LARGE_SAMPLES, LARGE_SAMPLES), np.dtype(np.float32))
        across = np.arange(LARGE_SAMPLES) % period
        for row in range(LARGE_SAMPLES):
            samples[row] = tile[row % period][across]
        step = scenes.SIDE / (scenes.SAMPLES - 1)
        field = build(samples, step, step, missing=0, allocate=draft.allocate)
        draft.publish(field, "benchmark", {})
    finally:
        draft.discard_unless_published()
    return sum(file.stat().st_size for file in store.rglob("*.npy"))


def _large_frames(store: Path, small_store: Path, size: int) -> Iterator[Row]:
    """`first_ms` is of a process that finds nothing of the store in the system's file cache."""
    found = {}
    for path in (store, small_store):
        field = open_store(path)
        side = (field.lattice.width - 1) * field.lattice.step_x
        px = scenes.pixels_for(field, lambda _px, side=side: scenes.over(0, side), scenes.errors, size)
        del field
        _forget_files(path)
        found[path] = run_child("rig.resident", path, px)
    large, small = found[store], found[small_store]
    row = Row("large_frame", size, large["frame_ms"], "4097 x 4097", small["frame_ms"], first_ms=large["first_ms"])
    yield row
    if "own_mb" in large:
        ratio = (large["own_mb"] + large["mapped_mb"]) / (small["own_mb"] + small["mapped_mb"])
        row = Row("large_memory", size, None, "4097 x 4097", ratio=ratio)
        row.figures = {name: large[name] for name in ("open_own_mb", "open_mapped_mb", "own_mb", "mapped_mb")}
        row.figures |= {f"small_{name}": small[name] for name in ("own_mb", "mapped_mb")}
        yield row


def _opened(store: Path) -> float:
    with stopwatch() as elapsed:
        open_store(store)
    return elapsed[0]


def _forget_files(store: Path) -> None:
    """Ask the system to drop a store from its file cache, where it can be asked."""
    if not hasattr(os, "posix_fadvise"):
        return
    os.sync()
    for file in store.rglob("*.npy"):
        with file.open("rb") as handle:
            os.posix_fadvise(handle.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
