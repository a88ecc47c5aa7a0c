# SPDX-License-Identifier: GPL-3.0-or-later
"""A raster in another coordinate system, resampled while it is read.

Bilinear, because the reference surface between samples is bilinear too: new samples lie on the raster's own surface,
never above or below it, and each is a mean of stored values with weights from 0 to 1, so that their rounding grows by
nothing. Cubic weights are negative in places: they overshoot at cliffs and would let it grow by half.
"""

import math
from pathlib import Path

import numpy as np

from ..ask.linear import lengths
from ..errors import TerrainError, shown
from .raster import ImportSettings, stands_for_missing

# Samples of the raster by which GDAL may be off where it interpolates positions: 3 cm in a raster of 30 m.
TOLERANCE = 0.001
RIM_SAMPLES = 1024  # of each side, by which the new raster's extent is found
MOST_GROWTH = 4.0  # times as many samples as before


def reprojected(path: Path, dataset, stored: np.dtype, settings: ImportSettings):
    """A view of a rasterio dataset (values `stored`) in the coordinate system `settings.project`: float64, NaN where
    there is none, north up, with about as many samples a metre along each axis. Raises TerrainError."""
    from rasterio.enums import Resampling
    from rasterio.vrt import WarpedVRT

    if dataset.crs is None:
        raise TerrainError(
            f"{shown(path)} names no coordinate system, so it cannot be reprojected: give it one (gdal_edit -a_srs), "
            "or import it as it is."
        )
    crs = _target(path, dataset, settings.project)
    transform, width, height = _grid(path, dataset, crs, settings.project)
    options = {}
    if settings.no_data is not None:
        value = settings.no_data
        options["src_nodata"] = value if stands_for_missing(value, stored) else None
    return WarpedVRT(
        dataset,
        crs=crs,
        transform=transform,
        width=width,
        height=height,
        resampling=Resampling.bilinear,
        tolerance=TOLERANCE,
        nodata=math.nan,
        dtype="float64",
        working_dtype="float64",
        XSCALE=1,  # plain interpolation, the same whatever part of the raster is read at once
        YSCALE=1,
        **options,
    )


def _target(path: Path, dataset, name: str):
    """The coordinate system that `name` (ImportSettings.project) asks for."""
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    if name.upper() == "UTM":
        name = _utm_zone(path, dataset)
    try:
        crs = CRS.from_epsg(int(name.partition(":")[2]))
    except (CRSError, ValueError) as reason:
        raise TerrainError(f"{name} is no coordinate system that PROJ knows: give another, as EPSG:32632.") from reason
    if not crs.is_projected:
        raise TerrainError(f"{name} does not measure in metres or feet: expected a projected system, as EPSG:32632.")
    return crs


def _utm_zone(path: Path, dataset) -> str:
    """The WGS 84 UTM zone of a raster's middle, as EPSG:n."""
    from rasterio.crs import CRS

    middle = _position(dataset, np.array([dataset.width / 2]), np.array([dataset.height / 2]))
    x, y = _transformed(path, dataset.crs, CRS.from_epsg(4326), *middle)
    longitude, latitude = float(x[0]), float(y[0])
    if not -80.0 <= latitude <= 84.0:
        raise TerrainError(
            f"{shown(path)} has its middle at latitude {latitude:.4g} degrees, and UTM ends at -80 and 84: give a "
            "polar system, as EPSG:3413 or EPSG:3031."
        )
    zone = int((longitude + 180.0) // 6.0) % 60 + 1
    return f"EPSG:{(32600 if latitude >= 0.0 else 32700) + zone}"


def _grid(path: Path, dataset, crs, name: str) -> tuple:
    """The new raster's transform, width and height: over the old one's samples, as dense as they are at its middle."""
    from rasterio.transform import Affine

    right, bottom = dataset.width - 0.5, dataset.height - 0.5  # samples lie in the middle of cells
    sides = np.linspace([0.5, 0.5], [right, bottom], RIM_SAMPLES)
    columns, rows = sides.T
    columns = np.concatenate([columns, columns, np.full_like(rows, 0.5), np.full_like(rows, right)])
    rows = np.concatenate([np.full_like(rows, 0.5), np.full_like(rows, bottom), rows, rows])
    x, y = _transformed(path, dataset.crs, crs, *_position(dataset, columns, rows))
    column, row = dataset.width / 2, dataset.height / 2
    near = _position(dataset, np.array([column, column + 1.0, column]), np.array([row, row, row + 1.0]))
    near_x, near_y = _transformed(path, dataset.crs, crs, *near)
    steps = lengths(np.stack([near_x[1:] - near_x[0], near_y[1:] - near_y[0]]))
    along_x = abs(near_y[1] - near_y[0]) < 0.1 * steps[0]
    step_x, step_y = steps if along_x else (steps.min(), steps.min())
    width, height = (int(np.ptp(c) / step + 1e-6) + 1 for c, step in ((x, step_x), (y, step_y)))
    if width * height > MOST_GROWTH * dataset.width * dataset.height + 1e4:
        raise TerrainError(
            f"{shown(path)} would have {width} x {height} samples in {name}, in place of {dataset.width} x "
            f"{dataset.height}: it lies too far from that system's area; choose another one."
        )
    return Affine(step_x, 0.0, x.min() - step_x / 2, 0.0, -step_y, y.max() + step_y / 2), width, height


def _position(dataset, columns: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where columns and rows (from the raster's corner) lie in its own coordinate system."""
    a, b, c, d, e, f = tuple(dataset.transform)[:6]
    return a * columns + b * rows + c, d * columns + e * rows + f


def _transformed(path: Path, source, target, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions in another coordinate system, float64 [n] each."""
    from rasterio.warp import transform

    try:
        moved = np.array(transform(source, target, x, y)[:2])
    except Exception as reason:
        raise TerrainError(
            f"{shown(path)} cannot be brought into {target.to_string()} ({shown(reason)}): choose another system."
        ) from reason
    if not np.isfinite(moved).all():
        raise TerrainError(
            f"{shown(path)} reaches to where {target.to_string()} is not defined: choose another system."
        )
    return moved[0], moved[1]
