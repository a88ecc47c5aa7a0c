# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasters through rasterio (GDAL): GeoTIFF, BigTIFF, COG, SRTM .hgt, PNG, ASCII grid, VRT.

rasterio is imported inside `open_raster` only, which runs in the import's child process: its libraries must not meet
those of Blender.
"""

import math
import warnings
from pathlib import Path

import numpy as np

from .errors import TerrainError
from .georeference import Georeference, ellipsoid_of, from_transform
from .sources import ImportSettings, Raster, blank, physical_memory

# GDAL may try no other driver on a file than the one of its suffix.
DRIVERS = {".tif": "GTiff", ".tiff": "GTiff", ".hgt": "SRTMHGT", ".png": "PNG", ".asc": "AAIGrid", ".vrt": "VRT"}
# No network, no code out of a file, no sidecar files written, a bounded cache.
OPTIONS = {
    "GDAL_CACHEMAX": 256,
    "GDAL_PAM_ENABLED": "NO",
    "GDAL_VRT_ENABLE_PYTHON": "NO",
    "CPL_VSIL_CURL_ALLOWED_FILENAME": "none",
}
UNITS_IN_METRES = {"ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "us survey foot": 1200.0 / 3937.0, "cm": 0.01}


def open_raster(path: Path, settings: ImportSettings) -> Raster:
    """Open a raster file. Raises TerrainError if GDAL cannot."""
    import rasterio
    from rasterio.enums import ColorInterp, MaskFlags
    from rasterio.errors import RasterioError
    from rasterio.windows import Window

    failures = (RasterioError, ValueError, OSError)
    rasterio.Env(**OPTIONS).__enter__()  # for as long as this process reads
    driver = DRIVERS[path.suffix.lower()]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a raster without a georeference is told about in the report
            dataset = rasterio.open(path, driver=driver, sharing=False)
    except failures as reason:
        hint = "a name like N36W085.hgt" if driver == "SRTMHGT" else "a whole file of that kind"
        raise TerrainError(f"{path} cannot be read as {driver} ({_short(reason)}): expected {hint}.") from reason
    band = settings.band
    if not 1 <= band <= dataset.count:
        raise TerrainError(f"{path} has {dataset.count} band(s), band {band} was asked for: choose one that it has.")
    stored = np.dtype(dataset.dtypes[band - 1])
    if stored.kind not in "fiu":
        raise TerrainError(f"{path} holds {stored} values: expected real numbers.")
    block_rows, block_columns = dataset.block_shapes[band - 1]
    _check_block(path, block_rows, block_columns, stored)
    flags = dataset.mask_flag_enums[band - 1]
    masked = settings.no_data is None and MaskFlags.all_valid not in flags

    def read(first: int, count: int) -> np.ndarray:
        window = Window(0, first, dataset.width, count)
        try:
            rows = dataset.read(band, window=window)
            mask = dataset.read_masks(band, window=window) if masked else None
        except failures as reason:
            raise TerrainError(
                f"{path} is damaged or incomplete in rows {first} to {first + count - 1} ({_short(reason)}): get the "
                "file again."
            ) from reason
        if mask is not None:
            rows = rows.astype(np.float64 if rows.itemsize > 2 and rows.dtype != np.float32 else np.float32)
            rows[mask == 0] = np.nan
            return rows
        return blank(rows, settings.no_data)

    notes = []
    if dataset.count > 1 and dataset.driver == "PNG":
        notes.append(f"The PNG has {dataset.count} channels; band {band} is taken as the height.")
    if dataset.colorinterp[band - 1] == ColorInterp.palette:
        notes.append("The file's samples are numbers of colours in a palette, not heights: save it as grey values.")
    if stored.itemsize == 1:
        notes.append("The file has 8 bits a sample: heights in at most 256 steps.")
    unit = (dataset.units[band - 1] or "").strip().lower()
    in_metres = UNITS_IN_METRES.get(unit, 1.0)
    if in_metres != 1.0:
        notes.append(f"Heights are in {unit} in the file; they were converted to metres.")
    return Raster(
        width=dataset.width,
        height=dataset.height,
        read=read,
        block_rows=block_rows,
        stored=str(stored),
        format=dataset.driver,
        georeference=_georeference(dataset),
        scale=dataset.scales[band - 1] * in_metres,
        offset=dataset.offsets[band - 1] * in_metres,
        warnings=notes,
        close=dataset.close,
    )


def _georeference(dataset) -> Georeference | None:
    if dataset.transform.is_identity and dataset.crs is None:
        return None
    crs, about = dataset.crs, {}
    if crs is not None and crs.is_geographic:
        about["degrees"] = math.degrees(crs.units_factor[1])
        about["ellipsoid"] = ellipsoid_of(crs.to_wkt())
    elif crs is not None and crs.is_projected:
        about["metres"] = crs.linear_units_factor[1]
    name = crs.to_string() if crs is not None else ""
    return from_transform(tuple(dataset.transform)[:6], dataset.width, dataset.height, crs=name, **about)


def _check_block(path: Path, rows: int, columns: int, stored: np.dtype) -> None:
    """Refuse a file whose smallest readable piece does not fit into memory, before GDAL asks for it."""
    size = rows * columns * stored.itemsize
    if size > physical_memory() // 4:
        raise TerrainError(
            f"{path} is stored in pieces of {size / 1e9:.1f} GB, more than a quarter of this machine's memory: write "
            "it again with smaller tiles or strips."
        )


def _short(reason: BaseException) -> str:
    """GDAL's message without line breaks."""
    return " ".join(str(reason.__cause__ or reason).split()).rstrip(".")
