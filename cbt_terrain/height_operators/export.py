# SPDX-License-Identifier: GPL-3.0-or-later
"""Export of heights and layers of a store as rasters: float32 GeoTIFF with the georeference, or OpenEXR.

Heights go to `heights.tif` and each layer to `heights_NAME.tif`. The first row is the northern one, a pixel's centre is
a sample, holes are NaN. Samples have the raster's step or another one, and in finer tiles the heights of these. GDAL
writes in a child process, since it clashes with Blender.
"""

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..attributes.exr import ExrFile
from ..attributes.png import PngFile
from ..errors import TerrainError, check_path, unwritable
from ..field.heightfield import HeightField
from ..field.store import open_store
from ..field.store_folder import check_is_no_store
from ..importing.placing import is_placed, unit_lengths
from ..query.grid import GridAxis, check_grid_size, grid_axes
from ..run import child
from ..run.partial_files import is_device, remove_abandoned, written_beside
from ..sandbox.store_job import Tell, ask, serve
from .exported_rows import HEIGHTS, LINES, ExportedRows

MODULE = "cbt_terrain.height_operators.export"
OnProgress = Callable[[float], None]


def export_raster(
    store: str | os.PathLike,
    file: str | os.PathLike,
    names: tuple[str, ...] | None = None,
    on_progress: OnProgress = lambda _fraction: None,
    step: float = 0.0,
) -> list[Path]:
    """Write the heights of a store into `file` and its layers next to that; return the files. Raises TerrainError.

    names: which to write, HEIGHTS and names of layers; None for all. step: metres between samples, 0 for those of the
    raster. on_progress(fraction) is called repeatedly; an exception from it stops the export, and removes the file that
    is being written; complete files stay.
    """
    file = check_export(file)
    field = open_store(store)
    axes = grid_axes(field.lattice, step)  # raises TerrainError before any file is written
    known = (HEIGHTS, *field.layers)
    for name in names or ():
        if name not in known:
            raise TerrainError(f"The store {store} has no layer {name!r}", expected=f"some of {', '.join(known)}")
    files = {name: file.with_name(f"{file.stem}_{name}{file.suffix}") for name in names or known}
    check_grid_size(axes, FORMATS[file.suffix.lower()].dtype.itemsize * len(files))
    if HEIGHTS in files:
        files[HEIGHTS] = file
        field.raster.check_samples()  # raises TerrainError for a height that is not finite
    WRITERS[file.suffix.lower()](field, Path(store), files, on_progress, step)  # the function for this format
    return list(files.values())


def check_export(file: str | os.PathLike) -> Path:
    """Return the path of a raster to write. Raises TerrainError if it cannot be written, before hours of work."""
    file = Path(file)
    if file.suffix.lower() not in WRITERS:
        raise TerrainError(f"{file} is of no format for heights", expected=", ".join(WRITERS))
    check_path("The file", file)
    if not os.path.isdir(file.parent):
        problem = f"{file} cannot be written: there is no folder {file.parent}"
        raise TerrainError(problem, fix="create it or choose another")
    check_is_no_store(file.parent)
    if is_device(file):
        raise TerrainError(f"{file} is a device or a pipe", expected="a file", fix="choose another name")
    return file


def _strips(rows: ExportedRows, number: int, count: int, on_progress: OnProgress) -> Iterator[np.ndarray]:
    """Yield the strips of the layer `number` of `count`; call on_progress(fraction) after each.

    The fraction is that of all layers.
    """
    done, height = 0, rows.axes[1].inside
    for strip in rows.strips():
        yield strip
        done += len(strip)
        on_progress((number + done / height) / count)


def _write_exrs(field: HeightField, _store: Path, files: dict[str, Path], on_progress: OnProgress, step: float) -> None:
    """Write heights and layers as OpenEXR files. files: the file of each, by HEIGHTS or a layer's name."""
    for number, (name, path) in enumerate(files.items()):
        rows = ExportedRows(field, name, step)
        _write_exr(rows, _strips(rows, number, len(files), on_progress), path)


def _write_exr(rows: ExportedRows, strips: Iterable[np.ndarray], path: Path) -> None:
    """Write a layer, or heights, of a store as a single-channel OpenEXR image of 32 bits.

    strips: arrays of LINES rows, from the north; the last may be shorter. Raises TerrainError.
    """
    width, height = (axis.inside for axis in rows.axes)  # numbers of columns and rows
    try:
        with written_beside(path) as partial, ThreadPoolExecutor(2, "adaptive_terrain_export") as pool:
            exr = ExrFile(partial, width, channels=1, depth=32, text="", pool=pool, lines=height)
            try:
                for strip in strips:
                    exr.add(strip[..., None])
                exr.close()
            finally:
                exr.abandon()  # closes the file after an error
    except OSError as reason:
        raise unwritable(str(path), reason) from reason


def _write_tiffs(
    _field: HeightField, store: Path, files: dict[str, Path], on_progress: OnProgress, step: float
) -> None:
    """Write heights and layers as GeoTIFF files in a child process, since GDAL is not loaded in Blender.

    files: the file of each, by HEIGHTS or its name. step: metres between samples, 0 for the raster's. Raises
    TerrainError. `_field`, the open store, is for formats that this process writes.
    """
    paths = {name: str(path) for name, path in files.items()}
    request = {"store": str(store.absolute()), "files": paths, "step": step}
    try:
        ask(MODULE, request, f"the store {store}", lambda fraction, _message: on_progress(fraction))
    except BaseException:  # a killed child leaves its partial file
        for folder in {path.parent for path in files.values()}:
            remove_abandoned(folder)
        raise


@dataclass(frozen=True)
class RasterShape:
    """Size and position of one raster file.

    Attributes:
        width, height: samples of a row and of a column.
        transform: six numbers from pixels to coordinates, in rasterio's order.
        crs: name of the coordinate system, "" if it has none.
        has_missing: whether NaN marks missing samples.
        name: the band's name.
    """

    width: int
    height: int
    transform: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)
    crs: str = ""
    has_missing: bool = False
    name: str = HEIGHTS


class RowFile:
    """A raster that is written in blocks of rows from the top. `file`: a PngFile, an ExrFile, or a binary file."""

    def __init__(self, file: PngFile | ExrFile | BinaryIO, dtype: np.dtype):
        self._file, self._dtype = file, dtype

    def add(self, rows: np.ndarray) -> None:
        """Write the next rows [lines, columns], converted to the file's type."""
        rows = np.ascontiguousarray(rows, self._dtype)
        if isinstance(self._file, PngFile):
            self._file.add(rows.view(np.uint8))  # it takes the bytes of samples
        elif isinstance(self._file, ExrFile):
            self._file.add(rows[..., None])
        else:
            self._file.write(rows.tobytes())

    def close(self) -> None:
        """Complete the file."""
        self._file.close()

    def abandon(self) -> None:
        """Close the file without completing it, after an error."""
        getattr(self._file, "abandon", self._file.close)()


def _open_png(path: Path, shape: RasterShape, dtype: np.dtype, pool: Executor) -> RowFile:
    """Open a PNG file for rows of 8 or 16 bits. pool: threads that compress."""
    depth = 8 * dtype.itemsize
    return RowFile(PngFile(path, shape.width, channels=1, depth=depth, text="", pool=pool, lines=shape.height), dtype)


def _open_exr(path: Path, shape: RasterShape, dtype: np.dtype, pool: Executor) -> RowFile:
    """Open an OpenEXR file for rows of float32. pool: threads that compress."""
    return RowFile(ExrFile(path, shape.width, channels=1, depth=32, text="", pool=pool, lines=shape.height), dtype)


def _open_raw(path: Path, _shape: RasterShape, dtype: np.dtype, _pool: Executor) -> RowFile:
    """Open a RAW file, which has rows and nothing else."""
    return RowFile(open(path, "wb"), dtype)


def _convert_to_tiffs(paths: Iterable[Path], shapes: Iterable[RasterShape]) -> None:
    """Replace RAW files of float32, at least one, by GeoTIFF files with the same names, in one child process.

    shapes: size and georeference of each. Raises TerrainError.
    """
    raws = [{"path": str(path.absolute()), "shape": asdict(shape)} for path, shape in zip(paths, shapes, strict=True)]
    # The "store" is only named in errors.
    ask(MODULE, {"store": raws[0]["path"], "raws": raws}, "the rows of GeoTIFF files")


@dataclass(frozen=True)
class RasterFormat:
    """A format of exported rasters.

    Attributes:
        dtype: type of the file's numbers; integers need a scale and an offset.
        open: open(path, shape, dtype, pool) returns a RowFile.
        finish: finish(paths, shapes) completes files that `open` has written, None if nothing is left to do.
        keeps_missing: whether NaN marks missing samples; they are filled in other formats.
        export: export(field, store, files, on_progress, step) writes rasters of a whole store, None if `export_raster`
            does not offer it.
    """

    dtype: np.dtype
    open: Callable[[Path, RasterShape, np.dtype, Executor], RowFile]
    finish: Callable[[Iterable[Path], Iterable[RasterShape]], None] | None = None
    keeps_missing: bool = False
    export: Callable[[HeightField, Path, dict[str, Path], OnProgress, float], None] | None = None

    @property
    def is_integer(self) -> bool:
        """Return whether values are whole numbers from 0."""
        return self.dtype.kind == "u"


_TIFF = RasterFormat(np.dtype("<f4"), _open_raw, _convert_to_tiffs, keeps_missing=True, export=_write_tiffs)
FORMATS = {
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".exr": RasterFormat(np.dtype("<f4"), _open_exr, keeps_missing=True, export=_write_exrs),
    ".png": RasterFormat(np.dtype(">u2"), _open_png),
    ".r16": RasterFormat(np.dtype("<u2"), _open_raw),
    ".r32": RasterFormat(np.dtype("<f4"), _open_raw),
}
MASK_FORMAT = RasterFormat(np.dtype("u1"), _open_png)
# By suffix: a function that writes the rasters of a store into files, by the names of layers.
WRITERS = {suffix: form.export for suffix, form in FORMATS.items() if form.export is not None}


def child_main() -> None:
    """Answer one request on stdin, in a child process that may load GDAL."""
    serve(_answer, lambda request: f"Reading the store {request['store']}")


def _answer(request: dict, tell: Tell, _may_start_threads: Callable[[], None]) -> list[str]:
    """Write the requested GeoTIFFs in the child process, since rasterio must not be loaded into Blender.

    A request has `raws`, files of raw samples to convert, or a `store` with the files of its layers. Return the files
    of the store that were written, [] for `raws`. tell(fraction, message) reports progress.
    """
    child.end_with_parent()
    if "raws" in request:
        for raw in request["raws"]:
            shape = RasterShape(**raw["shape"])
            _write_tiff(Path(raw["path"]), _raw_strips(raw["path"], shape), shape)
        return []
    field = open_store(request["store"])
    missing, count = field.valid is not None, len(request["files"])
    for number, (name, path) in enumerate(request["files"].items()):
        rows = ExportedRows(field, name, request["step"])
        transform, crs = _georeference(field, request["store"], rows.axes)
        width, height = (axis.inside for axis in rows.axes)  # numbers of columns and rows
        shape = RasterShape(width, height, transform[:6], crs, has_missing=missing, name=name)
        _write_tiff(Path(path), _strips(rows, number, count, lambda fraction: tell(fraction, "Writing")), shape)
    return list(request["files"].values())


def _raw_strips(path: str, shape: RasterShape) -> Iterator[np.ndarray]:
    """Yield the rows of a RAW file of float32 in strips of LINES."""
    for first in range(0, shape.height, LINES):
        count = min(LINES, shape.height - first) * shape.width
        yield np.fromfile(path, "<f4", count, offset=4 * first * shape.width).reshape(-1, shape.width)


def _write_tiff(path: Path, strips: Iterable[np.ndarray], shape: RasterShape) -> None:
    """Write a raster to a GeoTIFF. Raises TerrainError.

    strips: arrays of LINES rows, from the north; the last may be shorter. shape: the raster's size, georeference, name,
    and whether it has missing samples (NaN).
    """
    import rasterio
    from rasterio.transform import Affine
    from rasterio.windows import Window

    options = {"driver": "GTiff", "width": shape.width, "height": shape.height, "count": 1, "dtype": "float32"}
    options |= {"transform": Affine(*shape.transform), "crs": shape.crs or None}
    options |= {"nodata": float("nan") if shape.has_missing else None}
    options |= {"compress": "deflate", "predictor": 3, "tiled": True, "BIGTIFF": "IF_SAFER"}
    try:
        with written_beside(path) as partial, rasterio.open(partial, "w", **options) as file:
            file.set_band_description(1, shape.name)
            for k, rows in enumerate(strips):
                file.write(rows, 1, window=Window(0, k * LINES, shape.width, len(rows)))
    except rasterio.errors.RasterioError as reason:
        raise unwritable(str(path), OSError(f"GDAL: {reason}")) from reason
    except OSError as reason:
        raise unwritable(str(path), reason) from reason


def _georeference(field: HeightField, store: str, axes: tuple[GridAxis, GridAxis]) -> tuple:
    """Return the transform from pixels to coordinates and the coordinate system, "" if it has no name.

    axes: positions of columns and rows. For a terrain without a system, rotated against it, or with an extent set by
    the user, coordinates are metres from the centre.
    """
    from rasterio.transform import Affine

    lattice, step_x, step_y = field.lattice, field.lattice.step_x, field.lattice.step_y
    x, y, crs = 0.0, 0.0, ""
    if is_placed(field, store):
        x, y = (float(c) for c in field.origin[:2])
        if field.crs:
            crs = field.crs
            metres_x, metres_y = unit_lengths(field)
            step_x, step_y = step_x / metres_x, step_y / metres_y
    west, north = x - lattice.width / 2 * step_x, y + lattice.height / 2 * step_y  # of the raster's pixels
    # Size of a pixel: `num` / `den` cells of the raster.
    across, down = (axis.num * cell / axis.den for axis, cell in zip(axes, (step_x, step_y), strict=True))
    west, north = west + (step_x - across) / 2, north - (step_y - down) / 2  # the first pixel keeps its centre
    return Affine(across, 0.0, west, 0.0, -down, north), crs
