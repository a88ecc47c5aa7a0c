# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a store's terrain lies in its coordinate system: between coordinates of that and metres from its middle."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..field import store as stores
from ..field.georeference import ROTATED, degree_lengths
from ..field.heightfield import HeightField
from .file_grid import unit_of
from .store_job import ask, serve

MODULE = "cbt_terrain.importing.placing"


class Placing(NamedTuple):
    """The terrain's middle has the coordinates (x, y), and a unit of the coordinate system is `metres_x` and `metres_y`
    long.

    crs: its name; "" where coordinates are metres from the middle: there is none, the user has given the extent in
    metres, or the raster is rotated against it. period: of x, 360 degrees in units of a geographic system, else 0:
    longitudes that differ by it are the same.
    """

    x: float = 0.0
    y: float = 0.0
    metres_x: float = 1.0
    metres_y: float = 1.0
    crs: str = ""
    period: float = 0.0

    def to_terrain(self, coordinates: np.ndarray) -> np.ndarray:
        """Return positions in the terrain's own space, float64 [n, 2] metres, of coordinates [n, 2]."""
        offsets = coordinates - (self.x, self.y)
        if self.period:
            offsets[:, 0] -= self.period * np.round(offsets[:, 0] / self.period)
        return offsets * (self.metres_x, self.metres_y)

    def from_terrain(self, positions: np.ndarray) -> np.ndarray:
        """Return coordinates, float64 [n, 2], of positions in the terrain's own space."""
        return positions / (self.metres_x, self.metres_y) + (self.x, self.y)


def is_placed(field: HeightField, store: str | os.PathLike) -> bool:
    """Return whether the origin and the steps of a store's field are those of its coordinate system, with or without a
    name."""
    sized = field.provenance.get("settings", {}).get("extent") is not None
    return not sized and rotation_of(store) == 0.0


def rotation_of(store: str | os.PathLike) -> float | None:
    """Return degrees by which the terrain of a store is rotated against its coordinate system; None if it is by an
    angle that an older version has not written."""
    report = stores.read_json(Path(store))["report"]
    return report.get("rotation_deg", None if ROTATED in report.get("warnings", ()) else 0.0)


def unit_lengths(field: HeightField) -> tuple[float, float]:
    """Return metres of a unit of a placed field's coordinate system along x and y.

    Loads GDAL: only for child processes.
    """
    from rasterio.crs import CRS

    unit = unit_of(CRS.from_string(field.crs))
    if "degrees" in unit:
        lengths = degree_lengths(float(field.origin[1]) * unit["degrees"], unit["ellipsoid"])
        return unit["degrees"] * lengths[0], unit["degrees"] * lengths[1]
    return (unit.get("metres", 1.0),) * 2


def placing_of(store: str | os.PathLike) -> Placing:
    """Return the position of a store's terrain. Raises TerrainError."""
    store = Path(store)
    field = stores.open_store(store)
    if not field.crs or not is_placed(field, store):
        return Placing()
    *lengths, period = ask(MODULE, {"store": str(store.absolute())}, f"the coordinate system of the store {store}")
    return Placing(*(float(c) for c in field.origin[:2]), *lengths, field.crs, period)


def child_main() -> None:
    """Answer one request."""
    serve(lambda request, *_: _units(request["store"]), lambda request: f"Reading {request['store']}")


def _units(store: str) -> tuple[float, float, float]:
    """Return the lengths of a store's units and the period of x, as of Placing."""
    from rasterio.crs import CRS

    field = stores.open_store(store)
    degrees = unit_of(CRS.from_string(field.crs)).get("degrees")
    return *unit_lengths(field), 360.0 / degrees if degrees else 0.0
