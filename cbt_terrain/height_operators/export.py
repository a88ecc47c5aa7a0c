# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of heights and layers of a store as rasters: float32 GeoTIFF with the georeference, or OpenEXR.

Heights go to `heights.tif` and each layer to `heights_NAME.tif`. The first row is the northern one, a pixel's centre is
a sample, holes are NaN. GDAL writes in a child process, since it clashes with Blender.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from ..attributes.exr import ExrFile
from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..field.store import open_store
from ..importing.placing import is_placed, unit_lengths
from ..importing.store_job import ask, serve
from ..run import child
from ..run.partial_files import is_device, written_beside

MODULE = "cbt_terrain.height_operators.export"
LINES = 256  # whole blocks of either format
HEIGHTS = "heights"


def export_raster(
    store: str | os.PathLike, file: str | os.PathLike, names: tuple[str, ...] | None = None
) -> list[Path]:
    """Write the heights of a store into `file` and its layers next to that; return the files. Raises TerrainError.

    names: HEIGHTS and names of layers, None for all.
    """
    file = check_export(file)
    field = open_store(store)
    known = (HEIGHTS, *field.layers)
    for name in names or ():
        if name not in known:
            raise TerrainError(f"The store {store} has no layer {name!r}", expected=f"some of {', '.join(known)}")
    files = {name: _file_of(file, name) for name in names or known}
    if HEIGHTS in files:
        field.raster.check_samples()
    WRITERS[file.suffix.lower()](field, Path(store), files)
    return list(files.values())


def check_export(file: str | os.PathLike) -> Path:
    """Return the path of a raster to write. Raises TerrainError if it cannot be written, before hours of work."""
    file = Path(file)
    if file.suffix.lower() not in WRITERS:
        raise TerrainError(f"{file} is of no format for heights", expected=", ".join(WRITERS))
    if not file.parent.is_dir():
        problem = f"{file} cannot be written: there is no folder {file.parent}"
        raise TerrainError(problem, fix="create it or choose another")
    if is_device(file):
        raise TerrainError(f"{file} is a device or a pipe", expected="a file", fix="choose another name")
    return file


def _file_of(file: Path, name: str) -> Path:
    return file if name == HEIGHTS else file.with_name(f"{file.stem}_{name}{file.suffix}")


def _rows(field: HeightField, name: str, first: int) -> np.ndarray:
    """Return at most LINES lines from line `first` on, counted from the north, float32 [lines, columns]."""
    end = field.lattice.height - first
    rows = slice(max(end - LINES, 0), end)
    found = np.array(field.heights(rows) if name == HEIGHTS else field.layers[name][rows], np.float32)
    if field.valid is not None:
        found[field.valid[rows] == 0] = np.nan
    return found[::-1]


def _write_exrs(field: HeightField, _store: Path, files: dict[str, Path]) -> None:
    for name, path in files.items():
        _write_exr(field, name, path)


def _write_exr(field: HeightField, name: str, path: Path) -> None:
    lattice = field.lattice
    try:
        with written_beside(path) as partial, ThreadPoolExecutor(2, "adaptive_terrain_export") as pool:
            exr = ExrFile(partial, lattice.width, 1, 32, "", pool, lattice.height)
            try:
                for first in range(0, lattice.height, LINES):
                    exr.add(_rows(field, name, first)[..., None])
                exr.close()
            finally:
                exr.leave()
    except OSError as reason:
        raise _not_written(path, reason) from reason


def _not_written(path: Path, reason: OSError) -> TerrainError:
    problem = f"{path} cannot be written ({reason.strerror or reason})"
    return TerrainError(problem, fix="make room or choose another folder")


def _write_tiffs(_field: HeightField, store: Path, files: dict[str, Path]) -> None:
    request = {"store": str(store.absolute()), "files": {name: str(path) for name, path in files.items()}}
    ask(MODULE, request, f"the store {store}")


# By suffix: a function that writes the rasters of a store into files, by the names of layers.
WRITERS = {".tif": _write_tiffs, ".tiff": _write_tiffs, ".exr": _write_exrs}


def child_main() -> None:
    """Answer one request."""
    serve(_answer, lambda request: f"Reading the store {request['store']}")


def _answer(request: dict, *_) -> list[str]:
    child.end_with_parent()
    field = open_store(request["store"])
    georeference = _georeference(field, request["store"])
    for name, path in request["files"].items():
        try:
            _write_tiff(field, name, Path(path), georeference)
        except OSError as reason:
            raise _not_written(Path(path), reason) from reason
    return list(request["files"].values())


def _write_tiff(field: HeightField, name: str, path: Path, georeference: tuple) -> None:
    import rasterio
    from rasterio.windows import Window

    lattice, (transform, crs) = field.lattice, georeference
    options = {"driver": "GTiff", "width": lattice.width, "height": lattice.height, "count": 1, "dtype": "float32"}
    options |= {"transform": transform, "crs": crs, "nodata": float("nan") if field.valid is not None else None}
    options |= {"compress": "deflate", "predictor": 3, "tiled": True, "BIGTIFF": "IF_SAFER"}
    with written_beside(path) as partial:
        try:
            with rasterio.open(partial, "w", **options) as file:
                file.set_band_description(1, name)
                for first in range(0, lattice.height, LINES):
                    rows = _rows(field, name, first)
                    file.write(rows, 1, window=Window(0, first, lattice.width, len(rows)))
        except rasterio.errors.RasterioError as reason:
            raise OSError(f"GDAL: {reason}") from reason


def _georeference(field: HeightField, store: str) -> tuple:
    """Return the transform from pixels to coordinates and the coordinate system, None if it has no name.

    For a terrain without a system, rotated against it, or with an extent set by the user, coordinates are metres from
    the centre.
    """
    from rasterio.crs import CRS
    from rasterio.transform import Affine

    lattice, step_x, step_y = field.lattice, field.lattice.step_x, field.lattice.step_y
    x, y, crs = 0.0, 0.0, None
    if is_placed(field, store):
        x, y = (float(c) for c in field.origin[:2])
        if field.crs:
            crs = CRS.from_string(field.crs)
            metres_x, metres_y = unit_lengths(field)
            step_x, step_y = step_x / metres_x, step_y / metres_y
    west, north = x - lattice.width / 2 * step_x, y + lattice.height / 2 * step_y
    return Affine(step_x, 0.0, west, 0.0, -step_y, north), crs
