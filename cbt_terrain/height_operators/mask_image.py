# SPDX-License-Identifier: GPL-3.0-or-later
"""Mask images: a sandboxed child process reads them and writes them as arrays."""

import os
from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..field.georeference import Georeference
from ..field.store_arrays import map_array, write_array
from ..formats.sources import check_file, open_source
from ..rasters.coded_heights import PLAIN
from ..rasters.raster import ImportSettings
from ..run import child, owned_files
from ..sandbox.guard import guard
from ..sandbox.store_job import ask, serve
from .tile_cache import compute_digest

MODULE = "cbt_terrain.height_operators.mask_image"
MAX_SAMPLES = 1 << 28


def load_image(file: str, folder: Path) -> np.ndarray:
    """Return any file that can be imported as float32 [rows, columns], 0 to 1, row 0 south. Raises TerrainError.

    Integers are divided by the largest of their type; missing pixels are 0. folder: caches the array.
    """
    check_file(Path(file), "mask")
    found = os.stat(file)
    key = compute_digest("mask", os.path.realpath(file), found.st_size, found.st_mtime_ns)
    request = {"file": file, "folder": str(folder.absolute()), "key": key}
    cached = folder / f"{key}.npy"
    shape = tuple(ask(MODULE, request, f"the mask {shown(file)}"))
    owned_files.touch(cached)
    return map_array(cached, shape, np.float32)


def child_main() -> None:
    """Answer one request on stdin, in a child process, because a damaged image may crash its library."""
    serve(_read, lambda request: f"Reading the mask {shown(request['file'])}")


def _read(request: dict, *_: object) -> list[int]:
    """Convert a mask image to a float32 array file, values 0 to 1, in a child process; return its rows and columns."""
    path, cached = Path(request["file"]), Path(request["folder"]) / f"{request['key']}.npy"
    guard([path], cached.parent)
    child.end_with_parent()
    raster = open_source(ImportSettings(str(path), encoding=PLAIN))
    try:
        if raster.width * raster.height > MAX_SAMPLES:
            raise TerrainError(
                f"The mask {shown(path)} has {raster.width} x {raster.height} pixels",
                expected=f"at most {MAX_SAMPLES:,}",
                fix="reduce it",
            )
        stored = np.dtype(raster.stored)
        largest = float(np.iinfo(stored).max) if stored.kind in "iu" else 1.0
        rows = raster.read(0, raster.height).astype(np.float32) / np.float32(largest)
        georeference = raster.georeference or Georeference()
        image = np.empty(rows.T.shape if georeference.transposed else rows.shape, np.float32)
        georeference.in_file_order(image)[:] = np.clip(np.nan_to_num(rows), 0.0, 1.0)
    finally:
        raster.close()
    write_array(cached, image)
    return list(image.shape)
