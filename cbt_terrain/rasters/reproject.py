# SPDX-License-Identifier: GPL-3.0-or-later
"""The grid of a raster in another coordinate system, on which it is resampled while it is read (resampled_file.py).

Resampling is bilinear like the reference surface, so new samples are on the raster's surface. Each is a mean of stored
values with weights from 0 to 1, so rounding errors do not grow. Cubic weights are partly negative: they overshoot at
cliffs and would increase rounding errors by half.
"""

import math
import re
from pathlib import Path

import numpy as np

from ..errors import TerrainError, shown
from ..view.linear import length, lengths
from .file_grid import FileGrid
from .raster import ImportSettings
from .rasterio_types import CRS, DatasetReader
from .resampled_file import Resampling

BORDER_SAMPLES = 1024  # points of each side that define the new raster's extent
MAX_GROWTH = 4.0  # largest ratio of new to old samples
EXTRA_SAMPLES = 1e4  # allowed beyond that ratio, for small rasters
INNER_SAMPLES = 33  # points along each axis that must survive the way to the new system and back
UNNAMED = 'LOCAL_CS["unnamed",UNIT["metre",1]]'  # for a sheared raster without a coordinate system
_MERIDIAN = re.compile(r'PRIMEM\["[^"]*",\s*([-+.\deE]+)(?:,AUTHORITY\["[^"]*","[^"]*"\])?\]')
_CODE = re.compile(r',AUTHORITY\["[^"]*","[^"]*"\]\]$')


def reproject(path: Path, dataset: DatasetReader, grid: FileGrid, settings: ImportSettings) -> Resampling:
    """Return a grid with the north up, about as dense along each axis as a rasterio dataset. Raises TerrainError.

    grid: grid of the dataset. settings: `project` names the new coordinate system; if empty, the system stays.
    """
    from rasterio.crs import CRS

    if grid.problem:
        raise TerrainError(
            f"{shown(path)} cannot be reprojected, because it {grid.problem}",
            fix=f"place the raster first ({grid.tool})",
        )
    if settings.project and grid.crs is None:
        raise TerrainError(
            f"{shown(path)} names no coordinate system, so it cannot be reprojected",
            fix="give it one (gdal_edit -a_srs), or import it as it is",
        )
    # `_centred`: its longitudes must not pass 180 degrees from the prime meridian. A sheared raster needs no system.
    source = _centred(grid, dataset) if grid.crs is not None else grid._replace(crs=CRS.from_wkt(UNNAMED))
    crs = _target_system(path, dataset, source, settings.project) if settings.project else source.crs
    transform, width, height = _target_grid(path, dataset, source, crs)
    size = dataset.width, dataset.height
    return Resampling(source, FileGrid(crs, transform), size, (width, height))


def _centred(grid: FileGrid, dataset: DatasetReader) -> FileGrid:
    """Return a grid with its prime meridian moved to its middle if its longitudes pass 180 degrees.

    PROJ returns longitudes within 180 degrees of the prime meridian, so it would miss samples beyond.
    """
    from rasterio.crs import CRS

    assert grid.crs is not None
    wkt = grid.crs.to_wkt()
    meridian = _MERIDIAN.search(wkt)
    # Only longitudes in degrees can pass 180.
    if not grid.crs.is_geographic or not meridian or abs(math.degrees(grid.crs.units_factor[1]) - 1.0) > 1e-9:
        return grid
    corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) * (dataset.width, dataset.height)
    longitudes, _ = grid.positions(*corners.T)
    if np.abs(longitudes).max() <= 180.0:
        return grid
    middle = float(longitudes.min() + longitudes.max()) / 2
    new_meridian = (float(meridian[1]) + middle + 180.0) % 360.0 - 180.0
    wkt = f'{wkt[: meridian.start()]}PRIMEM["moved",{new_meridian!r}]{wkt[meridian.end() :]}'
    a, b, c, d, e, f = grid.placed
    # Without its EPSG code, which would stand for the old meridian.
    return FileGrid(CRS.from_wkt(_CODE.sub("]", wkt)), (a, b, c - middle, d, e, f))


def _target_system(path: Path, dataset: DatasetReader, source: FileGrid, name: str) -> CRS:
    """Return the coordinate system that a name in ImportSettings.project means, "utm" or "EPSG:n".

    Raises TerrainError. source: grid of the dataset, whose UTM zone may be needed.
    """
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    if name.upper() == "UTM":
        middle = source.positions(np.array([dataset.width / 2]), np.array([dataset.height / 2]))
        x, y = _transform_points(path, source.crs, CRS.from_epsg(4326), *middle)
        name = utm_zone(shown(path), float(x[0]), float(y[0]))
    try:
        crs = CRS.from_epsg(int(name.partition(":")[2]))
    except (CRSError, ValueError) as reason:
        what = f"{name} is no coordinate system that PROJ knows"
        raise TerrainError(what, fix="give another, as EPSG:32632") from reason
    if not crs.is_projected:
        what = f"{name} does not measure in metres or feet"
        raise TerrainError(what, expected="a projected system, as EPSG:32632")
    return crs


def utm_zone(what: str, longitude: float, latitude: float) -> str:
    """Return the WGS 84 UTM zone of a point, degrees, as EPSG:n. Raises TerrainError beyond the latitudes of UTM.

    what: the raster in whose middle it is, in the error.
    """
    if not -80.0 <= latitude <= 84.0:
        raise TerrainError(
            f"{what} has its middle at latitude {latitude:.4g} degrees, and UTM ends at -80 and 84",
            fix="give a polar system, as EPSG:3413 or EPSG:3031",
        )
    zone = int((longitude + 180.0) // 6.0) % 60 + 1
    return f"EPSG:{(32600 if latitude >= 0.0 else 32700) + zone}"


def _target_grid(path: Path, dataset: DatasetReader, source: FileGrid, crs: CRS) -> tuple:
    """Return the new raster's transform, width and height: it covers the old samples and is as dense at its middle.

    Raises TerrainError. crs: the new system.
    """
    right, bottom = dataset.width - 0.5, dataset.height - 0.5  # samples are in the middle of cells
    columns, rows = np.linspace([0.5, 0.5], [right, bottom], BORDER_SAMPLES).T
    # the northern, southern, western and eastern side
    columns = np.concatenate([columns, columns, np.full_like(rows, 0.5), np.full_like(rows, right)])
    rows = np.concatenate([np.full_like(rows, 0.5), np.full_like(rows, bottom), rows, rows])
    x, y = _transform_points(path, source.crs, crs, *source.positions(columns, rows))
    column, row = dataset.width / 2, dataset.height / 2
    # the middle, and the next samples along its row and its column
    near = source.positions(np.array([column, column + 1.0, column]), np.array([row, row, row + 1.0]))
    near_x, near_y = _transform_points(path, source.crs, crs, *near)
    # Steps of a straight grid of the same density, from the steps along a row and along a column.
    step_x, step_y = _steps(near_x[1] - near_x[0], near_x[2] - near_x[0], near_y[1] - near_y[0], near_y[2] - near_y[0])
    # 1e-6: rounding must not lose the last column or row.
    width, height = (int(np.ptp(c) / step + 1e-6) + 1 for c, step in ((x, step_x), (y, step_y)))
    name = crs.to_string()[:80]
    if width * height > MAX_GROWTH * dataset.width * dataset.height + EXTRA_SAMPLES:
        raise TerrainError(
            f"{shown(path)} would have {width} x {height} samples in {name}, in place of {dataset.width} x "
            f"{dataset.height}, because it is oblique there or too far from that system's area",
            fix="choose another system",
        )
    _check_way_back(path, dataset, source, crs)
    return (step_x, 0.0, x.min() - step_x / 2, 0.0, -step_y, y.max() + step_y / 2), width, height


def _steps(column_x: float, row_x: float, column_y: float, row_y: float) -> tuple[float, float]:
    """Return the steps along x and y of a straight grid about as dense as one whose column and row steps are given.

    A grid that is almost parallel to the axes keeps its step along a row; any other gets squares. column_x, column_y:
    components of the step from a column to the next; row_x, row_y: from a row to the next.
    """
    column, row = length((column_x, column_y)), length((row_x, row_y))
    area = abs(column_x * row_y - column_y * row_x)
    if abs(column_y) < 0.1 * column:
        return column, area / column
    if abs(column_x) < 0.1 * column:
        return area / column, column
    step = max(min(column, row), math.sqrt(area / 2))  # the shorter step, but at most twice as many samples
    return step, step


def _check_way_back(path: Path, dataset: DatasetReader, source: FileGrid, crs: CRS) -> None:
    """Raise TerrainError for a raster whose points do not survive the way to the new system and back.

    A projected raster may pass the edge of its system, for example 180 degrees in Web Mercator. crs: the new system.
    """
    inner = np.linspace(0.02, 0.98, INNER_SAMPLES)
    columns, rows = (grid.ravel() for grid in np.meshgrid(inner * dataset.width, inner * dataset.height))
    x, y = source.positions(columns, rows)
    back_x, back_y = _transform_points(path, crs, source.crs, *_transform_points(path, source.crs, crs, x, y))
    a, b, _, d, e, _ = source.placed
    cell = max(length((a, d)), length((b, e)))
    if lengths(np.stack([back_x - x, back_y - y])).max() > cell:
        raise TerrainError(
            f"{shown(path)} passes the edge of its coordinate system {source.name[:80]}, so parts of it are "
            "not found in another one",
            fix="cut it there (gdalwarp -te), or import it as it is",
        )


def _transform_points(
    path: Path, source: CRS, target: CRS, x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions in another coordinate system, x and y, float64 [n] each.

    Raises TerrainError if one has no position there. target: the other system. path: the raster, for the error.
    """
    from rasterio.warp import transform

    try:
        transformed = np.array(transform(source, target, x, y)[:2])
    except Exception as reason:
        what = f"{shown(path)} cannot be brought into {target.to_string()} ({shown(reason)})"
        raise TerrainError(what, fix="choose another system") from reason
    if not np.isfinite(transformed).all():
        what = f"{shown(path)} extends beyond the area of {target.to_string()}"
        raise TerrainError(what, fix="choose another system")
    return transformed[0], transformed[1]
