# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about projected coordinate systems with wrong lengths, such as Web Mercator, or mirrored axes."""

import math

import numpy as np

from ..field.georeference import Georeference, degree_lengths, ellipsoid_of
from ..view.linear import length, lengths
from .file_grid import FileGrid, base_crs
from .rasterio_types import CRS

MAX_SCALE_ERROR = 0.01  # fraction of a length
MIN_STEP = 1e-4  # metres; coordinates on Earth have too few digits to measure shorter steps
BORDER_POINTS = 9  # along each side


def length_warnings(grid: FileGrid, width: int, height: int, place: Georeference) -> list[str]:
    """Return a warning if steps of `place` are off by more than MAX_SCALE_ERROR at the raster's middle or border.

    True steps are differences of longitude and latitude over a cell, times the length of a degree on the ellipsoid.
    width, height: samples of the raster.
    """
    if grid.crs is None or not grid.crs.is_projected or min(place.step_x, place.step_y) < MIN_STEP:
        return []
    factors, latitude = _factors(grid, width, height, place)
    if not len(factors) or np.abs(factors - 1.0).max() <= MAX_SCALE_ERROR:
        return []
    middle, low, high = factors[0], factors.min(), factors.max()
    remedy = _remedy(grid.name, latitude)
    if _passes_edge(grid, width, height):
        remedy = "give the extent in metres (--extent): it passes the edge of its system, so it cannot be reprojected"
    return [
        f"Lengths in {grid.name[:80]} are not those on the ground: in the middle of the raster they are "
        f"{middle[0]:.4g} times the true ones along x and {middle[1]:.4g} times along y, and {low:.4g} to {high:.4g} "
        f"times up to its border, while heights are true. To have them right, {remedy}."
    ]


def mirror_warnings(grid: FileGrid, width: int, height: int) -> list[str]:
    """Return a warning if x and y of a system are left-handed at the raster's middle, so the ground is mirrored.

    width, height: samples of the raster.
    """
    if grid.crs is None or not grid.crs.is_projected:
        return []
    a, b, _, d, e, _ = grid.placed
    x, y = grid.positions(width / 2, height / 2)
    step = max(length((a, d)), length((b, e)), 1.0)
    # Two points along x, then two along y, a cell apart, but at least a unit of the system.
    transformed = _degrees(
        grid.crs, x + step * np.array([-0.5, 0.5, 0.0, 0.0]), y + step * np.array([0.0, 0.0, -0.5, 0.5])
    )
    if transformed is None or not np.isfinite(transformed[0]).all():
        return []
    longitude, latitude = np.radians(transformed[0])  # of the four points, from degrees [2, 4]
    # The same points as unit vectors from the centre of the Earth.
    points = np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    along_x, along_y, up = points[:, 1] - points[:, 0], points[:, 3] - points[:, 2], points.sum(axis=1)
    if (np.cross(along_x, along_y) * up).sum() >= 0.0:  # x, y and up are right-handed
        return []
    name = grid.name[:80]
    # Degrees east and north from the first to the second point, along x and along y.
    east = _within_180(transformed[0][0, 1::2] - transformed[0][0, ::2]) * np.cos(latitude.mean())
    north = transformed[0][1, 1::2] - transformed[0][1, ::2]
    ways = " and ".join(map(_direction, east, north))
    return [
        f"x and y of {name} run {ways}, so the ground comes out mirrored: import it with "
        "--project utm, or EPSG:n of a system whose axes run east and north."
    ]


def _passes_edge(grid: FileGrid, width: int, height: int) -> bool:
    """Return whether points near a raster's corners do not survive the way to longitudes and latitudes and back.

    width, height: samples of the raster.
    """
    from rasterio.warp import transform

    x, y = grid.positions(np.array([0.02, 0.98, 0.02, 0.98]) * width, np.array([0.02, 0.02, 0.98, 0.98]) * height)
    base = base_crs(grid.crs)
    try:
        back = np.array(transform(base, grid.crs, *transform(grid.crs, base, x, y)[:2])[:2])
    except Exception:  # PROJ cannot transform these points
        return True
    a, b, _, d, e, _ = grid.placed
    return not lengths(back - np.stack([x, y])).max() <= max(length((a, d)), length((b, e)))  # True for NaN


def _direction(east: float, north: float) -> str:
    """Return the name of the nearest of the four directions, for a vector to the east and north."""
    if abs(east) > abs(north):
        return "east" if east > 0.0 else "west"
    return "north" if north > 0.0 else "south"


def _remedy(name: str, latitude: float) -> str:
    """Return the remedy for wrong lengths.

    name: the coordinate system's name, "EPSG:n". latitude: the raster's latitude, degrees.
    """
    utm = f"EPSG:{32600 if latitude >= 0.0 else 32700}"[:-2]  # the names of all zones begin so
    if not -80.0 <= latitude <= 84.0:
        polar = "EPSG:32661" if latitude > 0.0 else "EPSG:32761"
        return f"import it with --project {polar} (polar, WGS 84) or give the extent in metres"
    if name.startswith(utm):
        return (
            "import it with --project utm if another zone is nearer, or EPSG:n of a system for this area, or cut the "
            "raster into parts"
        )
    return "import it with --project utm, or EPSG:n of a system for this area, or give the extent in metres"


def _factors(grid: FileGrid, width: int, height: int, place: Georeference) -> tuple[np.ndarray, float]:
    """Return how many times longer the steps of `place` along x and y are than on the ground: float64 [points, 2].

    The first point is the raster's middle, the others are on its border. There is none if PROJ cannot transform the
    middle. Also return the middle's latitude, degrees. width, height: samples of the raster.
    """
    along = np.linspace(0.0, 1.0, BORDER_POINTS)
    ends = np.zeros_like(along), np.ones_like(along)
    columns = np.concatenate([[0.5], along, along, *ends]) * width
    rows = np.concatenate([[0.5], *ends, along, along]) * height
    half_cells = ((-0.5, 0.0), (0.5, 0.0), (0.0, -0.5), (0.0, 0.5))  # ends of a cell along a row, and along a column
    # x, y: [end, point]
    x, y = np.array([grid.positions(columns + column, rows + row) for column, row in half_cells]).transpose(1, 0, 2)
    degrees = _degrees(grid.crs, x.ravel(), y.ravel())
    if degrees is None:
        return np.empty((0, 2)), 0.0
    (longitude, latitude), ellipsoid = degrees[0].reshape(2, *x.shape), degrees[1]  # longitude, latitude: [end, point]
    # Metres in a degree of longitude and in one of latitude, [2, point].
    degree_metres = np.array([_metres_per_degree(float(point), ellipsoid) for point in latitude.mean(axis=0)]).T
    # Metres between the ends 0 and 1 (next columns), and between the ends 2 and 3 (next rows), at each point.
    column_step, row_step = (
        lengths(np.stack([_within_180(longitude[k + 1] - longitude[k]), latitude[k + 1] - latitude[k]]) * degree_metres)
        for k in (0, 2)
    )
    steps = (row_step, column_step) if place.transposed else (column_step, row_step)  # along x and y, metres
    with np.errstate(divide="ignore"):
        ratios = np.stack([place.step_x / steps[0], place.step_y / steps[1]], axis=1)
    if not np.isfinite(ratios[0]).all():
        return np.empty((0, 2)), 0.0
    return ratios[np.isfinite(ratios).all(axis=1)], float(latitude[:, 0].mean())


def _metres_per_degree(latitude: float, ellipsoid: tuple[float, float]) -> tuple[float, float]:
    """Return the lengths of a degree of longitude and of latitude, NaN at a pole.

    ellipsoid: semi-major axis in metres and inverse flattening.
    """
    is_usable = math.isfinite(latitude) and abs(latitude) <= 89.999
    return degree_lengths(latitude, ellipsoid) if is_usable else (math.nan, math.nan)


def _degrees(crs: CRS, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, tuple[float, float]] | None:
    """Return longitudes and latitudes of positions, degrees [2, n], and the ellipsoid of a projected system's base.

    Return None if there is no geographic base or PROJ cannot transform to it.
    """
    from rasterio.warp import transform

    try:
        base = base_crs(crs)
        transformed = np.array(transform(crs, base, x, y)[:2])
    except Exception:
        return None
    if base is None:
        return None
    # units_factor: name of the base's unit of angle, and radians in one
    return np.degrees(transformed * base.units_factor[1]), ellipsoid_of(base.to_wkt())


def _within_180(longitudes: np.ndarray) -> np.ndarray:
    """Return differences of longitude, degrees, from -180 to 180."""
    return (longitudes + 180.0) % 360.0 - 180.0
