# SPDX-License-Identifier: GPL-3.0-or-later
"""Mask images: a sandboxed child process reads them and writes them as arrays."""

import re
from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..field.georeference import Georeference
from ..field.store_arrays import PAGE_BYTES, map_array, write_array
from ..formats.sources import check_file, open_source
from ..rasters.coded_heights import PLAIN
from ..rasters.raster import ImportSettings
from ..rasters.sidecars import sidecars
from ..run import child
from ..run.named_file import read_start
from ..sandbox.guard import guard
from ..sandbox.store_job import ask, serve
from .stack import file_identity
from .tile_cache import compute_digest, read_cached

MODULE = "cbt_terrain.height_operators.mask_image"
MAX_SAMPLES = 1 << 28
VERSION = 1  # of the conversion: arrays of another version are not reused


def load_image(file: str, folder: Path) -> np.ndarray:
    """Return any file that can be imported as float32 [rows, columns], 0 to 1, row 0 south. Raises TerrainError.

    Integers are divided by the largest of their type; missing pixels are 0. folder: keeps the array in a file named for
    the content of the image and its sidecars. Later calls map that file instead of reading the image.
    """
    path = Path(file)
    check_file(path, "mask")
    parts = (path, *sidecars(path))
    key = compute_digest("mask", VERSION, *((part.name, file_identity(str(part))) for part in parts))
    array_file = folder / f"{key}.npy"
    shape = _shape_in(array_file)
    image = None if shape is None else read_cached(array_file, shape)
    if image is None:
        request = {"file": file, "folder": str(folder.absolute()), "key": key}
        shape = tuple(ask(MODULE, request, f"the mask {shown(file)}"))
        image = map_array(array_file, shape, np.float32)
    return image


def _shape_in(array_file: Path) -> tuple[int, int] | None:
    """Return the rows and columns in the header of a .npy file; None if the file is missing or damaged."""
    try:
        match = re.search(rb"'shape': \((\d{1,9}), (\d{1,9})\)", read_start(array_file, PAGE_BYTES, links=False))
    except OSError:
        return None
    return None if match is None else (int(match[1]), int(match[2]))


def child_main() -> None:
    """Answer one request on stdin, in a child process, because a damaged image may crash its library."""
    serve(_read, lambda request: f"Reading the mask {shown(request['file'])}")


def _read(request: dict, *_: object) -> list[int]:
    """Convert a mask image to a float32 array file, values 0 to 1, in a child process; return its rows and columns.

    request: `file`, the image; `folder` and `key`, folder and name of the array file.
    """
    path, array_file = Path(request["file"]), Path(request["folder"]) / f"{request['key']}.npy"
    guard([path], array_file.parent)  # gives up all other rights than reading it and writing into that folder
    child.end_with_parent()
    raster = open_source(ImportSettings(str(path), encoding=PLAIN))  # colours are not coded heights
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
        # A view of `image` in the file's order is filled.
        georeference.in_file_order(image)[:] = np.clip(np.nan_to_num(rows), 0.0, 1.0)
    finally:
        raster.close()
    write_array(array_file, image)
    return list(image.shape)
