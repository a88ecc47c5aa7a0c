# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a store's terrain lies in its coordinate system: between coordinates of that and metres from its middle."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..field import store as stores
from ..field.georeference import ROTATED, degree_lengths, ellipsoid_of
from ..field.heightfield import HeightField
from .store_job import ask, serve

MODULE = "cbt_terrain.importing.placing"


class Placing(NamedTuple):
    """The terrain's middle has the coordinates (x, y); a unit of the coordinate system has so many metres along each.

    crs: its name; "" where coordinates are metres from the middle: there is none, someone has given the extent in
    metres, or the raster is rotated against it.
    """

    x: float = 0.0
    y: float = 0.0
    metres_x: float = 1.0
    metres_y: float = 1.0
    crs: str = ""

    def to_terrain(self, coordinates: np.ndarray) -> np.ndarray:
        """float64 [n, 2] metres in the terrain's own space, of coordinates [n, 2]."""
        return (coordinates - (self.x, self.y)) * (self.metres_x, self.metres_y)

    def from_terrain(self, places: np.ndarray) -> np.ndarray:
        """The other way."""
        return places / (self.metres_x, self.metres_y) + (self.x, self.y)


def is_placed(field: HeightField, store: str | os.PathLike) -> bool:
    """Whether the origin and the steps of a store's field are those of its coordinate system, be that without a
    name."""
    sized = field.provenance.get("settings", {}).get("extent") is not None
    return not sized and ROTATED not in stores.read_json(Path(store))["report"].get("warnings", ())


def unit_lengths(field: HeightField) -> tuple[float, float]:
    """Metres of a unit of a placed field's coordinate system along x and y. Loads GDAL: in child processes only."""
    from rasterio.crs import CRS

    crs = CRS.from_string(field.crs)
    if crs.is_geographic:
        degrees = np.degrees(crs.units_factor[1])
        lengths = degree_lengths(float(field.origin[1]) * degrees, ellipsoid_of(crs.to_wkt()))
        return degrees * lengths[0], degrees * lengths[1]
    return (crs.linear_units_factor[1],) * 2 if crs.is_projected else (1.0, 1.0)


def placing_of(store: str | os.PathLike) -> Placing:
    """Where the terrain of a store lies. Raises TerrainError."""
    store = Path(store)
    field = stores.open_store(store)
    if not field.crs or not is_placed(field, store):
        return Placing()
    lengths = ask(MODULE, {"store": str(store.absolute())}, f"the coordinate system of the store {store}")
    return Placing(*(float(c) for c in field.origin[:2]), *lengths, field.crs)


def child_main() -> None:
    """Answer one request."""
    serve(lambda asked, *_: unit_lengths(stores.open_store(asked["store"])), lambda asked: f"Reading {asked['store']}")
