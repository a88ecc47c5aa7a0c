# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain: one height field and its adaptive mesh, updated for the views."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, cast

import numpy as np

from ..kernels.field.domain import Domain
from ..kernels.refine.pixels import CriterionArrays
from .errors import TerrainError, check_kind
from .field.depths import depth_in_plane, depth_limit, plane_limit, usual_depth
from .field.domain import box_of
from .field.heightfield import HeightField, check_field
from .history.frame import Leaves
from .history.frame_history import FrameHistory
from .leb.location import locate
from .mesh.builder import SurfaceRequest, build_surface
from .mesh.geomorph import Geomorph
from .mesh.pieces import Pieces, middles
from .mesh.surface import Surface
from .mesh.welding import TornMesh
from .plain_numbers import matrix, plain_number, rows, vertical
from .refine.contract import Outcome, bounds_of
from .refine.horizon import RAMP, horizon_of, place_rings
from .refine.refinement import MAX_TRIANGLES, refine, replay
from .refine.reported_bounds import ReportedBounds
from .refine.request import RefinementRequest, pack, refinable_domain
from .refine.saved_leaves import OTHER_FIELD, depths_in_squares
from .refine.terms import MARGIN, Terms, position_rounding, rounding
from .run import launch
from .tree.concurrent_binary_tree import ConcurrentBinaryTree
from .view.criterion import Criterion
from .view.linear import add_up
from .view.local_view import localise
from .view.spans import PlanUnits, spans_of
from .view.update_request import UpdateRequest
from .view.view import View, listed_views


@dataclass(frozen=True, kw_only=True)
class Update(ReportedBounds):
    """Result of one update, with the bounds of its mesh.

    The arrays of `surface` are read-only, and later updates do not change them: memory is reused once they are no
    longer in use. `copy()` has arrays that can be written.

    `leaves`: their number. `changed`: False if the mesh is the one of the last update. `ms`: milliseconds of each step
    by name, {} if the arguments were those of the last update.
    """

    surface: Surface
    leaves: int
    changed: bool
    ms: dict[str, float] = field(default_factory=dict, compare=False)

    @property
    def triangles(self) -> int:
        """Return the number of triangles of the surface."""
        return len(self.surface.triangles)

    def copy(self) -> "Update":
        """Return a copy with a surface in new arrays, which can be written."""
        return replace(self, surface=self.surface.copy())

    def __repr__(self) -> str:
        bounds = (f"within {b:.3g} {unit}" for b, unit in ((self.bound_px, "px"), (self.bound_m, "m")) if b is not None)
        return f"<{type(self).__name__}: {', '.join((f'{self.triangles:,} triangles', *bounds))}>"


class _Shape(NamedTuple):
    """The arguments that place the vertices of a mesh's leaves.

    `meshlet`: a leaf is drawn as 4**meshlet triangles. `depth`: the largest number of bisections of a leaf, without
    those of its meshlet; of a restored mesh that of its deepest leaf. `vertical_offset`: metres. `morph_until`: as of
    `Criterion`.
    """

    meshlet: int
    depth: int
    vertical_scale: float
    vertical_offset: float
    morph_until: float = 1.0


@dataclass
class _Result:
    """The last mesh and its parameters.

    `horizon`: arguments of `horizon_of`, None if occlusion is unknown. `pieces`: pieces of cut triangles, once
    triangles at points are requested.
    """

    update: Update
    shape: _Shape
    horizon: tuple[Domain, CriterionArrays, int, float] | None = None
    pieces: Pieces | None = None


class Terrain:
    """The adaptive mesh of one height field. Updates are pure: the same arguments give the same bytes.

    Threads may share a terrain: one call waits for another. `threads`: number of computing threads, all cores by
    default. `whole`: triangles that reach beyond the border of the raster are not cut there. `history` holds the state
    that survives an update, which only saves time.
    """

    def __init__(self, field: HeightField, threads: int | None = None, whole: bool = False) -> None:
        """Make a terrain without a mesh. threads: None for all cores. whole: the raster's border cuts no triangle."""
        check_field(field)
        self.field = field
        self.threads = launch.checked_threads(threads)
        self.history = FrameHistory()
        self._whole = plain_number(whole, bool, "The argument whole")
        self._placed: tuple[_Shape, Domain] | None = None  # the last placed domain, with its shape

    def __repr__(self) -> str:
        lattice = self.field.lattice
        last = self._last
        mesh = f"{last.update.triangles:,} triangles" if last else "no mesh yet"
        return f"<Terrain: {lattice.width:,} x {lattice.height:,} samples, {mesh}>"

    @property
    def _last(self) -> _Result | None:
        """Return the result of the last update, None before the first and after `discard`."""
        return cast("_Result | None", self.history.last.result)

    @property
    def tree(self) -> ConcurrentBinaryTree | None:
        """Return the concurrent binary tree of the last update."""
        return self.history.tree

    @property
    def buffer_bytes(self) -> int:
        """Return the address space of the engine's arrays; the system commits the pages that are touched."""
        return self.history.nbytes

    def update(
        self,
        criterion: Criterion,
        views: Iterable[View] = (),
        placement: np.ndarray | None = None,
        vertical_scale: float = 1.0,
        vertical_offset: float = 0.0,
    ) -> Update:
        """Refine, weld and displace for the views (their union), the terrain standing at `placement` (4 x 4, to world).

        `views`: a list, any other iterable, or one view. `placement`: the identity by default. Heights become `height *
        vertical_scale + vertical_offset` metres. The arrays of the surface are read-only, and later updates do not
        change them; `copy()` has arrays that can be written. Other threads that update the same terrain wait. Raises
        TerrainError and leaves the last mesh as it is if a number cannot be used. An error while the mesh is built, for
        example of a damaged field, leaves the terrain without a mesh.
        """
        check_kind(criterion, Criterion, "The criterion", "a Criterion, as Criterion(error_px=1)")
        placement = np.eye(4) if placement is None else matrix(placement, "placement")
        scaling = vertical(vertical_scale, vertical_offset)
        request = UpdateRequest(criterion, listed_views(views), placement, *scaling)
        return self._make_once(request.key(), lambda: self._update(request))

    def saved(self) -> tuple[bytes, dict]:
        """Return the tree of the last update as bytes, and the other arguments with which `restore` rebuilds its mesh.

        If points were morphing, `morph` is the ratio where the ramp ends; `restore` puts them at their final heights.
        Raises TerrainError before the first update.
        """
        with self.history.alone():
            shape = self._need_result().shape
            arguments = {name: getattr(shape, name) for name in ("meshlet", "vertical_scale", "vertical_offset")}
            morph = {"morph": shape.morph_until} if shape.morph_until > 1 else {}
            return self._need_tree().to_bytes(), arguments | morph

    def restore(
        self,
        tree: bytes,
        *,
        meshlet: int = 0,
        vertical_scale: float = 1.0,
        vertical_offset: float = 0.0,
        morph: float = 1.0,
    ) -> Update:
        """Rebuild the mesh of a saved tree without a criterion and a camera: the same bytes as when `saved` was called.

        Of points that were morphing the heights differ: they are on the surface now. `morph` is accepted, as `saved`
        returns it, and has no effect. Only the bound in metres is known. Raises TerrainError for bytes that are no tree
        of this height field.
        """
        meshlet = plain_number(meshlet, int, "The meshlet level of the saved tree")
        scaling = vertical(vertical_scale, vertical_offset)
        key = (tree, meshlet, *scaling)
        return self._make_once(key, lambda: self._restore(key, tree, meshlet, *scaling))

    def _make_once(self, key: tuple, make: Callable[[], Update]) -> Update:
        """Return the update that `make` builds, with its milliseconds by step, or the last one if its key is the same.

        make: commits its result with the key. key: all that the result depends on.
        """
        with self.history.alone():
            if self.history.begin(key):
                return replace(self._need_result().update, changed=False, ms={})
            with launch.stopwatch() as ms, launch.timed("total"):
                return replace(make(), ms=ms)

    def _build(self, request: SurfaceRequest, changed: bool) -> Surface:
        """Build a surface of the next frame's leaves, or keep that of the last frame if nothing has changed."""
        if changed:
            return build_surface(self.field, request, self.history, self.threads)
        return self._need_result().update.surface

    def _restore(self, key: tuple, tree: bytes, meshlet: int, vertical_scale: float, vertical_offset: float) -> Update:
        """Rebuild the mesh of a saved tree and commit it as the last frame. Its only bound is in metres.

        Raises TerrainError if the tree does not fit the height field. key: arguments that identify the frame. meshlet:
        leaves are drawn as 4**meshlet triangles.
        """
        box_of(self.field, vertical_scale, vertical_offset)  # refuses numbers that cannot be used
        cell_bits, depths = depths_in_squares(tree, self.field, meshlet)
        shape = _Shape(meshlet, int(depths.max()), vertical_scale, vertical_offset)
        domain = self._placed_domain(shape)
        with self.history.writing():
            leaves, leaf_error = replay(self.field, domain, depths, cell_bits, self.history)
            changed = leaves.changed or self._has_other_shape(shape)
            try:
                surface = self._build(SurfaceRequest(domain, meshlet, whole=self._whole), changed)
            except TornMesh:
                expected, fix = "leaves that form a conforming mesh", "save it again"
                raise TerrainError("The saved tree is corrupt", expected=expected, fix=fix, code=OTHER_FIELD) from None
            # metres of the bound: the leaves' error, the rounding to float32 (heights and plane), and the source's
            terms_m = leaf_error * domain.error_scale, domain.rounding + domain.max_lean, domain.source
            bound = add_up(terms_m) * (1 + MARGIN)
            update = Update(
                surface=surface,
                leaves=leaves.total,
                changed=changed,
                bound_m=bound,
                terms_m=Terms.shares(bound, *terms_m),
            )
            self.history.commit(key, _Result(update, shape), keeps_vertices=not changed)
        return update

    def _has_other_shape(self, shape: _Shape) -> bool:
        """Return whether the last frame placed its points with another shape, so that they cannot be reused."""
        last = self._last
        return last is None or last.shape != shape

    def triangles_at(self, places: np.ndarray) -> np.ndarray:
        """Return the triangle of the last update's surface at each point: int64 [n]; -1 in holes and beyond the raster.

        places: float64 [n, 2], x and y in metres in the terrain's space. The tree gives the whole triangle. Where
        triangles were cut, their pieces are searched; the list of pieces is built once per surface. Raises TerrainError
        for another shape, and before the first update.
        """
        places = rows(places, 2, "places")
        with self.history.alone():
            last, lattice = self._need_result(), self.field.lattice
            surface, meshlet = last.update.surface, last.shape.meshlet
            whole = locate(self._need_tree(), lattice, places, meshlet)
            if not lattice.is_padded and self.field.valid is None:
                return whole
            if last.pieces is None:
                last.pieces = Pieces.of(surface, locate(self._need_tree(), lattice, middles(surface), meshlet))
            return last.pieces.at(whole, places)

    def horizon(self) -> "CriterionArrays | None":
        """Return the horizon maps of the last update's mesh for its views.

        Return None without a view that the criterion uses or without an error criterion, for a restored tree, and with
        holes, which do not occlude. Raises TerrainError before the first update.
        """
        with self.history.alone():
            last = self._need_result()
            return horizon_of(self.field, *last.horizon, self.threads) if last.horizon else None

    def _need_result(self) -> _Result:
        """Return the last result. Raises TerrainError before the first update."""
        if self._last is None:
            raise TerrainError("The terrain has no mesh yet", fix="update it first")
        return self._last

    def _need_tree(self) -> ConcurrentBinaryTree:
        """Return the tree of the last update. Raises TerrainError before the first update."""
        self._need_result()
        return cast(ConcurrentBinaryTree, self.tree)

    def _update(self, request: UpdateRequest) -> Update:
        """Refine for the views, build the surface and its bounds, and commit them as the last frame.

        Where leaves are so small and so far from the anchor that float32 cannot represent them, refine again with
        fewer bisections.
        """
        box = box_of(self.field, request.vertical_scale, request.vertical_offset)
        request.check()
        depth = self._max_depth(request.criterion)
        while True:
            result = self._update_to(depth, request, box)
            if isinstance(result, Update):
                return result
            depth = result

    def _update_to(self, depth: int, request: UpdateRequest, box: np.ndarray) -> Update | int:
        """Refine to leaves of at most `depth` bisections and return the update; a smaller depth if that is too deep.

        box: the terrain's bounding box, float64 [2, 3] metres.
        """
        criterion, morph_until = request.criterion, request.criterion.morph_until
        scaling = request.vertical_scale, request.vertical_offset
        shape = _Shape(criterion.meshlet, depth, *scaling, morph_until)
        domain = self._placed_domain(shape)
        # The largest errors of float32 corners along each axis, and of heights in all, metres. The triangles of a
        # leaf's meshlet are 2 * meshlet bisections deeper than the leaf.
        offsets = position_rounding(self.field, depth + 2 * criterion.meshlet, *scaling)
        plan = PlanUnits((domain.unit_x, domain.unit_y), domain.unit_bits, depth, offsets)
        spans = spans_of(criterion, request.views if criterion.needs_view else (), request.placement, plan)
        max_rounding = domain.rounding + domain.max_lean + domain.source

        def views_within(margins: Any = None) -> list:
            """Return the views in terrain space. margins: degrees around the frame with full detail, None: default."""
            seen = zip(spans.views, spans.scales, strict=True)
            return [
                localise(view, request.placement, box, criterion, scale, max_rounding, margins) for view, scale in seen
            ]

        local = views_within()
        if criterion.hides and self.field.valid is None:  # holes do not occlude, so rings need a raster without them
            place_rings(domain, local, criterion.hidden_factor, RAMP if morph_until > 1 else 0.0)
        packed = pack(criterion, local, spans, domain.source)
        with self.history.writing():
            leaves, relaxed, surface, changed = self._build_within_limit(criterion, shape, domain, packed)
            # only leaves beyond the plane limit may be too small for float32
            if 1 < depth > plane_limit(self.field.lattice) - 2 * criterion.meshlet:
                exact_depth = depth_in_plane(self.field.lattice, surface.positions, surface.corner_verts, surface.level)
                if exact_depth is not None:  # float32 cannot represent the corners of deeper triangles
                    return max(1, exact_depth - 2 * criterion.meshlet)
            horizon = None  # or arguments of `horizon_of`; the last: the mesh satisfies the criterion times this
            if local and (criterion.error_px or criterion.error_m) and self.field.valid is None:
                horizon = domain, packed, depth, relaxed * morph_until * (1 + MARGIN)
            outcome = Outcome(
                domain=domain,
                arrays=packed,
                relaxed=relaxed,
                stopped=leaves.stopped,
                max_depth=depth,
                tree=cast(ConcurrentBinaryTree, self.tree),
                squares=1 << self.field.lattice.square_bits,
                deepest=int(surface.level.max(initial=0)) - 2 * criterion.meshlet,
                relief=float(box[1, 2] - box[0, 2]) * (1 + MARGIN),
                buffers=self.history.scratch,
                in_frame=lambda: pack(criterion, views_within((0.0, 0.0)), spans, domain.source),
            )
            bounds = vars(bounds_of(criterion, spans, outcome))
            update = Update(surface=surface, leaves=leaves.total, changed=changed, **bounds)
            self.history.commit(request.key(), _Result(update, shape, horizon), keeps_vertices=not changed)
        return update

    def _build_within_limit(
        self, criterion: Criterion, shape: _Shape, domain: Domain, packed: CriterionArrays
    ) -> tuple[Leaves, float, Surface, bool]:
        """Refine and build the surface; again with fewer leaves while its cut at the border exceeds the triangle limit.

        Return the leaves, the factor by which the limit relaxed the criterion, the surface, and whether it differs from
        that of the last frame. packed: `criterion` and the views, as the kernels read them.
        """
        morph_until = shape.morph_until
        changed = self._has_other_shape(shape) or morph_until > 1  # points that morph move with the view
        max_leaves, limited = _max_leaves(criterion), criterion.max_triangles is not None
        while True:
            refinement = RefinementRequest(domain, packed, shape.depth, max_leaves, limited, morph_until)
            leaves, relaxed = refine(self.field, refinement, self.history, self.threads)
            # The same leaves displaced the same way are the same mesh.
            changed |= leaves.changed  # also of an earlier turn, whose leaves the tree holds now
            geomorph = Geomorph(packed, morph_until, relaxed) if morph_until > 1 else None
            surface = None  # the surface of an earlier turn would keep its memory in use
            surface = self._build(SurfaceRequest(domain, criterion.meshlet, geomorph, self._whole), changed)
            # The cut makes two of some triangles.
            excess = len(surface.level) - (criterion.max_triangles or 0) if limited else 0
            if excess <= 0 or leaves.total > max_leaves:  # more: root triangles remain, whatever the limit
                return leaves, relaxed, surface, changed
            max_leaves = leaves.total - 1  # the smallest step, so that a larger limit never gives a coarser mesh

    def _placed_domain(self, shape: _Shape) -> Domain:
        """Return the height field at this scale and offset, with float32's rounding at this depth; cached."""
        key = shape._replace(morph_until=1.0)  # the domain does not depend on it
        if self._placed is None or self._placed[0] != key:
            scaling = shape.vertical_scale, shape.vertical_offset
            rounded = rounding(self.field, shape.depth + 2 * shape.meshlet, *scaling)
            self._placed = key, refinable_domain(self.field, shape.meshlet, *scaling, rounded)
        return self._placed[1]

    def _max_depth(self, criterion: Criterion) -> int:
        """Return the maximum number of bisections of a leaf, 1 or more, without those of its meshlet."""
        depth = usual_depth(self.field)  # the field's default
        if criterion.max_depth is not None:
            depth = min(depth_limit(self.field), criterion.max_depth)  # limit: float32 cannot represent more
        return max(1, depth - 2 * criterion.meshlet)


def _max_leaves(criterion: Criterion) -> int:
    """Return the largest number of leaves whose triangles, 4**meshlet each, are within the criterion's limit."""
    triangles = MAX_TRIANGLES if criterion.max_triangles is None else min(MAX_TRIANGLES, criterion.max_triangles)
    return triangles >> (2 * criterion.meshlet)
