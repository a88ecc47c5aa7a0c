# SPDX-License-Identifier: GPL-3.0-or-later
"""Ground points of LAS, LAZ and COPC files, gridded: each cell has the mean height of its points.

The file is read twice in pieces, first for the extent and the density, then for the heights, so that memory depends on
the number of cells alone. Cells without a point in gaps of at most 2 * REACH cells are filled from the gap's border
inwards, each with the mean of its filled neighbours. Wider gaps, such as lakes, stay without data.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..rasters.file_grid import unit_of
from ..rasters.raster import ImportSettings, Raster, cause
from ..rasters.rasterio_types import DatasetReader
from ..rasters.rounding import SourceRounding
from ..run.named_file import open_regular
from .las_header import las_damage

GROUND = 2  # class of points, by the ASPRS
PIECE = 1 << 20  # points read at a time
POINTS_A_CELL = 4.0  # in the mean, with the default cell
NICE = (1.0, 2.0, 5.0, 10.0)  # first digits of a default cell
MAX_CELLS = 1 << 26
REACH = 16  # cells
NO_DATA = -3.0e38
# Numbers of GeoTIFF keys, and the code of a system that has no EPSG code.
PROJECTED_KEY, VERTICAL_KEY, GEOGRAPHIC_KEY, USER_DEFINED = 3072, 4096, 2048, 32767


@dataclass
class GroundExtent:
    """Number and bounding box of ground points."""

    count: int = 0
    low: np.ndarray | float = math.inf  # float64 [2], lowest x and y in the file's unit; highest ones
    high: np.ndarray | float = -math.inf


def open_points(path: Path, settings: ImportSettings) -> Raster:
    """Grid the ground points of a file into a raster in memory, whose `close` releases it.

    Raises TerrainError if it has none or cannot be read, and for a grid of too few or too many cells.
    """
    from .gdal_files import start_gdal

    start_gdal()
    try:
        return _open(path.absolute(), settings)
    except (TerrainError, MemoryError):
        raise
    except Exception as reason:  # laspy raises many classes for a damaged file
        what = f"{shown(path)} cannot be read as LAS ({cause(reason)})"
        fix = 'get the file again; for .laz install pip\'s "laspy[lazrs]"'
        raise TerrainError(what, expected="a whole LAS, LAZ or COPC file", fix=fix) from reason


def _open(path: Path, settings: ImportSettings) -> Raster:
    """Return the ground points of a LAS or LAZ file as a raster.

    Raises TerrainError for a damaged file, one in degrees or one without ground points.
    """
    from .gdal_source import raster_of

    with open_regular(path, links=True) as file:
        damage = las_damage(file)
    if damage:
        raise TerrainError(f"{shown(path)} is damaged ({damage})", expected="a whole LAS or LAZ", fix="get it again")
    crs, z_step = _header(path)  # z_step: the distance of the heights that the file can store
    unit = unit_of(crs)
    if "degrees" in unit:
        what = f"{shown(path)} has its points in degrees"
        raise TerrainError(what, expected="metres or feet", fix="reproject it first (pdal translate)")
    extent = _extent(path)
    if not extent.count:
        raise TerrainError(
            f"{shown(path)} has no points of class {GROUND}",
            expected="classified ground points",
            fix="classify the ground first (pdal with filters.smrf)",
        )
    metres = unit.get("metres", 1.0)
    cell = settings.cell / metres if settings.cell is not None else _default_cell(extent)
    heights, west, north, num_filled = _grid(path, extent, cell)
    # The grid becomes a GeoTIFF in memory, so that `raster_of` treats its unit and place like those of a file.
    raster = raster_of(path, _in_memory(heights, crs, (cell, 0.0, west, 0.0, -cell, north)), settings, "GTiff")
    empty = int(np.isnan(heights).sum())
    note = (
        f"{extent.count:,} ground points became {heights.shape[1]} x {heights.shape[0]} cells of {cell * metres:.6g} "
        f"m. {num_filled:,} cells in gaps of at most {2 * REACH} cells were interpolated; {empty:,} in wider gaps and "
        "beyond the points have no data."
    )
    rounding = SourceRounding("float32", error=z_step / 2)
    return replace(raster, format="LAS ground points", roundings=(rounding,), warnings=[note, *raster.warnings])


def _header(path: Path) -> tuple[object, float]:
    """Return a file's coordinate system, a rasterio CRS or None, and the distance of the heights that it can store.

    The distance is in the unit of the file's heights. A system that PROJ does not know counts as none.
    """
    import laspy
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as reader:
        header = reader.header
    records = [*header.vlrs, *(header.evlrs or [])]
    keys = {}  # GeoTIFF keys of codes, by their number; a WKT is preferred
    for record in records:
        text = getattr(record, "string", "")
        if type(record).__name__ == "WktCoordinateSystemVlr" and text.strip("\0 "):
            try:
                return CRS.from_wkt(text.strip("\0 ")), abs(float(header.scales[2]))
            except CRSError:
                continue
        if type(record).__name__ == "GeoKeyDirectoryVlr":  # location 0: the value is the code itself
            keys = {key.id: key.value_offset for key in record.geo_keys if key.tiff_tag_location == 0}
    horizontal, vertical = keys.get(PROJECTED_KEY, 0) or keys.get(GEOGRAPHIC_KEY, 0), keys.get(VERTICAL_KEY, 0)
    usable = [code for code in (horizontal, vertical) if 0 < code < USER_DEFINED]
    try:
        crs = CRS.from_user_input("EPSG:" + "+".join(map(str, usable))) if horizontal in usable else None
    except CRSError:
        crs = None
    return crs, abs(float(header.scales[2]))


def _pieces(path: Path) -> Iterator[np.ndarray]:
    """Yield x, y and z of ground points, float64 [3, n] in the file's units, in pieces; a piece may be empty.

    Points that are marked as withheld, and those with a coordinate that is not finite, are left out.
    """
    import laspy

    with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as reader:
        for points in reader.chunk_iterator(PIECE):
            is_ground = np.asarray(points.classification) == GROUND
            if "withheld" in points.point_format.dimension_names:
                is_ground &= np.asarray(points.withheld) == 0
            coordinates = np.stack([np.asarray(axis)[is_ground] for axis in (points.x, points.y, points.z)])
            yield coordinates[:, np.isfinite(coordinates).all(axis=0)]


def _extent(path: Path) -> GroundExtent:
    """Return the number and the bounding box of a file's ground points."""
    extent = GroundExtent()
    for points in _pieces(path):
        if points.shape[1]:
            extent.count += points.shape[1]
            extent.low = np.minimum(extent.low, points[:2].min(axis=1))
            extent.high = np.maximum(extent.high, points[:2].max(axis=1))
    return extent


def _default_cell(extent: GroundExtent) -> float:
    """Return a cell, in the file's unit, that holds POINTS_A_CELL points in the mean, or more.

    It is 1, 2 or 5 times a power of 10. extent: of all ground points.
    """
    width, height = np.maximum(extent.high - extent.low, 1e-3)
    side = math.sqrt(POINTS_A_CELL * width * height / extent.count)
    power = 10.0 ** math.floor(math.log10(side))
    return float(f"{power * next(digit for digit in NICE if digit * power >= side * (1 - 1e-9)):.6g}")


def _grid(path: Path, extent: GroundExtent, cell: float) -> tuple[np.ndarray, float, float, int]:
    """Return (heights, west, north, num_filled): mean heights of cells, float32 [rows, columns], row 0 north.

    Cells without a height are NaN. west, north: coordinates of the grid's borders. num_filled: number of cells without
    points that were interpolated. cell: side of a cell in the file's unit. Cell borders are at multiples of it. extent:
    of all ground points. Raises TerrainError for fewer than 2 x 2 or more than MAX_CELLS cells.
    """
    first, last = np.floor(extent.low / cell), np.floor(extent.high / cell)
    columns, rows = (last - first).astype(np.int64) + 1
    if columns * rows > MAX_CELLS or min(columns, rows) < 2:
        raise TerrainError(
            f"{shown(path)} would have {columns:,} x {rows:,} cells of {cell:g} units",
            expected=f"at least 2 x 2 and at most {MAX_CELLS:,} cells",
            fix="give another cell size (--cell)",
        )
    total, count = np.zeros(columns * rows), np.zeros(columns * rows, np.uint32)
    for points in _pieces(path):  # [x, y and height, point]
        column, row = (np.floor(points[:2] / cell) - first[:, None]).astype(np.int64)
        # A file that changed since its extent was read may have points outside.
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        cells = ((rows - 1 - row) * columns + column)[inside]
        np.add.at(total, cells, points[2][inside])
        np.add.at(count, cells, 1)
    with np.errstate(invalid="ignore"):
        heights = (total / count).astype(np.float32).reshape(rows, columns)
    filled_heights = fill_gaps(heights, REACH)
    num_filled = int(np.isnan(heights).sum() - np.isnan(filled_heights).sum())
    return filled_heights, float(first[0] * cell), float((last[1] + 1) * cell), num_filled


def fill_gaps(heights: np.ndarray, reach: int) -> np.ndarray:
    """Return heights in which gaps (NaN) of at most 2 * `reach` cells are filled from their borders inwards."""
    padded = np.pad(heights, reach, constant_values=np.nan)
    valid = np.isfinite(padded)
    # Cells with a height, and those in narrow gaps: the morphological closing of `valid`. Growing `valid` by `reach`
    # cells closes narrow gaps for good; growing its complement again opens only the wide ones.
    narrow = ~_dilate(~_dilate(valid, reach), reach)
    for _ in range(reach):
        empty = np.isnan(padded)
        if not (empty & narrow).any():
            break
        known = np.where(empty, 0.0, padded)
        total, count = _sum_around(known), _sum_around((~empty).astype(np.float32))
        with np.errstate(invalid="ignore"):
            padded = np.where(empty & (count > 0), total / count, padded).astype(np.float32)
    inner = slice(reach, -reach)
    return np.where(narrow, padded, np.nan)[inner, inner].astype(np.float32)


def _dilate(mask: np.ndarray, steps: int) -> np.ndarray:
    """Return for each cell whether a cell of the mask is set within `steps` cells along both axes."""
    for axis in (0, 1):
        for _ in range(steps):
            mask = _dilate_along(mask, axis)
    return mask


def _dilate_along(mask: np.ndarray, axis: int) -> np.ndarray:
    """Return a mask united with itself one cell before and after along an axis."""
    turned = np.moveaxis(mask, axis, 0)
    dilated = turned.copy()
    dilated[1:] |= turned[:-1]
    dilated[:-1] |= turned[1:]
    return np.moveaxis(dilated, 0, axis)


def _sum_around(values: np.ndarray) -> np.ndarray:
    """Return for each cell the sum over the 3 x 3 cells around it; cells beyond the border count as 0."""
    rows = values.copy()
    rows[1:] += values[:-1]
    rows[:-1] += values[1:]
    sums = rows.copy()
    sums[:, 1:] += rows[:, :-1]
    sums[:, :-1] += rows[:, 1:]
    return sums


def _in_memory(heights: np.ndarray, crs: object, transform: tuple[float, ...]) -> DatasetReader:
    """Return a rasterio dataset of heights in memory, placed by a CRS and a transform; NaN becomes no data."""
    import rasterio
    from rasterio.transform import Affine

    rows, columns = heights.shape
    shape = {"width": columns, "height": rows, "count": 1, "dtype": "float32", "nodata": NO_DATA}
    memory = rasterio.MemoryFile(ext=".tif")
    with memory.open(driver="GTiff", crs=crs, transform=Affine(*transform), **shape) as copy:
        copy.write(np.where(np.isnan(heights), NO_DATA, heights).astype(np.float32), 1)
    return memory.open(driver="GTiff")
