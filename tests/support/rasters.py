# SPDX-License-Identifier: GPL-3.0-or-later
"""Height map files and stores for tests."""

import struct
import warnings
import zlib
from pathlib import Path

import numpy as np
from adaptive_terrain.cbt_terrain.field.build import build
from adaptive_terrain.cbt_terrain.field.store import Draft, open_store
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings


def jacksboro():
    """Return matplotlib's elevation model: int16 [344, 403] metres, row 0 north, 3 seconds a sample."""
    from matplotlib.cbook import get_sample_data

    return get_sample_data("jacksboro_fault_dem.npz")["elevation"]


def hills(width=40, height=30, seed=3):
    """Smooth float32 heights of about 200 to 800 m, row 0 north."""
    y, x = np.indices((height, width)) / 9.0
    noise = np.random.default_rng(seed).standard_normal((height, width))
    return (500.0 + 200.0 * np.sin(x) * np.cos(y) + 20.0 * noise).astype(np.float32)


def write_raster(path, heights, **options):
    """Write a 2-D array through rasterio; the driver follows from the suffix."""
    import rasterio

    heights = np.asarray(heights)
    shape = {"height": heights.shape[0], "width": heights.shape[1], "count": 1, "dtype": heights.dtype}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with rasterio.open(path, "w", **(shape | options)) as file:
            file.write(heights, 1)
    return path


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def write_exr(path, **channels):
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {name: np.ascontiguousarray(pixels) for name, pixels in channels.items()}).write(str(path))
    return path


def imported(tmp_path, source, **settings):
    """Import in this process into tmp_path / "store"; return the height field and the report."""
    report = run_import(ImportSettings(source=str(source), **settings), tmp_path / "store")
    return open_store(tmp_path / "store"), report


def store_heights(path: Path, heights: np.ndarray, step_x: float, step_y: float | None = None) -> Path:
    """Write a store of heights, float [rows, columns] with row 0 in the south; return its path.

    step_x, step_y: metres between samples; step_y is step_x by default.
    """
    draft = Draft(path)
    samples = draft.allocate("samples", heights.shape, np.float32)
    samples[:] = heights
    field = build(samples, step_x, step_y or step_x, missing=0, allocate=draft.allocate)
    draft.publish(field, path.name, {})
    return path
