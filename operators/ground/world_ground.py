# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene's terrains as ground in the world, however they stand in it: what is below a place, what a ray hits first.

Heights are those of the height field at full resolution, not of the mesh that a camera has asked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...cbt_terrain.ask.criterion import Criterion
from ...cbt_terrain.ask.linear import inverse, product
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.query.ground import ground_at
from ...cbt_terrain.query.rays import pick
from ..properties.land_properties import SEEN
from ..request.overrides import Overrides
from ..request.request import RENDER, VIEWPORT, gather
from ..scene import session

ANY = Criterion(error_px=0.0, error_m=1.0)  # the triangles do not matter, and no camera is asked for
HEADROOM = 0.01  # of the height of a terrain's box: rays down begin so far above it


@dataclass(frozen=True, eq=False)
class Ground:
    """One terrain. `placement` float64 [4, 4]: its space to the world; heights become `height * scale + offset`."""

    uid: int
    field: HeightField
    placement: np.ndarray
    scale: float
    offset: float

    @property
    def heights(self) -> dict[str, float]:
        return {"vertical_scale": self.scale, "vertical_offset": self.offset}

    def key(self) -> tuple:
        """Equal for equal ground."""
        return self.uid, self.field.key, self.placement.tobytes(), self.scale, self.offset

    def to_own(self, points: np.ndarray) -> np.ndarray:
        """Points of the world, float64 [n, 3], in the terrain's space."""
        return _moved(inverse(self.placement), points)

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Points of the terrain's space, float64 [n, 3], in the world."""
        return _moved(self.placement, points)

    def top(self) -> float:
        """A height of the world that nothing of it reaches."""
        west, south, east, north = self.field.lattice.rectangle()
        heights = [h * self.scale + self.offset for h in (self.field.min_height, self.field.max_height)]
        corners = np.array([(x, y, z) for x in (west, east) for y in (south, north) for z in heights])
        z = self.to_world(corners)[:, 2]
        return float(z.max() + HEADROOM * np.ptp(z) + 1.0)

    def hits(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """float64 [n, 3] of the world: where rays of the world first meet it; NaN where they do not."""
        back = inverse(self.placement)
        turned = _turned(back[:3, :3], directions)
        return self.to_world(pick(self.field, _moved(back, origins), turned, **self.heights).points)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """float64 [n, 3] of the world, of length 1 and upward, at points of the world on its surface."""
        own = ground_at(self.field, self.to_own(points)[:, :2], **self.heights).normals
        normals = _turned(inverse(self.placement)[:3, :3].T, own)
        normals = normals / np.sqrt((normals * normals).sum(axis=1))[:, None]
        return np.where(normals[:, 2:] < 0.0, -normals, normals)


class Below(NamedTuple):
    """Of n places: `heights` float64 [n], of the world; NaN without ground. `which`: int [n], numbers of the grounds,
    -1 without."""

    heights: np.ndarray
    which: np.ndarray


def grounds_of(scene, depsgraph, mode: str = VIEWPORT, waits: bool = True) -> list[Ground]:
    """The scene's terrains that renders show, as `depsgraph` has them. A hidden one counts: it is still there.

    `waits`: make what is not there yet, such as shaped land; else those are left out of which no mesh has been made,
    and the others are what their meshes show. Raises TerrainError.
    """
    found = []
    for obj in session.terrains_of(scene):
        if obj.hide_render or not obj.adaptive_terrain.store:
            continue
        ground = ground_of(obj, depsgraph, mode) if waits else _as_shown(obj, depsgraph)
        if ground is not None:
            found.append(ground)
    return found


def is_made_for_views(scene) -> bool:
    """Whether renders make some of the scene's land fine only where they look, so that cameras have a say in it."""
    return any(obj.adaptive_terrain.land.where == SEEN for obj in session.terrains_of(scene))


def ground_of(obj, depsgraph, mode: str = VIEWPORT) -> Ground:
    """A terrain as ground, made if it has to be. Raises TerrainError."""
    asked = None if mode == RENDER and obj.adaptive_terrain.land.where == SEEN else ANY
    request = gather(obj, depsgraph, mode, criterion=asked, overrides=Overrides(effects=()))
    with session.engine_lock:
        field = session.field_of(request)
    return Ground(obj.session_uid, field, request.placement, request.vertical_scale, request.vertical_offset)


def _as_shown(obj, depsgraph) -> Ground | None:
    """A terrain as its mesh was made last, but where and as high as it stands now."""
    field = session.record_of(obj).field
    if field is None:
        return None
    request = gather(obj, depsgraph, criterion=ANY, overrides=Overrides(effects=()))
    return Ground(obj.session_uid, field, request.placement, request.vertical_scale, request.vertical_offset)


def below(grounds: Sequence[Ground], places: np.ndarray) -> Below:
    """The highest ground on vertical lines of the world through places, float64 [n, 2] metres or [n, 3].

    It does not depend on how high something is there now, so it is the same after any number of drops.
    """
    places = np.asarray(places, np.float64)[:, :2]
    heights, which = np.full(len(places), np.nan), np.full(len(places), -1)
    down = np.tile([0.0, 0.0, -1.0], (len(places), 1))
    for number, ground in enumerate(grounds):
        found = ground.hits(np.c_[places, np.full(len(places), ground.top())], down)[:, 2]
        higher = np.isfinite(found) & ~(found <= heights)
        heights[higher], which[higher] = found[higher], number
    return Below(heights, which)


def normals(grounds: Sequence[Ground], places: np.ndarray, found: Below) -> np.ndarray:
    """float64 [n, 3], of length 1: of the ground that `below` has found at places [n, 2 or 3]; upward without any."""
    points = np.c_[np.asarray(places, np.float64)[:, :2], found.heights]
    result = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    for number, ground in enumerate(grounds):
        chosen = found.which == number
        if chosen.any():
            own = ground.normals(points[chosen])
            result[chosen] = np.where(np.isfinite(own), own, [0.0, 0.0, 1.0])
    return result


def first_hit(grounds: Sequence[Ground], origin, direction) -> tuple[np.ndarray, int] | None:
    """Where a ray of the world first meets ground, float64 [3], and the number of that; None where it does not."""
    origin, direction = (np.asarray(v, np.float64).reshape(1, 3) for v in (origin, direction))
    if not (np.isfinite(origin).all() and np.isfinite(direction).all() and direction.any()):
        raise TerrainError(
            f"A ray from {origin[0].tolist()} along {direction[0].tolist()} leads nowhere; expected finite numbers and "
            "a direction that is not 0."
        )
    nearest = None
    for number, ground in enumerate(grounds):
        point = ground.hits(origin, direction)[0]
        along = float(((point - origin[0]) * direction[0]).sum())
        if np.isfinite(point).all() and (nearest is None or along < nearest[0]):
            nearest = along, point, number
    return nearest and nearest[1:]


def _moved(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points [n, 3] by a matrix [4, 4]."""
    return _turned(matrix[:3, :3], points) + matrix[:3, 3]


def _turned(matrix: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors [n, 3] by a matrix [3, 3]."""
    return product(vectors, matrix.T)
