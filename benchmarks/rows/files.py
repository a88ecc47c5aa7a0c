# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of files: the import of a GeoTIFF, and of one with 16 times as many samples; frames and memory of the latter."""

import os
import shutil
import statistics
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.store import open_store
from ...cbt_terrain.field.store_folder import remove_store
from ...cbt_terrain.importing.import_process import import_source
from ...cbt_terrain.rasters.raster import ImportSettings
from ...cbt_terrain.run.owned_files import remove_file
from ..rig import scenes
from ..rig.child import run_child
from ..rig.measure import BenchmarkRow, time_ms
from ..rig.scenes import MILLION

IMPORT_LIMIT_MS = 5000.0
IMPORT_RUNS = 9
MOSAIC_SIDE, MOSAIC_RUNS = 8, 3
LARGE_SAMPLES = 16_385
# Bytes a sample in a store, rounded up.
STORE_BYTES = 18
SMALL = "4097 x 4097"


def import_row(tiff: Path, folder: Path) -> BenchmarkRow:
    """Measure the import of a GeoTIFF into a store, in a child process as in Blender, against a fixed limit."""
    times = [_import_ms(tiff, folder / "imported") for _ in range(IMPORT_RUNS)]
    ms, megabytes = statistics.median(times), tiff.stat().st_size / 1e6
    row = BenchmarkRow("import", scenes.SAMPLES**2, ms, "5 s", IMPORT_LIMIT_MS, first_ms=times[0])
    row.figures = {"file_mb": megabytes, "mb_per_s": megabytes / ms * 1e3}
    return row


def mosaic_row(field: HeightField, tiff: Path, folder: Path) -> BenchmarkRow:
    """Measure the processor time of an import of MOSAIC_SIDE^2 tiles against that of one file with the same samples."""
    tiles = folder / "tiles"
    array = tiles.with_suffix(".npy")
    np.save(array, field.heights())
    run_child("rig.tiff", array, tiles, field.lattice.step_x, MOSAIC_SIDE)
    remove_file(array, may_be_link=True)
    times: list[list[float]] = [[], []]
    for _ in range(MOSAIC_RUNS):
        for source, found in zip((tiles, tiff), times, strict=True):
            found.append(_import_cpu_ms(source, folder / "mosaic"))
    ms, baseline_ms = map(statistics.median, times)
    return BenchmarkRow("import_mosaic", field.samples.size, ms, "one file", baseline_ms, first_ms=times[0][0])


def large_rows(tiff: Path, folder: Path, note: Callable[[str], None]) -> Iterator[BenchmarkRow]:
    """Measure import, frames and memory of 16,385 x 16,385 samples against the same of 4,097 x 4,097."""
    needed, free = STORE_BYTES * LARGE_SAMPLES**2, shutil.disk_usage(folder).free
    if needed > free:
        note(f"The rows large need {needed / 1e9:.1f} GB in {folder}, where {free / 1e9:.1f} GB are free: left out.")
        return
    large_tiff, stores = write_large_tiff(folder / "large.tif"), (folder / "large", folder / "small")
    try:
        large_ms, small_ms = (_import_ms(path, store) for path, store in zip((large_tiff, tiff), stores, strict=True))
        row = BenchmarkRow("import_large", LARGE_SAMPLES**2, large_ms, f"{SMALL}, the same number of samples")
        row.baseline_ms = small_ms * (LARGE_SAMPLES / scenes.SAMPLES) ** 2
        row.ratio = large_ms / row.baseline_ms
        row.figures = {"file_mb": large_tiff.stat().st_size / 1e6, "store_mb": _store_mb(stores[0])}
        remove_file(large_tiff, may_be_link=True)
        yield row
        yield from _large_frames(*stores)
    finally:
        remove_file(large_tiff, may_be_link=True)
        for store in stores:
            remove_store(store)


def write_tiff(field: HeightField, path: Path) -> Path:
    """Write heights as a GeoTIFF in UTM, in a child process, since GDAL must not share one with Blender."""
    array = path.with_suffix(".npy")
    np.save(array, field.heights())
    return _tiff_of_array(array, field.lattice.step_x, path)


def write_large_tiff(path: Path) -> Path:
    """Write a GeoTIFF of LARGE_SAMPLES x LARGE_SAMPLES samples that repeats the noise, row by row."""
    period, array = scenes.SAMPLES - 1, path.with_suffix(".npy")
    tile, columns = scenes.noise(period), np.arange(LARGE_SAMPLES) % period
    heights = np.lib.format.open_memmap(array, "w+", np.float32, (LARGE_SAMPLES, LARGE_SAMPLES))
    for row in range(LARGE_SAMPLES):
        heights[row] = tile[row % period][columns]
    del heights
    return _tiff_of_array(array, scenes.SIDE / period, path)


def _tiff_of_array(array: Path, step: float, path: Path) -> Path:
    run_child("rig.tiff", array, path, step)
    remove_file(array, may_be_link=True)
    return path


def _import_ms(tiff: Path, store: Path) -> float:
    remove_store(store)  # an import into an up-to-date store does nothing
    return time_ms(lambda: import_source(ImportSettings(source=str(tiff)), store))


def _import_cpu_ms(source: Path, store: Path) -> float:
    """Return the processor time of an import's child process."""
    remove_store(store)
    before = os.times()
    import_source(ImportSettings(source=str(source)), store)
    after = os.times()
    return 1e3 * (after.children_user + after.children_system - before.children_user - before.children_system)


def _large_frames(store: Path, small_store: Path) -> Iterator[BenchmarkRow]:
    """Yield the rows of frames and of memory; `first_ms` starts with no file of the store in the system's cache."""
    results = []
    for path in (store, small_store):
        field = open_store(path)
        side = (field.lattice.width - 1) * field.lattice.step_x
        px = scenes.pixels_for(field, scenes.over(0, side), scenes.errors, MILLION)
        del field
        _drop_from_cache(path)
        results.append(run_child("rig.resident", path, px))
    large, small = results
    first_ms = large["first_ms"]
    yield BenchmarkRow("large_frame", MILLION, large["frame_ms"], SMALL, small["frame_ms"], first_ms=first_ms)
    if "own_mb" in large:
        ratio = (large["own_mb"] + large["mapped_mb"]) / (small["own_mb"] + small["mapped_mb"])
        row = BenchmarkRow("large_memory", MILLION, None, SMALL, ratio=ratio)
        row.figures = {name: large[name] for name in ("open_own_mb", "open_mapped_mb", "own_mb", "mapped_mb")}
        row.figures |= {f"small_{name}": small[name] for name in ("own_mb", "mapped_mb")}
        yield row


def _store_mb(store: Path) -> float:
    return sum(file.stat().st_size for file in store.rglob("*.npy")) / 1e6


def _drop_from_cache(store: Path) -> None:
    """Drop a store from the system's file cache, where the system offers that."""
    if not hasattr(os, "posix_fadvise"):
        return
    os.sync()
    for file in store.rglob("*.npy"):
        with file.open("rb") as handle:
            os.posix_fadvise(handle.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
