# SPDX-License-Identifier: GPL-3.0-or-later
"""Scatter that stands still: each frame's points are a function of the declaration, the terrain and the views alone.

A point has a rank r in 0 .. 1, and is whole where a view wants as much: its density, times what is left of it at that
distance. Where a little less is wanted it is there and grows from nothing. So points come and go one by one; none
moves.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ...kernels.refine.pixels import Asked, LocalView
from ...kernels.scatter import points as kernels
from ...kernels.scatter.seams import Pattern
from ...kernels.scatter.seen import Views
from ..ask.criterion import Criterion
from ..ask.linear import lengths, settled, solve
from ..ask.local_view import localise
from ..ask.view import View, listed_views
from ..effects.effect import Places
from ..errors import TerrainError
from ..evaluate.evaluate import values_at
from ..field import coats
from ..field.heightfield import HeightField
from ..mesh.outline import counter_clockwise, covered
from ..mesh.surface import Surface
from ..plain_numbers import vertical
from ..refine.domain import make_domain
from ..run import launch
from ..run.buffers import Buffers, flat, shared
from ..run.locks import SharedLock
from ..terrain import Terrain, box_of
from .kept import Kept
from .scatter import MOST_TILES, Scatter
from .squares import TOO_MANY, Squares, squares_wanted
from .tile import FINEST, POINTS, tile

SPARE = 1.25  # times what is wanted of a square, that is put on the ground: a camera that creeps wants a little more


@dataclass(frozen=True)
class Points:
    """Points of a frame. `positions`: float32 [n, 3], metres in the terrain's own space. `normals`: float32 [n, 3] of
    the ground. `size`: float32 [n], 0 where a point begins. `id`: int64 [n], the same for a point in every frame.
    `variant`: int32 [n], any number from 0 to 2^31 - 1, for a choice. `rotation`: float32 [n, 4], quaternions w, x, y,
    z. `tested`: how many candidates were looked at."""

    positions: np.ndarray
    normals: np.ndarray
    size: np.ndarray
    id: np.ndarray
    variant: np.ndarray
    rotation: np.ndarray
    tested: int = 0

    def __len__(self) -> int:
        return len(self.positions)

    def only(self, which: np.ndarray) -> "Points":
        """Those of the numbers `which`, or where that is true."""
        parts = self.positions, self.normals, self.size, self.id, self.variant, self.rotation
        return Points(*(part[which] for part in parts), self.tested)


def scatter_points(field: HeightField, scatter: Scatter, views: Iterable[View] = (), **placed) -> Points:
    """The points that views see; without a view all of them, at full density. Arguments as of Scatterer.points."""
    names = "vertical_scale", "vertical_offset", "threads", "boundary"
    fixed = {name: placed.pop(name) for name in names if name in placed}
    return Scatterer(field, scatter, **fixed).points(views, **placed)


class Scatterer:
    """A scatter on a height field, with its candidates on the ground, which later frames need again.

    What is kept changes no result: candidates depend on no view. Threads may share it: one call waits for another.
    Arguments as of Terrain and of Terrain.update.
    `boundary`: points are above or below one of these triangles, float64 [n, 3, 2], x and y in the terrain's space.
    """

    def __init__(
        self,
        field: HeightField,
        scatter: Scatter,
        vertical_scale: float = 1.0,
        vertical_offset: float = 0.0,
        threads: int | None = None,
        boundary: np.ndarray | None = None,
    ):
        self.field, self.scatter = field, scatter
        self.threads = launch.checked_threads(threads)
        self._scale = vertical(vertical_scale, vertical_offset)
        self._box = box_of(field, *self._scale)
        self._domain = make_domain(field, 0, *self._scale)
        self._coats = coats.packed(field.detail, field.finest_edge, field.lattice)
        valid = np.empty(0, np.uint8) if field.valid is None else field.valid
        self._valid = flat(np.ascontiguousarray(valid), wp.uint8)
        self._pattern, self._tiles = _laid(field, scatter)
        self._look = _look(scatter, self._tiles)
        self._boundary = None if boundary is None else counter_clockwise(boundary)
        self._ground, self._buffers, self._lock = Kept(), Buffers(), SharedLock()

    @property
    def nbytes(self) -> int:
        """Bytes that are kept for later frames."""
        return self._ground.nbytes + self._buffers.nbytes

    def points(
        self,
        views: Iterable[View] = (),
        placement: np.ndarray | None = None,
        horizon: "Asked | None" = None,
        most: tuple[int, str] | None = None,
    ) -> Points:
        """The points that views see, the terrain standing at `placement` (4 x 4, to the world).

        `horizon`: of Terrain.horizon for the same views; squares of the plan that are hidden from all of them, with
        what reaches `margin_m` out of them, have no points then. Those that are left are as they are without. `most`:
        how many points there may be, and whose limit that is, for the message.
        Raises TerrainError for a view that cannot be, for another's horizon, for more candidates than memory should
        hold, for more points than may be and for heights that are not finite.
        """
        views = listed_views(views)
        with self._lock:
            if self._lock.broken:
                self._ground, self._buffers, self._lock.broken = Kept(), Buffers(), False
            return self._points(views, placement, horizon, most)

    def _points(
        self,
        views: list[View],
        placement: np.ndarray | None,
        horizon: "Asked | None",
        most: tuple[int, str] | None,
    ) -> Points:
        seen, pattern = self._seen(views, placement, horizon), self._pattern
        placed = pattern.west, pattern.south, pattern.side, self.scatter.seed
        densest = min(self.scatter.where.strength, 1.0)  # of its layer's part, all rules holding
        squares = squares_wanted(self.field, self._domain, seen, *placed, densest, self.threads)
        runs, tested = self._runs(squares, len(views)), int(squares.count.sum())
        listed, kept, get = _listed(runs), self._ground.packed(), self._buffers.get
        chosen = kernels.Chosen()
        chosen.which, chosen.rank = get("which", tested, wp.int32), get("rank", tested, wp.int32)
        chosen.grown, chosen.counts = get("grown", tested, wp.float32), get("counts", len(runs), wp.int32)
        pieces = self._pieces(squares.count)
        launch.slices(
            kernels.choose, [[*piece, seen, pattern, listed, kept, chosen] for piece in pieces], step="choose"
        )
        counts = self._buffers.numpy("counts")[: len(runs)].astype(np.int64)
        if most is not None and counts.sum() > most[0]:
            raise TerrainError(TOO_MANY.format(f"{counts.sum():,}", f", expected {most[0]:,} at most, {most[1]}"))
        points = _empty(int(counts.sum()), tested)
        first = flat((np.cumsum(counts) - counts).astype(np.int32), wp.int32)
        inputs = [listed, first, kept, chosen, self._look, _packed(points)]
        launch.slices(kernels.tell, [[*piece, *inputs] for piece in self._pieces(counts)], step="tell")
        return points

    def _seen(self, views: list[View], placement: np.ndarray | None, horizon: "Asked | None") -> Views:
        scatter, placement = self.scatter, np.eye(4) if placement is None else np.asarray(placement, np.float64)
        criterion, seen, local = Criterion(guard_deg=scatter.margin_deg), Views(), []
        for view in views:
            found = localise(view, placement, self._box, criterion, 1.0)
            planes = np.array(found.planes, np.float64).reshape(-1, 4)
            planes[: found.plane_count, 3] += scatter.margin_m
            found.planes = planes
            local.append(found)
        if horizon is not None:
            _hide(local, horizon)
            seen.slopes, linear = horizon.slopes, placement[:3, :3]
            # A ball of the world is an ellipsoid in the terrain's space, this its box.
            seen.reach = scatter.margin_m * lengths(solve(linear, np.eye(3)).T) * (1 + 1e-9)
        seen.count, seen.full2 = len(local), scatter.full_until * scatter.full_until if scatter.full_until else math.inf
        seen.views = wp.array(local or [LocalView()], dtype=LocalView, device=launch.DEVICE)
        return seen

    def _runs(self, squares: Squares, views: int) -> np.ndarray:
        """The runs of squares that so many views want, on the ground then: Run's numpy dtype [n]."""
        tiles, window = squares.of_tile(self.scatter.seed)
        runs = np.zeros(len(window), kernels.Run.numpy_dtype())
        first, most = tile().runs(squares.halvings, window)
        runs["tile_x"], runs["tile_y"], runs["first"], runs["count"] = *tiles.T, first, squares.count
        runs["out"] = np.cumsum(squares.count) - squares.count
        runs["clear"] = squares.clear if views == 1 else 0
        keys = (tiles[:, 1].astype(np.int64) * self._tiles + tiles[:, 0]) * tile().length + first
        at, known = self._ground.find(keys, squares.count)
        if not known.all():
            fresh, count = runs[~known], squares.count[~known]
            fresh["count"] = count = np.minimum((SPARE * count).astype(np.int64) + 8, most[~known])
            begin = self._ground.reserve(int(count.sum()), keys[known])
            fresh["at"] = begin + np.cumsum(count) - count
            self._put_on_ground(fresh, slice(begin, begin + int(count.sum())))
            self._ground.add(keys[~known], count)
            at, _ = self._ground.find(keys, squares.count)
        runs["at"] = at
        return runs

    def _put_on_ground(self, runs: np.ndarray, where: slice) -> None:
        inputs = [self._domain, self._coats, self._valid, self._pattern, _listed(runs), self._ground.packed()]
        pieces = self._pieces(runs["count"])
        launch.slices(kernels.place, [[*piece, *inputs] for piece in pieces], step="place")
        positions, density = self._ground.positions[where], self._ground.density[where]
        if not np.isfinite(positions).all():
            raise self.field.damage("it has heights that are not finite or too large for a mesh")
        if self._boundary is not None:
            density *= covered(self._boundary, positions[:, :2].astype(np.float64))
        reads = self.scatter.reads()
        there = np.flatnonzero(density) if reads else np.empty(0, np.int64)
        if len(there):
            places = Places(self.field, positions[there], np.zeros(len(there), np.float32), *self._scale, self.threads)
            for asked, column in reads:
                density[there] *= values_at(places, [asked])[asked.name][:, column]

    def _pieces(self, counts: np.ndarray) -> list[tuple[int, int]]:
        """Ranges of runs with as many candidates each, for as many threads as pay."""
        ends = np.cumsum(counts)
        total = int(ends[-1]) if len(ends) else 0
        pieces = max(1, min(self.threads, total // launch.SLICE_ITEMS))
        cuts = np.searchsorted(ends, total * np.arange(1, pieces) / pieces).tolist()
        return list(zip([0, *cuts], [*cuts, len(counts)], strict=True))


def on_mesh(points: Points, terrain: Terrain, surface: Surface) -> Points:
    """The points at the heights that the terrain's last surface has there; normals stay those of the ground.

    Where that has no triangle they stay where they are.
    """
    places = points.positions[:, :2].astype(np.float64)
    number = terrain.triangles_at(places)
    there = np.flatnonzero(number >= 0)
    a, b, c = (surface.positions[surface.triangles[number[there], k]].astype(np.float64) for k in range(3))
    (ux, uy), (vx, vy), (px, py) = (b - a)[:, :2].T, (c - a)[:, :2].T, (places[there] - a[:, :2]).T
    area = ux * vy - uy * vx
    s, t = (px * vy - py * vx) / area, (ux * py - uy * px) / area
    positions = points.positions.copy()
    positions[there, 2] = a[:, 2] + s * (b - a)[:, 2] + t * (c - a)[:, 2]
    return replace(points, positions=positions)


def _hide(views: list[LocalView], horizon: Asked) -> None:
    """Give views the rings of their horizons. Raises TerrainError for those of others."""
    others = horizon.views.numpy()[: horizon.view_count]
    if len(others) != len(views) or any(list(v.eye) != o["eye"].tolist() for v, o in zip(views, others, strict=True)):
        raise TerrainError("The horizon is one of other views; update the terrain for those of the scatter first.")
    for view, other in zip(views, others, strict=True):
        view.rings.first, view.rings.count, view.rings.at = (int(number) for number in other["rings"])


def _laid(field: HeightField, scatter: Scatter) -> tuple[Pattern, int]:
    """Tiles laid over the raster, moved by the seed, and how many there are in a row."""
    west, south, east, north = field.lattice.rectangle()
    side, pattern = scatter.tile_side, Pattern()
    tiles = int(max(east - west, north - south) / side) + 2
    if tiles > MOST_TILES:
        raise TerrainError(
            f"The scatter's spacing is {scatter.spacing:g} m on a terrain of {max(east - west, north - south):g} m; "
            "expected more: it is finer than a mesh can hold."
        )
    # Parts of a side by which scatters of other seeds lie elsewhere (R2 of Roberts, 2018).
    parts = (scatter.seed * 0.7548776662466927) % 1.0, (scatter.seed * 0.5698402909980532) % 1.0
    pattern.west, pattern.south = west - side * parts[0], south - side * parts[1]
    pattern.side, pattern.seed, own = side, scatter.seed, tile()
    pattern.place = shared(own.place, wp.vec2i)
    pattern.order = flat(np.concatenate(own.order), wp.int32)
    pattern.first = flat((own.length - POINTS + own.first[FINEST]).astype(np.int32), wp.int32)
    return pattern, tiles


def _look(scatter: Scatter, tiles: int) -> kernels.Look:
    look = kernels.Look()
    look.seed, look.tiles = scatter.seed, tiles
    look.size, look.variation, look.align = scatter.size, scatter.variation, scatter.align
    half = [math.pi * k / int(kernels.TURNS) for k in range(int(kernels.TURNS))]
    for name, of in (("cosine", math.cos), ("sine", math.sin)):
        setattr(look, name, flat(np.array([settled(of(angle)) for angle in half], np.float32), wp.float32))
    return look


def _listed(runs: np.ndarray) -> wp.array:
    return wp.array(runs, dtype=kernels.Run, device=launch.DEVICE, copy=False)


def _empty(count: int, tested: int) -> Points:
    vectors = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    numbers = np.empty(count, np.float32), np.empty(count, np.int64), np.empty(count, np.int32)
    return Points(*vectors, *numbers, np.empty((count, 4), np.float32), tested)


def _packed(points: Points) -> kernels.Points:
    made = kernels.Points()
    made.positions, made.normals = shared(points.positions, wp.vec3f), shared(points.normals, wp.vec3f)
    made.size, made.id = flat(points.size, wp.float32), flat(points.id, wp.int64)
    made.variant, made.rotation = flat(points.variant, wp.int32), shared(points.rotation, wp.vec4f)
    return made
