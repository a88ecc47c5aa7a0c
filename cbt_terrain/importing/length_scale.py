# SPDX-License-Identifier: GPL-3.0-or-later
"""A warning where lengths in a projected coordinate system differ from those on the ground, as in Web Mercator."""

import math

import numpy as np

from ..ask.linear import lengths
from ..field.georeference import Georeference, degree_lengths, ellipsoid_of
from .file_grid import FileGrid, base_crs

MAX_SCALE_ERROR = 0.01  # part of a length
MIN_STEP = 1e-4  # metres; coordinates on Earth have too few digits to measure shorter ones
BORDER_POINTS = 9  # along each side


def length_warnings(grid: FileGrid, width: int, height: int, place: Georeference) -> list[str]:
    """Return a warning if steps of `place` are off by more than MAX_SCALE_ERROR at the raster's middle or border.

    The steps on the ground are those of the ellipsoid: differences of longitude and latitude over a cell, times the
    length of a degree there.
    """
    if grid.crs is None or not grid.crs.is_projected or min(place.step_x, place.step_y) < MIN_STEP:
        return []
    factors, latitude = _factors(grid, width, height, place)
    if not len(factors) or np.abs(factors - 1.0).max() <= MAX_SCALE_ERROR:
        return []
    middle, low, high = factors[0], factors.min(), factors.max()
    return [
        f"Lengths in {grid.name[:80]} are not those on the ground: in the middle of the raster they are "
        f"{middle[0]:.4g} times the true ones along x and {middle[1]:.4g} times along y, and {low:.4g} to {high:.4g} "
        f"times up to its border, while heights are true. To have them right, {_remedy(grid.name, latitude)}."
    ]


def _remedy(name: str, latitude: float) -> str:
    """Return what to do about wrong lengths at a latitude, degrees."""
    utm = f"EPSG:{32600 if latitude >= 0.0 else 32700}"[:-2]
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
    """Return how many times too large steps along x and y are, float64 [n, 2], the raster's middle first, and the
    latitude of that, degrees; no rows where the system has no place on the ground."""
    from rasterio.warp import transform

    along = np.linspace(0.0, 1.0, BORDER_POINTS)
    ends = np.zeros_like(along), np.ones_like(along)
    columns = np.concatenate([[0.5], along, along, *ends]) * width
    rows = np.concatenate([[0.5], *ends, along, along]) * height
    near = ((-0.5, 0.0), (0.5, 0.0), (0.0, -0.5), (0.0, 0.5))
    x, y = np.array([grid.positions(columns + column, rows + row) for column, row in near]).transpose(1, 0, 2)
    try:
        base = base_crs(grid.crs)
        moved = np.array(transform(grid.crs, base, x.ravel(), y.ravel())[:2])
    except Exception:  # no geographic system, or PROJ does not know the way
        return np.empty((0, 2)), 0.0
    longitude, latitude = np.degrees(moved.reshape(2, *x.shape) * base.units_factor[1])
    ellipsoid = ellipsoid_of(base.to_wkt())
    factors = []
    for east, north, point in zip(
        (longitude[1::2] - longitude[::2]).T, (latitude[1::2] - latitude[::2]).T, latitude.mean(axis=0), strict=True
    ):
        if not np.isfinite(point) or abs(point) > 89.999:
            factors.append((math.nan, math.nan))
            continue
        along_x, along_y = degree_lengths(float(point), ellipsoid)
        column, row = lengths(np.stack([(east + 180.0) % 360.0 * along_x - 180.0 * along_x, north * along_y]))
        steps = (row, column) if place.transposed else (column, row)
        factors.append((place.step_x / steps[0], place.step_y / steps[1]))
    found = np.array(factors)
    if not np.isfinite(found[0]).all():
        return np.empty((0, 2)), 0.0
    return found[np.isfinite(found).all(axis=1)], float(latitude[:, 0].mean())
