# SPDX-License-Identifier: GPL-3.0-or-later
"""Scatters of a terrain: objects parented to it whose points follow its updates. Hidden ones keep their points."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.run.memory import physical_memory
from ...cbt_terrain.scatter.scatter import Scatter
from ...cbt_terrain.view.view import View
from .open_water import water_to_avoid
from .properties import MESH, scatter_of

if TYPE_CHECKING:
    from ...cbt_terrain.history.frame_history import FrameHistory
    from ...cbt_terrain.mesh.plan_triangles import PlanTriangles
    from ...cbt_terrain.scatter.points import ScatterPoints

# Custom property of a terrain: coordinates of the point from which its scatters count, see Scatter.corner.
CORNER = "adaptive_terrain_scatter_corner"
# Largest memory of a point as an instance: measured in Blender 5.2, in a viewport and in Cycles.
POINT_BYTES = 1500
# Points of a scatter: a viewport draws them in every frame, and makes them again at every move of a slider.
MAX_IN_VIEWPORT = 4_000_000


@dataclass(frozen=True)
class ScatterItem:
    """A visible scatter.

    `uid`, `name`: session_uid and name of its object. `on_mesh`: points are on the triangles, not on the height field.
    `culls`: points that hills hide are left out. `sea_level`: points are above it, metres in the terrain's space.
    `water`: triangles in plan that no point is in.
    """

    uid: int
    name: str
    scatter: Scatter
    on_mesh: bool
    culls: bool
    sea_level: float = -math.inf
    water: "PlanTriangles | None" = None


@dataclass(frozen=True, eq=False)
class Scatters:
    """Visible scatters of a terrain, and the views that they are for; without a view, everywhere.

    `max_points`: largest number of points of each scatter, and what limits it.
    """

    items: tuple[ScatterItem, ...] = ()
    views: tuple[View, ...] = ()
    max_points: tuple[int, str] | None = None

    def key(self) -> tuple:
        """Return a key of the scatters and their views, equal if the points are."""
        return self.items, tuple(view.key() for view in self.views)


def _new_history() -> "FrameHistory":
    """Return an empty history. The engine is imported with the first scatter."""
    from ...cbt_terrain.history.frame_history import FrameHistory

    return FrameHistory()


@dataclass
class ScatterRecord:
    """The last points of a scatter.

    `key`: what they depend on. `shown`: `key` of the points that were written last, with the uid and size of their
    mesh. `ms`: milliseconds of the last points by step; `runs`: number of times that points were made. `history`: holds
    candidates on the ground for later frames.
    """

    history: "FrameHistory" = field(default_factory=_new_history)
    key: tuple = ()
    points: "ScatterPoints | None" = None
    shown: tuple = ()
    ms: dict[str, float] = field(default_factory=dict)
    runs: int = 0


def is_scatter(obj) -> bool:
    """Return whether an object is a scatter whose points may be written: it is enabled and not linked."""
    return obj.type == "MESH" and obj.adaptive_scatter.enabled and obj.library is None and obj.data.library is None


def scatters_of(terrain) -> list:
    """Return the scatters of a terrain: its children that are scatters."""
    return [child for child in terrain.children if is_scatter(child)]


def gather_scatters(terrain, depsgraph, render: bool, views: Callable[[], list[View]]) -> Scatters:
    """Return the requests of a terrain's scatters that are visible in a render or in the viewport.

    render: all scatters that the dependency graph has evaluated are visible, without a look at the viewport. views:
    returns the views that limit the points; called only if there is a visible scatter. Raises TerrainError.
    """
    settings, items = terrain.evaluated_get(depsgraph).adaptive_terrain, []
    noted = terrain.get(CORNER)
    corner = tuple(noted) if getattr(noted, "typecode", "") == "d" and len(noted) == 2 else None
    for obj in scatters_of(terrain):
        evaluated = obj.evaluated_get(depsgraph)
        if not (evaluated.is_evaluated and (render or obj.visible_get(view_layer=depsgraph.view_layer))):
            continue
        properties = evaluated.adaptive_scatter
        on_mesh = properties.roots == MESH
        culls = properties.cull_hidden and not on_mesh  # hidden triangles may be coarse, and carry points up into sight
        try:
            scatter = replace(scatter_of(properties, settings), corner=corner)
        except TerrainError as error:
            raise error.within(f"The scatter {obj.name!r} cannot be made") from None
        sea_level = properties.sea_level if properties.use_sea else -math.inf
        water = water_to_avoid(terrain, properties.where)
        items.append(ScatterItem(obj.session_uid, obj.name, scatter, on_mesh, culls, sea_level, water))
    return Scatters(tuple(items), tuple(views()), max_points(render)) if items else Scatters()


def max_points(render: bool) -> tuple[int, str]:
    """Return the largest number of points of a scatter that Blender can instance, and a phrase for what limits it.

    render: for a render, whose limit is three quarters of the machine's memory; a viewport also has MAX_IN_VIEWPORT.
    """
    max_in_memory = physical_memory() * 3 // 4 // POINT_BYTES
    if not render and max_in_memory > MAX_IN_VIEWPORT:
        return MAX_IN_VIEWPORT, "the maximum of a viewport (hide it there, and renders have them all)"
    return max_in_memory, "the maximum of this machine's memory"


def make_points(
    records: dict[int, ScatterRecord], request, heights: HeightField, terrain, surface, serial: int
) -> None:
    """Compute the points of all scatters of a request into their records, without Blender's data.

    Points whose inputs have not changed are reused. Raises TerrainError; that scatter's points are made again later.

    Args:
        records: by session_uid of the scatter's object; missing ones are added.
        request: the terrain's Request.
        heights: its height field.
        terrain: the terrain's engine.
        surface: the terrain's mesh, for points on it.
        serial: number of that mesh, which changes with it.
    """
    from ...cbt_terrain.scatter.points import ScatterRequest, on_mesh, place_points

    scatters, scale = request.scatters, (request.vertical_scale, request.vertical_offset)
    views = tuple(view.key() for view in scatters.views)
    below, outline = request.cleanup.key()  # the height and the outline by which the mesh is cut
    is_uncut = not request.cleanup.active  # a cut part would hide ground that is seen through the cut
    horizon = cache(terrain.horizon)  # what the mesh hides from each view; one for all scatters that cull by it
    for item in scatters.items:
        record = records.setdefault(item.uid, ScatterRecord())
        key = (
            item.scatter,
            heights.key,
            scale,
            outline,
            views,
            request.placement.tobytes(),
            below,
            item.on_mesh and serial,  # False: other points do not depend on the mesh
            item.sea_level,
            item.water,
        )
        culls = item.culls and is_uncut
        key += (culls and (request.criterion, request.frozen),)  # the mesh that hides them depends on these
        if key == record.key:
            continue
        start, record.key = time.perf_counter(), ()  # without a key, points that fail are made again later
        try:
            wanted = ScatterRequest(
                item.scatter,
                scatters.views,
                request.placement,
                *scale,
                boundary=request.cleanup.boundary,
                water=item.water,
                horizon=horizon() if culls else None,
                max_points=scatters.max_points,
            )
            points = place_points(heights, wanted, record.history, terrain.threads)
        except TerrainError as error:
            raise error.within(f"The scatter {item.name!r} cannot be made") from None
        if item.on_mesh:
            points = on_mesh(points, terrain, surface)
        if below is not None:  # the ground there is cut away
            points = points.only(np.flatnonzero(points.positions[:, 2] >= below))
        if item.sea_level > -math.inf:
            points = points.only(np.flatnonzero(points.positions[:, 2] > item.sea_level))
        record.points, record.key, record.runs = points, key, record.runs + 1
        record.ms = {"points": (time.perf_counter() - start) * 1e3}


def show_points(terrain, records: dict[int, ScatterRecord], request) -> None:
    """Write the points of a request into the meshes of the scatters' objects, unless they are there already.

    records: from `make_points`, by session_uid of the object; those of objects that are gone are removed.
    """
    from ..bridge.point_writer import write_points

    uids = {item.uid for item in request.scatters.items}
    children = {obj.session_uid: obj for obj in scatters_of(terrain)}
    for uid in set(records) - set(children):
        del records[uid]
    for uid in uids & set(children):
        record, mesh = records[uid], children[uid].data
        shown = record.key, mesh.session_uid, len(mesh.vertices)  # the object may have another mesh, as after an undo
        if record.points is None or shown == record.shown:
            continue
        start = time.perf_counter()
        if mesh.users > 1:
            children[uid].data = mesh = mesh.copy()
        write_points(mesh, record.points)
        record.shown = record.key, mesh.session_uid, len(mesh.vertices)
        record.ms["mesh"] = (time.perf_counter() - start) * 1e3
