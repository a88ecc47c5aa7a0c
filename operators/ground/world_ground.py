# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene's terrains as ground in the world, under any transform: heights below positions and hits of rays.

Heights are those of the height field at full resolution, not of a camera's mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.view.criterion import Criterion
from ...cbt_terrain.view.linear import inverse, product
from ..bridge.evaluated import transform_points
from ..bridge.scene_origin import coordinates_text
from ..land.properties import SEEN
from ..session import session
from ..terrain.overrides import Overrides
from ..terrain.request import RENDER, VIEWPORT, gather

ANY = Criterion(error_px=0.0, error_m=1.0)  # needs no camera; the triangles do not matter
GAP = "in a gap between files, where heights are filled"
HEADROOM = 0.01  # fraction of a terrain's height: rays down start this far above it


@dataclass(frozen=True, eq=False)
class WorldGround:
    """One terrain in the world."""

    uid: int  # session_uid of its object
    field: HeightField
    placement: np.ndarray  # float64 [4, 4], from the terrain's space to the world
    scale: float  # a point's z in the terrain's space is height * scale + offset
    offset: float

    @property
    def scale_and_offset(self) -> dict[str, float]:
        """Return the vertical scale and offset as keyword arguments of the engine's functions."""
        return {"vertical_scale": self.scale, "vertical_offset": self.offset}

    def key(self) -> tuple:
        """Return a key that changes when the ground changes."""
        return self.uid, self.field.key, self.placement.tobytes(), self.scale, self.offset

    def to_local(self, points: np.ndarray) -> np.ndarray:
        """Transform points of the world, float64 [n, 3], to the terrain's space."""
        return transform_points(inverse(self.placement), points)

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Transform points of the terrain's space, float64 [n, 3], to the world."""
        return transform_points(self.placement, points)

    def top(self) -> float:
        """Return a height of the world above all of the terrain, from which rays may start downwards."""
        west, south, east, north = self.field.lattice.rectangle()
        heights = [h * self.scale + self.offset for h in (self.field.min_height, self.field.max_height)]
        corners = np.array([(x, y, z) for x in (west, east) for y in (south, north) for z in heights])
        z = self.to_world(corners)[:, 2]
        return float(z.max() + HEADROOM * np.ptp(z) + 1.0)

    def coordinates(self, point: np.ndarray) -> str:
        """Return the coordinates of a point of the world, float64 [3], in the raster's system as a text, or ""."""
        return coordinates_text(self.field.raster.known_place, self.field.crs, self.to_local(point[None])[0])

    def gap_note(self, point: np.ndarray) -> str:
        """Return a note if a point of the world, float64 [3], is in a gap between files; else ""."""
        from ...cbt_terrain.field.known_ground import is_in_gap

        return GAP if is_in_gap(self.field, self.to_local(point[None])[:, :2])[0] else ""

    def hits(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return the points where rays of the world first hit the ground, float64 [n, 3]; NaN for rays that miss."""
        from ...cbt_terrain.query.rays import pick

        to_local = inverse(self.placement)
        local_directions = product(directions, to_local[:3, :3].T)
        local_origins = transform_points(to_local, origins)
        return self.to_world(pick(self.field, local_origins, local_directions, **self.scale_and_offset).points)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """Return upward unit normals in the world, float64 [n, 3], at points of the world on the surface."""
        from ...cbt_terrain.query.ground import ground_at

        local = ground_at(self.field, self.to_local(points)[:, :2], **self.scale_and_offset).normals
        normals = product(local, inverse(self.placement)[:3, :3])  # by the inverse transpose
        normals = normals / np.sqrt((normals * normals).sum(axis=1))[:, None]
        return np.where(normals[:, 2:] < 0.0, -normals, normals)


class Below(NamedTuple):
    """Ground below n positions: its `heights` in the world, float64 [n], NaN without ground; `which`, its number in the
    list of grounds, int [n], -1 without ground.
    """

    heights: np.ndarray
    which: np.ndarray


def grounds_of(scene, depsgraph, mode: str = VIEWPORT, waits: bool = True) -> list[WorldGround]:
    """Return the scene's rendered terrains as ground, including those hidden in viewports.

    Raises TerrainError.

    Args:
        mode: VIEWPORT or RENDER.
        waits: compute missing data such as shaped land. Otherwise use the fields of the current meshes, and
            leave out terrains without a mesh.
    """
    found = []
    for obj in session.terrains_of(scene):
        if obj.hide_render or not obj.adaptive_terrain.store:
            continue
        ground = ground_of(obj, depsgraph, mode) if waits else _as_shown(obj, depsgraph)
        if ground is not None:
            found.append(ground)
    return found


def depends_on_views(scene) -> bool:
    """Return whether renders shape some of the scene's land only in view of the camera."""
    return any(obj.adaptive_terrain.land.where == SEEN for obj in session.terrains_of(scene))


def ground_of(obj, depsgraph, mode: str = VIEWPORT) -> WorldGround:
    """Return a terrain as ground, computed if necessary. Raises TerrainError."""
    # Heights do not depend on a camera, so any criterion that needs none will do (ANY). Land that is shaped only in
    # view of the camera needs the terrain's own criterion (None). No attributes are computed: effects=().
    criterion = None if mode == RENDER and obj.adaptive_terrain.land.where == SEEN else ANY
    request = gather(obj, depsgraph, mode, criterion=criterion, overrides=Overrides(effects=()))
    with session.engine_lock:
        field = session.field_of(request)
    return WorldGround(obj.session_uid, field, request.placement, request.vertical_scale, request.vertical_offset)


def _as_shown(obj, depsgraph) -> WorldGround | None:
    """Return a terrain with the field of its current mesh and its current transform, None without a mesh."""
    field = session.record_of(obj).field
    if field is None:
        return None
    request = gather(obj, depsgraph, criterion=ANY, overrides=Overrides(effects=()))
    return WorldGround(obj.session_uid, field, request.placement, request.vertical_scale, request.vertical_offset)


def find_below(grounds: Sequence[WorldGround], places: np.ndarray) -> Below:
    """Return the highest ground above or below positions of the world, float64 [n, 2] or [n, 3] metres.

    The positions' own heights do not matter, so repeated drops give the same result.
    """
    places = np.asarray(places, np.float64)[:, :2]
    heights, which = np.full(len(places), np.nan), np.full(len(places), -1)
    down = np.tile([0.0, 0.0, -1.0], (len(places), 1))
    for number, ground in enumerate(grounds):
        found = ground.hits(np.c_[places, np.full(len(places), ground.top())], down)[:, 2]
        higher = np.isfinite(found) & ~(found <= heights)  # also where `heights` is NaN
        heights[higher], which[higher] = found[higher], number
    return Below(heights, which)


def normals_at(grounds: Sequence[WorldGround], places: np.ndarray, found: Below) -> np.ndarray:
    """Return unit normals, float64 [n, 3], of the ground that `find_below` found at positions; (0, 0, 1) without
    ground.
    """
    points = np.c_[np.asarray(places, np.float64)[:, :2], found.heights]
    result = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    for number, ground in enumerate(grounds):
        chosen = found.which == number
        if chosen.any():
            known = ground.normals(points[chosen])
            result[chosen] = np.where(np.isfinite(known), known, [0.0, 0.0, 1.0])
    return result


def first_hit(grounds: Sequence[WorldGround], origin, direction) -> tuple[np.ndarray, int] | None:
    """Return a ray's first hit in the world and the position of its ground in the list; None if it misses.

    The hit is float64 [3]. Raises TerrainError for a ray without a direction.
    """
    origin, direction = (np.asarray(v, np.float64).reshape(1, 3) for v in (origin, direction))
    if not (np.isfinite(origin).all() and np.isfinite(direction).all() and direction.any()):
        raise TerrainError(
            f"A ray from {origin[0].tolist()} along {direction[0].tolist()} leads nowhere",
            expected="finite numbers and a direction that is not 0",
        )
    nearest = None
    for number, ground in enumerate(grounds):
        point = ground.hits(origin, direction)[0]
        along = float(((point - origin[0]) * direction[0]).sum())
        if np.isfinite(point).all() and (nearest is None or along < nearest[0]):
            nearest = along, point, number
    return nearest and nearest[1:]
