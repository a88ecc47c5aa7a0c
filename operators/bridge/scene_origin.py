# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene's origin on Earth: the coordinates of the world's origin, in the custom properties that BlenderGIS uses.

The world's x and y axes are east and north of the coordinate system, in metres.
"""

import math
import re
from typing import NamedTuple

import numpy as np

from ...cbt_terrain.field.georeference import Place, to_crs

SRID, CRS_X, CRS_Y = "SRID", "crs x", "crs y"
LATITUDE, LONGITUDE = "latitude", "longitude"
WGS84 = "EPSG:4326"
METRES = "crs metres"  # our own: metres in a unit of x and of y, 1 if it is missing
WRITTEN = "adaptive_terrain_origin"  # our own: the origin as we wrote it, since other add-ons may write another
# Metres in a degree of latitude, on any ellipsoid and at any latitude.
DEGREE = 1.10e5, 1.12e5


class SceneOrigin(NamedTuple):
    """Coordinates of the world's origin, the name of their system, and the metres in a unit of x and of y."""

    crs: str
    x: float
    y: float
    metres: tuple[float, float] = (1.0, 1.0)

    @property
    def place(self) -> Place:
        """Return the affine map from the world to the system."""
        return 1.0 / self.metres[0], 0.0, self.x, 0.0, 1.0 / self.metres[1], self.y


def origin_of(scene) -> SceneOrigin | None:
    """Return the origin in a scene's custom properties, None if it has none, or lacks a system or finite numbers."""
    crs, x, y = (scene.get(name) for name in (SRID, CRS_X, CRS_Y))
    metres = list(scene.get(METRES, (1.0, 1.0)))  # in a unit of x and of y
    if crs is None or not all(_is_number(value) for value in (x, y, *metres)) or not all(metres):
        return None
    return SceneOrigin(full_name(str(crs)), float(x), float(y), (float(metres[0]), float(metres[1])))


def set_origin(scene, origin: SceneOrigin, latitude_longitude: tuple[float, float] | None) -> None:
    """Write an origin into a scene; without latitude and longitude (degrees) those of an earlier origin are removed."""
    scene[SRID], scene[CRS_X], scene[CRS_Y] = origin.crs, origin.x, origin.y
    for name, value in zip((LATITUDE, LONGITUDE), latitude_longitude or (None, None), strict=True):
        if value is not None:
            scene[name] = value
        elif name in scene:
            del scene[name]
    if origin.metres != (1.0, 1.0):
        scene[METRES] = origin.metres
    elif METRES in scene:
        del scene[METRES]


def claim_origin(scene) -> None:
    """Record that the scene's present origin is ours, not that of another add-on."""
    scene[WRITTEN] = _text_of(scene)


def is_claimed(scene) -> bool:
    """Return whether a scene's origin is ours, and no other add-on has changed it since."""
    return origin_of(scene) is not None and scene.get(WRITTEN) == _text_of(scene)


def remove_origin(scene) -> None:
    """Remove the origin from a scene's custom properties."""
    for name in (SRID, CRS_X, CRS_Y, LATITUDE, LONGITUDE, METRES, WRITTEN):
        if name in scene:
            del scene[name]


def _text_of(scene) -> str:
    """Return a scene's origin as one text, to compare it with another."""
    return " ".join(repr(scene[name]) for name in (SRID, CRS_X, CRS_Y))


def full_name(crs: str) -> str:
    """Return the name of a system; BlenderGIS also writes the bare number of an EPSG code."""
    return f"EPSG:{crs}" if re.fullmatch(r"\d{4,6}", crs) else crs


def unit_lengths(place: Place) -> tuple[float, float]:
    """Return the metres in a unit of x and of y of a coordinate system.

    place: affine map from metres in a terrain's space to the system, three numbers for x and three for y.
    """
    return 1.0 / math.hypot(place[0], place[1]), 1.0 / math.hypot(place[3], place[4])


def is_in_degrees(place: Place) -> bool:
    """Return whether a coordinate system has degrees, by the length of its unit of y."""
    return DEGREE[0] < unit_lengths(place)[1] < DEGREE[1]


def coordinates_text(place: Place | None, crs: str, position: np.ndarray) -> str:
    """Return the coordinates of a position in a terrain's space, float64 [2 or 3], as text.

    place: affine map from that space to the system. crs: name of the system. The result is "" without one of them.
    """
    if not crs or place is None:
        return ""
    ((x, y),) = to_crs(place, np.asarray(position, np.float64)[None, :2]).tolist()
    if not is_in_degrees(place):
        return f"E {x:,.2f}, N {y:,.2f}"
    longitude = (x + 180.0) % 360.0 - 180.0
    return f"{abs(y):.6f}° {'N' if y >= 0.0 else 'S'}, {abs(longitude):.6f}° {'E' if longitude >= 0.0 else 'W'}"


def _is_number(value) -> bool:
    """Return whether a custom property is a finite number."""
    return isinstance(value, int | float) and math.isfinite(value)
