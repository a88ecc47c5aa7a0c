# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion between a store's coordinate system and metres from the terrain's middle."""

import functools
import math
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import TerrainError, shown
from ..field import store as stores
from ..field.georeference import ROTATED
from ..field.heightfield import HeightField
from ..rasters import file_grid
from ..sandbox.store_job import ask, serve

MODULE = "cbt_terrain.importing.placing"


class Placing(NamedTuple):
    """Position of a terrain in its coordinate system.

    Attributes:
        x: coordinate of the origin of the terrain's space: its middle or its anchor.
        y: coordinate of the same point.
        metres_x: metres in a unit of x.
        metres_y: metres in a unit of y.
        crs: name of the system; "" if coordinates are metres from the middle, because there is no system, the user has
            given the extent in metres, or the raster is rotated.
        period: 360 degrees in units of a geographic system, else 0; longitudes that differ by it are equal.
    """

    x: float = 0.0
    y: float = 0.0
    metres_x: float = 1.0
    metres_y: float = 1.0
    crs: str = ""
    period: float = 0.0

    def to_terrain(self, coordinates: np.ndarray) -> np.ndarray:
        """Return positions in the terrain's space, float64 [n, 2] metres, of coordinates [n, 2]."""
        offsets = coordinates - (self.x, self.y)
        if self.period:  # longitudes that differ by it are equal: take the nearest
            offsets[:, 0] -= self.period * np.round(offsets[:, 0] / self.period)
        return offsets * (self.metres_x, self.metres_y)

    def from_terrain(self, positions: np.ndarray) -> np.ndarray:
        """Return coordinates, float64 [n, 2], of positions in the terrain's space, metres."""
        return positions / (self.metres_x, self.metres_y) + (self.x, self.y)


def is_placed(field: HeightField, store: str | os.PathLike) -> bool:
    """Return whether the origin and the steps of a store's field are those of its coordinate system, named or not.

    They are not if the user gave the extent, or if the terrain is rotated, be it by an unknown angle.
    """
    sized = field.provenance.get("settings", {}).get("extent") is not None
    return not sized and rotation_of(store) == 0.0


def rotation_of(store: str | os.PathLike) -> float | None:
    """Return the rotation, degrees, of a store's terrain in its coordinate system.

    Return None for a rotated terrain whose angle an older version did not write.
    """
    report = stores.read_json(Path(store))["report"]
    return report.get("rotation_deg", None if ROTATED in report.get("warnings", ()) else 0.0)


def unit_lengths(field: HeightField) -> tuple[float, float]:
    """Return the metres along x and y in a unit of the coordinate system of a placed field that names its system.

    Degrees have their length at the latitude of the field's middle. Loads GDAL: only for child processes.
    """
    from rasterio.crs import CRS

    return file_grid.unit_lengths(CRS.from_string(field.crs), float(field.origin[1]))


def placing_of(store: str | os.PathLike) -> Placing:
    """Return the map position of a store's terrain; metres from the middle if its field is not placed or has no system.

    A child process reads the system's units. Raises TerrainError.
    """
    store = Path(store)
    field = stores.open_store(store)
    if not field.crs or not is_placed(field, store):
        return Placing()
    request, what = {"store": str(store.absolute())}, f"the coordinate system of the store {store}"
    unit_x, unit_y, period = ask(MODULE, request, what)  # metres in a unit along x and y; units in 360 degrees or 0
    return Placing(float(field.origin[0]), float(field.origin[1]), unit_x, unit_y, field.crs, period)


def placing_or_middle(field: HeightField) -> Placing:
    """Return the position of a field's space; metres from the raster's middle if the field has no coordinates.

    The origin of the space is the field's anchor, which is the raster's middle or a point elsewhere in it.
    """
    if field.path is None or not is_placed(field, field.path):
        return Placing(field.lattice.anchor_x, field.lattice.anchor_y)
    # The store's own position is that of the raster's middle, and field.origin that of the field's anchor.
    placing = placing_of(field.path) if field.crs else Placing()
    return placing._replace(x=float(field.origin[0]), y=float(field.origin[1]))


@functools.lru_cache(maxsize=64)
def reproject_point(x: float, y: float, source: str, target: str) -> tuple[float, float]:
    """Return a point of one coordinate system in another; x is east or the longitude. Raises TerrainError.

    Starts a child process, since PROJ is not loaded in Blender.
    """
    request, what = {"point": [x, y], "systems": [source, target]}, "the coordinate systems"
    east, north = ask(MODULE, request, what)
    return east, north


def child_main() -> None:
    """Answer one request on stdin, in a child process that may load PROJ."""

    def answer(request: dict, *_: object) -> tuple[float, ...]:
        """Return the units of a store, or a point in another system."""
        return _reprojected(*request["point"], *request["systems"]) if "point" in request else _units(request["store"])

    # The second argument names the work in errors.
    serve(answer, lambda request: f"Reading {request.get('store', 'the coordinate systems')}")


def _reprojected(x: float, y: float, source: str, target: str) -> tuple[float, float]:
    """Return a point in another coordinate system. Raises TerrainError for names and points that PROJ refuses.

    x, y: the point in its own system. target: name of the other system.
    """
    from rasterio.crs import CRS
    from rasterio.warp import transform

    try:
        (east,), (north,) = transform(CRS.from_string(source), CRS.from_string(target), [x], [y])
    except Exception as reason:
        what = f"{shown(source, 40)} cannot be converted to {shown(target, 40)} ({shown(str(reason))})"
        raise TerrainError(what, expected="two coordinate systems that PROJ knows") from None
    if not (math.isfinite(east) and math.isfinite(north)):
        raise TerrainError(f"({x:g}, {y:g}) in {shown(source, 40)} has no place in {shown(target, 40)}")
    return east, north


def _units(store: str) -> tuple[float, float, float]:
    """Return the metres in a store's units of x and y, and the period of x: 360 degrees in that unit, 0 without."""
    from rasterio.crs import CRS

    field = stores.open_store(store)
    degrees = file_grid.unit_of(CRS.from_string(field.crs)).get("degrees")
    return *unit_lengths(field), 360.0 / degrees if degrees else 0.0
