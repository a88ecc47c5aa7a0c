# SPDX-License-Identifier: GPL-3.0-or-later
"""Stable scatter: the points of each frame are a function of the declaration, the terrain and the views alone.

A point has a rank r in 0 .. 1. It has its full size where the density at its distance is at least r, and is smaller,
down to 0, where the density is a little less. Points therefore appear and vanish one by one, and none moves.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from ...kernels.refine.local_view import LocalView
from ...kernels.refine.pixels import CriterionArrays
from ...kernels.scatter import points as kernels
from ...kernels.scatter.seen import Views
from ..errors import TerrainError, check_kind
from ..field.heightfield import HeightField, check_field
from ..history.frame_history import FrameHistory
from ..mesh.surface import Surface
from ..plain_numbers import matrix
from ..run import launch
from ..run.buffers import flat
from ..terrain import Terrain
from ..view.criterion import Criterion
from ..view.linear import lengths, solve
from ..view.local_view import localise
from ..view.view import View, listed_views
from .ground import ScatterGround, ScatterRequest, pack_runs, pieces_of
from .scatter import Scatter
from .squares import squares_in_view, too_many_error

ARRAYS = {
    "positions": wp.vec3f,
    "normals": wp.vec3f,
    "size": wp.float32,
    "id": wp.int64,
    "variant": wp.int32,
    "rotation": wp.vec4f,
}


@dataclass(frozen=True)
class ScatterPoints:
    """Points of a frame.

    `positions`: float32 [n, 3], metres in the terrain's space. `normals`: float32 [n, 3], of the ground. `size`:
    float32 [n], from 0 on. `id`: int64 [n], the same for a point in every frame. `variant`: int32 [n], a random number
    from 0 to 2^31 - 1. `rotation`: float32 [n, 4], quaternions w, x, y, z. `tested`: number of tested candidates. The
    arrays are read-only.
    """

    positions: np.ndarray
    normals: np.ndarray
    size: np.ndarray
    id: np.ndarray
    variant: np.ndarray
    rotation: np.ndarray
    tested: int = 0

    def __len__(self) -> int:
        return len(self.positions)

    def only(self, which: np.ndarray) -> "ScatterPoints":
        """Return the points with the indices, or the mask, `which`."""
        return ScatterPoints(**{name: getattr(self, name)[which] for name in ARRAYS}, tested=self.tested)


def scatter_points(
    field: HeightField, scatter: Scatter, views: Iterable[View] = (), threads: int | None = None, **placed: Any
) -> ScatterPoints:
    """Return the points that views see, or without views all points at full density.

    placed: further fields of ScatterRequest, as `placement`.
    """
    check_field(field)
    check_kind(scatter, Scatter, "The scatter", "a Scatter, as Scatter(spacing=10)")
    return place_points(field, ScatterRequest(scatter, views, **placed), FrameHistory(), threads)


def place_points(
    field: HeightField, request: ScatterRequest, history: FrameHistory, threads: int | None = None
) -> ScatterPoints:
    """Return the points that a scatter request places in its views.

    The history caches candidates, which depend on no view, so that the points are the same with any history.

    Raises TerrainError for an invalid view, a horizon made for other views, too many candidates for the memory, more
    points than `max_points`, and heights that are not finite.
    """
    views, threads = listed_views(request.views), launch.checked_threads(threads)
    with history.alone():
        ground, history.ground = history.ground, None  # discarded if this is interrupted
        if ground is None or not ground.is_of(field, request):
            ground = ScatterGround.of(field, request)
        points = _points(request, views, ground, history, threads)
        history.ground = ground
        return points


def _points(
    request: ScatterRequest, views: list[View], ground: ScatterGround, history: FrameHistory, threads: int
) -> ScatterPoints:
    """Choose the candidates in the views, and fill the history's arrays with their points.

    Two kernels run: `choose` lists the chosen candidates of each run, and `fill_points` writes them after the counts
    are known. Raises TerrainError for more points than `request.max_points`, a limit and its name.
    """
    scratch = history.scratch
    seen, pattern, scatter = _pack_views(request, views, ground), ground.pattern, request.scatter
    tiling = pattern.west, pattern.south, pattern.side, scatter.seed
    max_density = min(scatter.where.strength, 1.0)  # rules only lower it
    squares = squares_in_view(ground.field, ground.domain, seen, *tiling, max_density, threads, ground.with_ground)
    runs, tested = ground.runs(squares, len(views), threads), int(squares.count.sum())
    listed, candidates = pack_runs(runs), ground.candidates.packed()
    chosen = kernels.Chosen()
    chosen.which, chosen.rank = scratch.get("which", tested, wp.int32), scratch.get("rank", tested, wp.int32)
    chosen.scale, chosen.counts = scratch.get("grown", tested, wp.float32), scratch.get("counts", len(runs), wp.int32)
    inputs = [[*piece, seen, pattern, listed, candidates, chosen] for piece in pieces_of(squares.count, threads)]
    launch.slices(kernels.choose, inputs, step="choose")
    counts = scratch.numpy("counts")[: len(runs)].astype(np.int64)
    if request.max_points is not None and counts.sum() > request.max_points[0]:
        limit, limit_name = request.max_points
        raise too_many_error(f"{counts.sum():,}", f"at most {limit:,}, {limit_name}")
    total = int(counts.sum())
    first = flat((np.cumsum(counts) - counts).astype(np.int32), wp.int32)
    inputs = [listed, first, candidates, chosen, ground.style, _point_arrays(history, total)]
    launch.slices(kernels.fill_points, [[*piece, *inputs] for piece in pieces_of(counts, threads)], step="tell")
    return ScatterPoints(**{name: history.lend(history.points, name, total) for name in ARRAYS}, tested=tested)


def _pack_views(request: ScatterRequest, views: list[View], ground: ScatterGround) -> Views:
    """Return the views as kernels read them: frusta in the terrain's space, widened by the scatter's margins.

    They have the horizon that hides points, too, and the square of the distance in metres up to which density is full.
    """
    scatter, horizon, packed, local = request.scatter, request.horizon, Views(), []
    placement = np.eye(4) if request.placement is None else matrix(request.placement, "placement")
    criterion, margins = Criterion(), (scatter.margin_deg, scatter.margin_deg)
    for view in views:
        # any criterion and scale: they change footprints, which scatters do not read
        local_view = localise(view, placement, ground.box, criterion, height_scale=1.0, margins=margins)
        # a plane gives the distance to it in metres of the world
        planes = np.array(local_view.planes, np.float64).reshape(-1, 4)
        planes[: local_view.plane_count, 3] += scatter.margin_m
        local_view.planes = planes
        local.append(local_view)
    if horizon is not None:
        _take_horizon(local, horizon)
        packed.slopes, linear = horizon.slopes, placement[:3, :3]
        # The box of the ellipsoid that a ball of the world is in the terrain's space.
        packed.reach = scatter.margin_m * lengths(solve(linear, np.eye(3)).T) * (1 + 1e-9)
    packed.count, packed.full2 = len(local), scatter.full_until * scatter.full_until if scatter.full_until else math.inf
    packed.views = wp.array(local or [LocalView()], dtype=LocalView, device=launch.DEVICE)
    return packed


def on_mesh(points: ScatterPoints, terrain: Terrain, surface: Surface) -> ScatterPoints:
    """Move points to the heights of a terrain's surface, where it has a triangle; normals do not change.

    surface: that of the terrain's last update. Raises TerrainError before the first one.
    """
    places = points.positions[:, :2].astype(np.float64)
    triangle = terrain.triangles_at(places)
    on_triangle = np.flatnonzero(triangle >= 0)
    a, b, c = (surface.positions[surface.triangles[triangle[on_triangle], k]].astype(np.float64) for k in range(3))
    (ux, uy), (vx, vy), (px, py) = (b - a)[:, :2].T, (c - a)[:, :2].T, (places[on_triangle] - a[:, :2]).T
    area = ux * vy - uy * vx
    s, t = (px * vy - py * vx) / area, (ux * py - uy * px) / area  # weights of b and c
    positions = points.positions.copy()
    positions[on_triangle, 2] = a[:, 2] + s * (b - a)[:, 2] + t * (c - a)[:, 2]
    return replace(points, positions=positions)


def _take_horizon(views: list[LocalView], horizon: CriterionArrays) -> None:
    """Give each view the rings of its horizon map, in place, so that points behind ground are left out.

    horizon: the mapped views, from Terrain.horizon. Raises TerrainError if their number or their eyes are others.
    """
    mapped = horizon.views.numpy()[: horizon.view_count]
    if len(mapped) != len(views) or any(list(v.eye) != m["eye"].tolist() for v, m in zip(views, mapped, strict=True)):
        raise TerrainError("The horizon is one of other views", fix="update the terrain for the scatter's views first")
    for view, mapped_view in zip(views, mapped, strict=True):
        view.rings.first, view.rings.count, view.rings.at = (int(number) for number in mapped_view["rings"])


def _point_arrays(history: FrameHistory, count: int) -> kernels.PointArrays:
    """Return memory for `count` points, for kernels to fill; it is reused and no result refers to it."""
    room, arrays = kernels.PointArrays(), history.room_for_points()
    for name, dtype in ARRAYS.items():
        setattr(room, name, arrays.get(name, count, dtype))
    return room
