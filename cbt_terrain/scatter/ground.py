# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground of a scatter: its pattern over a placed field, and the candidates on it.

Square tiles repeat one pattern of points, each with another shift (tile.py). A point's rank is its number in the order
in which points appear as the density grows. A part of a tile shows a window of the pattern; its candidates are the
window's points from the lowest rank on.
"""

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels.field.detail import PackedLayers
from ...kernels.field.domain import Domain
from ...kernels.refine.pixels import CriterionArrays
from ...kernels.scatter import points as kernels
from ...kernels.scatter.seams import Pattern
from ..attributes.attribute import SamplePoints
from ..attributes.evaluate import values_at
from ..attributes.scale import footprint_levels
from ..errors import TerrainError
from ..field import displacement_layers
from ..field.domain import box_of, make_domain
from ..field.georeference import from_crs
from ..field.heightfield import HeightField
from ..field.known_ground import KnownTiles, known_samples, known_tiles_of
from ..mesh.outline import counter_clockwise
from ..mesh.plan_triangles import PlanTriangles
from ..plain_numbers import vertical
from ..run import launch
from ..run.buffers import flat, shared
from ..view.linear import round_last_bits
from ..view.view import View
from .candidates import Candidates
from .scatter import MAX_TILES, Scatter
from .squares import Squares
from .tile import FINEST, POINTS, tile

SAME = 1e-3  # distance of two corners, in cells, that counts as rounding
SPARE = 1.25  # candidates placed over those needed, since a slow camera needs a few more in the next frame


@dataclass(frozen=True, eq=False)
class ScatterRequest:
    """A request for the points that views see, or without views for all points at full density.

    `placement`: 4 x 4 matrix to the world. `boundary`: triangles that points are above or below, float64 [n, 3, 2], x
    and y in the terrain's space. `water`: triangles there that no point is above or below. `horizon`: Terrain.horizon
    for the same views; squares of the plan that are hidden from all of them, including everything within `margin_m`,
    have no points then. The other points do not change. `max_points`: the maximum number of points and the name of the
    limit for the message.
    """

    scatter: Scatter
    views: Iterable[View] = ()
    placement: np.ndarray | None = None
    vertical_scale: float = 1.0
    vertical_offset: float = 0.0
    boundary: np.ndarray | None = None
    water: PlanTriangles | None = None
    horizon: "CriterionArrays | None" = None
    max_points: tuple[int, str] | None = None


@dataclass(eq=False)
class ScatterGround:
    """A scatter on a placed field, independent of views. A frame history owns it.

    `scale`: vertical scale and offset. `boundary`, `water`: see ScatterRequest. `box`: of the terrain, float64 [2, 3]
    metres. `domain`, `detail`, `valid`, `pattern`, `style`: what kernels read. `tiles`: number of tiles in a row of the
    raster. `with_ground`: tiles of a mosaic with wide gaps that hold all its ground; None for other fields.
    """

    field: HeightField
    scatter: Scatter
    scale: tuple[float, float]
    boundary: np.ndarray | None
    water: PlanTriangles | None
    box: np.ndarray
    domain: Domain
    detail: PackedLayers
    valid: wp.array
    pattern: Pattern
    tiles: int
    style: kernels.ScatterStyle
    with_ground: KnownTiles | None = None
    candidates: Candidates = dataclasses.field(default_factory=Candidates)

    @classmethod
    def of(cls, field: HeightField, request: ScatterRequest) -> "ScatterGround":
        """Return the ground that fits a ScatterRequest on this field; its cache of candidates is empty."""
        scale = vertical(request.vertical_scale, request.vertical_offset)
        valid = known_samples(field)
        valid = np.empty(0, np.uint8) if valid is None else valid
        box, domain = box_of(field, *scale), make_domain(field, 0, *scale)  # 0: no meshlets
        detail = displacement_layers.pack_layers(field.detail, field.finest_edge, field.lattice)
        pattern, tiles = _pattern(field, request.scatter)
        flags, style = flat(np.ascontiguousarray(valid), wp.uint8), _style(request.scatter, pattern, tiles)
        placed = box, domain, detail, flags, pattern, tiles, style, known_tiles_of(field)
        return cls(field, request.scatter, scale, request.boundary, request.water, *placed)

    def is_of(self, field: HeightField, request: ScatterRequest) -> bool:
        """Return whether this ground fits a ScatterRequest on this field, so that its candidates can be reused."""
        scale, one, other = (request.vertical_scale, request.vertical_offset), self.boundary, request.boundary
        same = field is self.field and request.scatter == self.scatter and scale == self.scale
        same &= request.water is self.water
        return same and (one is other or (one is not None and other is not None and np.array_equal(one, other)))

    def runs(self, squares: Squares, views: int, threads: int) -> np.ndarray:
        """Return the run of candidates (contiguous entries of the cache) of each square, in CandidateRun's dtype [n].

        views: number of views. Candidates that the cache lacks are computed, somewhat more than are needed.
        """
        tiles, window = squares.of_tile(self.scatter.seed)
        runs = np.zeros(len(window), kernels.CandidateRun.numpy_dtype())
        first_rank, available = tile().runs(squares.halvings, window)  # index of each window's first rank; its ranks
        runs["tile_x"], runs["tile_y"], runs["first"], runs["count"] = *tiles.T, first_rank, squares.count
        runs["out"] = np.cumsum(squares.count) - squares.count
        # clear: inside the only view's frame; of several views it is unknown whose frame that is
        runs["clear"] = squares.clear if views == 1 else 0
        # A key is the square's tile and its first rank in one number.
        keys = (tiles[:, 1].astype(np.int64) * self.tiles + tiles[:, 0]) * tile().length + first_rank
        cached_at, known = self.candidates.find(keys, squares.count)
        if not known.all():
            fresh, count = runs[~known], squares.count[~known]
            fresh["count"] = count = np.minimum((SPARE * count).astype(np.int64) + 8, available[~known])
            begin = self.candidates.reserve(int(count.sum()), keys[known])
            fresh["at"] = begin + np.cumsum(count) - count
            self._place(fresh, slice(begin, begin + int(count.sum())), threads)
            self.candidates.add(keys[~known], count)
            cached_at, _ = self.candidates.find(keys, squares.count)
        runs["at"] = cached_at
        return runs

    def _place(self, runs: np.ndarray, added: slice, threads: int) -> None:
        """Compute positions, normals and densities of candidates.

        The density is the product of the pattern's (below 1 at seams of tiles), the boundary's, the water's and that of
        attributes. runs: a CandidateRun for each square. added: their slice of the candidates' arrays. Raises
        TerrainError for heights that are not finite.
        """
        inputs = [self.domain, self.detail, self.valid, self.pattern, pack_runs(runs), self.candidates.packed()]
        launch.slices(
            kernels.place_candidates, [[*piece, *inputs] for piece in pieces_of(runs["count"], threads)], step="place"
        )
        positions, density = self.candidates.positions[added], self.candidates.density[added]
        if not np.isfinite(positions).all():
            raise self.field.raster.damage("it has heights that are not finite or too large for a mesh")
        if self.boundary is not None:
            density *= PlanTriangles(counter_clockwise(self.boundary)).cover(positions[:, :2].astype(np.float64))
        if self.water is not None:
            density *= ~self.water.cover(positions[:, :2].astype(np.float64))
        reads = self.scatter.reads()
        positive = np.flatnonzero(density) if reads else np.empty(0, np.int64)
        if len(positive):
            positive_positions = positions[positive]
            places = SamplePoints(
                self.field,
                positive_positions,
                footprint_levels(self.field, positive_positions, views=()),
                *self.scale,
                threads,
            )
            for request, column in reads:
                density[positive] *= values_at(places, [request])[request.name][:, column]


def pieces_of(counts: np.ndarray, threads: int) -> list[tuple[int, int]]:
    """Return ranges of runs (first, end) with about equal numbers of candidates, for a useful number of threads.

    counts: candidates of each run, [n].
    """
    ends = np.cumsum(counts)
    total = int(ends[-1]) if len(ends) else 0
    pieces = max(1, min(threads, total // launch.SLICE_ITEMS))
    cuts = np.searchsorted(ends, total * np.arange(1, pieces) / pieces).tolist()
    return list(zip([0, *cuts], [*cuts, len(counts)], strict=True))


def pack_runs(runs: np.ndarray) -> wp.array:
    """Return runs of candidates as an array for kernels."""
    return wp.array(runs, dtype=kernels.CandidateRun, device=launch.DEVICE, copy=False)


def _pattern(field: HeightField, scatter: Scatter) -> tuple[Pattern, int]:
    """Return the pattern over the raster, shifted by the seed, and the number of tiles in a row.

    Raises TerrainError for more than MAX_TILES.
    """
    west, south, east, north = field.lattice.rectangle()
    side, pattern = scatter.tile_side, Pattern()
    tiles = int(max(east - west, north - south) / side) + 2  # one for the shift, one for a partial tile
    if tiles > MAX_TILES:
        raise TerrainError(
            f"The scatter's spacing is {scatter.spacing:g} m on a terrain of {max(east - west, north - south):g} m, "
            "which is finer than a mesh can hold",
            fix="increase it",
        )
    # Shifts for each seed in fractions of a side (R2 of Roberts, 2018).
    shift = (scatter.seed * 0.7548776662466927) % 1.0, (scatter.seed * 0.5698402909980532) % 1.0
    corner = _corner_of(field, scatter)
    pattern.west, pattern.south = corner[0] - side * shift[0], corner[1] - side * shift[1]
    pattern.first_x = math.floor((west - pattern.west) / side)
    pattern.first_y = math.floor((south - pattern.south) / side)
    pattern.side, pattern.seed, ranked = side, scatter.seed, tile()
    pattern.place = shared(ranked.place, wp.vec2i)
    pattern.order = flat(np.concatenate(ranked.order), wp.int32)
    # `order` lists the ranks of the windows of all sizes, the smallest windows last: each point is in one of these, so
    # they have the last POINTS ranks. `ranked.first[FINEST]` counts from there.
    pattern.first = flat((ranked.length - POINTS + ranked.first[FINEST]).astype(np.int32), wp.int32)
    return pattern, tiles


def _corner_of(field: HeightField, scatter: Scatter) -> tuple[float, float]:
    """Return the point from which tiles are counted, metres in the terrain's space.

    It is the scatter's corner, or the raster's own in the south-west if the scatter has none, or one that is the same
    up to rounding or more than MAX_TILES tiles away.
    """
    raster_corner, place = field.lattice.rectangle()[:2], field.raster.known_place
    if scatter.corner is None or place is None:
        return raster_corner
    corner = from_crs(place, np.array([scatter.corner]))[0]
    distance = float(np.abs(corner - raster_corner).max())
    rounding = SAME * min(field.lattice.step_x, field.lattice.step_y)
    return tuple(corner.tolist()) if rounding < distance < MAX_TILES * scatter.tile_side else raster_corner


def _style(scatter: Scatter, pattern: Pattern, tiles: int) -> kernels.ScatterStyle:
    """Return the sizes, the alignment and a table of rotations about the vertical for kernels.

    It has cosines and sines of half of each angle, as quaternions do, rounded so that all C libraries give the same
    bytes. tiles: number of tiles in a row of the pattern.
    """
    style = kernels.ScatterStyle()
    style.seed, style.tiles, style.first_tile = scatter.seed, tiles, pattern.first_y * tiles + pattern.first_x
    style.size, style.variation, style.align = scatter.size, scatter.variation, scatter.align
    half = [math.pi * k / int(kernels.TURNS) for k in range(int(kernels.TURNS))]
    for name, function in (("cosine", math.cos), ("sine", math.sin)):
        setattr(
            style, name, flat(np.array([round_last_bits(function(angle)) for angle in half], np.float32), wp.float32)
        )
    return style
