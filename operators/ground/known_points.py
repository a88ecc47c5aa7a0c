# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of the ground at known coordinates: of a terrain's system, or latitude and longitude."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.field.georeference import from_crs
from ...cbt_terrain.importing.placing import reproject_point
from ..bridge.scene_origin import WGS84, coordinates_text, is_in_degrees
from ..text.coordinates import EAST_FIRST, NORTH_FIRST, Coordinates
from ..text.numbers import length_text
from .world_ground import WorldGround

AUTOMATIC, OF_TERRAIN, OF_EARTH = "AUTOMATIC", "TERRAIN", "EARTH"
SYSTEMS = [
    (AUTOMATIC, "Automatic", "Latitude and longitude if the numbers can be these, otherwise east and north"),
    (OF_TERRAIN, "Terrain's System", "East and north in the coordinate system of the height map, as the panel shows "
                                     "them; latitude and longitude if it is in degrees"),
    (OF_EARTH, "Latitude, Longitude", "Degrees as GPS and web maps have them (WGS 84)"),
]  # fmt: skip


@dataclass(frozen=True, eq=False)
class KnownPoint:
    """A point of the ground: its position in the world, float64 [3], its coordinates in the terrain's system as a text,
    the height of the terrain's height map there, metres, and a note if that is a filled one, else "".
    """

    position: np.ndarray
    coordinates: str
    height: float
    note: str


def find_point(grounds: Sequence[WorldGround], given: Coordinates, system: str) -> KnownPoint:
    """Return the ground at coordinates: of several terrains there, the highest in the world.

    grounds: the terrains to search. given: the two numbers that the user has entered. system: their meaning, AUTOMATIC,
    OF_TERRAIN or OF_EARTH. Raises TerrainError without a terrain that has a coordinate system, for coordinates outside,
    in holes, or that PROJ cannot convert.
    """
    located = [ground for ground in grounds if ground.field.crs and ground.field.raster.known_place is not None]
    if not located:
        raise TerrainError(
            "No terrain here has a coordinate system",
            expected="a height map with one, such as a GeoTIFF",
            fix="import such a file",
        )
    found, nearest, failure = [], None, None
    for ground in located:
        try:
            local = _local_position(ground, given, system)
        except TerrainError as error:
            failure = error
            continue
        point = _point_at(ground, local)
        if point is not None:
            found.append(point)
        elif nearest is None or _distance(ground, local) < _distance(*nearest):
            nearest = ground, local
    if found:
        return max(found, key=lambda point: point.position[2])
    if nearest is None:
        raise failure
    raise _outside(*nearest, given, system)


def _local_position(ground: WorldGround, given: Coordinates, system: str) -> np.ndarray:
    """Return the position of coordinates in a terrain's space, float64 [2] metres. Raises TerrainError.

    given: the two numbers and their order, if one was entered with them. system: their meaning, AUTOMATIC, OF_TERRAIN
    or OF_EARTH (WGS 84). Degrees of WGS 84 are converted to the terrain's system, unless that is in degrees itself and
    `system` does not require WGS 84.
    """
    # place: (a, b, c, d, e, f) maps (u, v) of the terrain's space to x = a u + b v + c, y = d u + e v + f of its system
    place, crs = ground.field.raster.known_place, ground.field.crs
    in_degrees = is_in_degrees(place)
    if not (in_degrees or _is_of_earth(given, system)):
        x, y = (given.second, given.first) if given.order == NORTH_FIRST else (given.first, given.second)
        return from_crs(place, np.array([[x, y]]))[0]
    y, x = (given.second, given.first) if given.order == EAST_FIRST else (given.first, given.second)
    if not (abs(y) <= 90.0 and abs(x) <= 360.0):
        raise TerrainError(
            f"Latitude {y:,.10g} and longitude {x:,.10g} are not on Earth",
            expected="a latitude of -90 .. 90 and a longitude of -180 .. 180",
        )
    if crs != WGS84 and (not in_degrees or system == OF_EARTH):  # otherwise they are in the terrain's own degrees
        try:
            x, y = reprojected(x, y, crs)
        except TerrainError as error:
            what = f"Latitude and longitude cannot be converted to {shown(crs, 40)}. {error.what}"
            raise TerrainError(what, fix="enter east and north of that system") from None
    if in_degrees:  # a raster may count longitudes from 0 to 360; place[2]: that of its middle
        x += 360.0 * round((place[2] - x) / 360.0)
    return from_crs(place, np.array([[x, y]]))[0]


@lru_cache(maxsize=64)  # several terrains have one system, and PROJ runs in a process that takes a second to start
def reprojected(longitude: float, latitude: float, crs: str) -> tuple[float, float]:
    """Return x and y in a coordinate system of a point on Earth, degrees of WGS 84. Raises TerrainError."""
    return reproject_point(longitude, latitude, WGS84, crs)


def _is_of_earth(given: Coordinates, system: str) -> bool:
    """Return whether coordinates are latitude and longitude: by `system`, or if AUTOMATIC by their form and size.

    given.is_degrees: the text has a degree sign, or names such as "lat".
    """
    if system != AUTOMATIC:
        return system == OF_EARTH
    can_be = abs(given.first) <= 90.0 and abs(given.second) <= 180.0
    return given.is_degrees or can_be and given.order != EAST_FIRST


def _point_at(ground: WorldGround, local: np.ndarray) -> KnownPoint | None:
    """Return the ground at a position of a terrain's space, float64 [2]; None outside and in holes."""
    from ...cbt_terrain.query.ground import ground_at

    samples = ground_at(ground.field, local[None], **ground.scale_and_offset)
    if not samples.inside[0]:
        return None
    z = float(samples.heights[0])
    height = (z - ground.offset) / ground.scale if ground.scale else z  # of the height map
    position = ground.to_world(np.array([[*local, z]]))[0]
    coordinates = coordinates_text(ground.field.raster.known_place, ground.field.crs, local)
    return KnownPoint(position, coordinates, height, ground.gap_note(position))


def _distance(ground: WorldGround, local: np.ndarray) -> float:
    """Return the distance in metres of a position of a terrain's space, float64 [2], from its raster, 0 inside."""
    west, south, east, north = ground.field.lattice.rectangle()
    return float(np.hypot(max(west - local[0], local[0] - east, 0.0), max(south - local[1], local[1] - north, 0.0)))


def _outside(ground: WorldGround, local: np.ndarray, given: Coordinates, system: str) -> TerrainError:
    """Return the error for coordinates where the nearest terrain has no ground.

    local: their position in its space. given, system: numbers and their meaning; if these numbers exchanged are on the
    terrain, the error proposes that.
    """
    where = coordinates_text(ground.field.raster.known_place, ground.field.crs, local)
    distance = _distance(ground, local)
    if distance == 0.0:
        return TerrainError(f"The terrain has a hole at {where}", fix="choose another point")
    exchanged = given._replace(first=given.second, second=given.first)
    try:
        is_inside = _point_at(ground, _local_position(ground, exchanged, system)) is not None
    except TerrainError:
        is_inside = False
    fix = "exchange the two numbers" if is_inside else "check the numbers and their System"
    return TerrainError(f"{where} is {length_text(distance)} outside of the terrain", fix=fix)
