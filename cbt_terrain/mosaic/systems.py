# SPDX-License-Identifier: GPL-3.0-or-later
"""Coordinate systems of a mosaic's files: their horizontal part, their vertical datum, and positions in another system.

Functions import rasterio, so they run in a child process.
"""

import json
from functools import lru_cache
from typing import Any

import numpy as np

from ..errors import TerrainError, shown
from ..rasters.file_grid import find_positions

# Names of vertical datums by EPSG code of their system; others have the name that PROJ gives.
DATUMS = {5773: "EGM96", 5171: "EGM84", 5798: "EGM84", 3855: "EGM2008", 5703: "NAVD88", 6360: "NAVD88", 8228: "NAVD88"}
ELLIPSOID = "the ellipsoid"


@lru_cache(maxsize=256)
def crs_of(name: str) -> Any:
    """Return the rasterio CRS of a name from `names_of`. Raises TerrainError."""
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    try:
        return CRS.from_string(name)
    except CRSError as reason:
        what = f"{shown(name, 80)} is no coordinate system that PROJ knows"
        raise TerrainError(what, fix="give another, as EPSG:32632") from reason


def names_of(crs: Any) -> tuple[str, str]:
    """Return the names of a CRS's horizontal part and of its vertical datum, "" for none.

    crs: a rasterio CRS.
    """
    return _names_of(crs.to_wkt())


@lru_cache(maxsize=256)
def _names_of(wkt: str) -> tuple[str, str]:
    """Return the names of the horizontal system and of the vertical datum, "" for none, of a CRS in WKT.

    The results are cached, because the files of a mosaic share a few.
    """
    from rasterio.crs import CRS

    crs = CRS.from_wkt(wkt)
    content = crs.to_dict(projjson=True)
    content = content.get("source_crs", content) if content.get("type") == "BoundCRS" else content
    if content.get("type") == "CompoundCRS":
        plane, vertical = content["components"][:2]
        return CRS.from_user_input(json.dumps(plane)).to_string(), _datum_name(vertical)
    # With a third axis, heights above the ellipsoid are part of the system itself.
    axes = content.get("coordinate_system", {}).get("axis", ())
    return crs.to_string(), ELLIPSOID if len(axes) == 3 else ""


def _datum_name(vertical: dict) -> str:
    """Return the name of the datum of a vertical system, an object of PROJ's JSON; "" without one."""
    code = vertical.get("id", {}).get("code")
    if code in DATUMS:
        return DATUMS[code]
    datum = vertical.get("datum", vertical.get("datum_ensemble", {}))
    return str(datum.get("name") or vertical.get("name", ""))


def projected(source: str, target: str, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions in another system, float64 [n] each, not finite where there are none.

    They are x and y themselves if the systems are the same. GDAL chooses the operation between two datums by all points
    of a call, so results depend on the whole set. Raises TerrainError for systems without a common one. target: name of
    the other system.
    """
    if source == target:
        return x, y
    try:
        return find_positions(crs_of(source), crs_of(target), x, y)
    except Exception as reason:  # PROJ raises many kinds
        raise TerrainError(
            f"{shown(source, 80)} and {shown(target, 80)} have no common coordinate system ({shown(reason)})",
            fix="give another target (--project), or import the files apart",
        ) from reason


def period_of(crs: str) -> float:
    """Return 360 degrees in units of a geographic system, 0 for others: positions that differ by it are equal."""
    if not crs or not crs_of(crs).is_geographic:
        return 0.0
    return 2.0 * np.pi / float(crs_of(crs).units_factor[1])
