# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain: one height field and what keeps its mesh up to date with the views."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from ..kernels.refine.diamond import Asked, Domain, LocalView
from .ask.criterion import (
    LARGEST,
    Criterion,
    largest_offset,
    localise,
    secant_of,
    slant_of,
    unit_lengths,
    widening,
)
from .ask.view import View
from .errors import TerrainError
from .field.heightfield import HeightField
from .mesh.surface import Surface, SurfaceBuilder
from .refine.refinement import DEPTH_BELOW_CELLS, MAX_TRIANGLES, Refinement, depth_limit, make_domain
from .refine.terms import Terms, left_of, position_rounding, rounding
from .run import launch
from .run.buffers import Buffers

# Relative; above what rounding does to a sum of metres.
MARGIN = 1e-12
# Edges are asked for shorter by what float32 corners may add to them at the depth limit, but by no more than this part:
# where leaves get so small that it is more, the bound says so.
MOST_STRETCH = 0.01


@dataclass(frozen=True)
class Update:
    """What one update did. Bounds are None where nothing was asked of them.

    `bound_px`: no visible point of the reference surface is further than this from the mesh's point below it, in pixels
    (1e30: the mesh may reach the eye). `bound_m`: the same in metres of height, everywhere. Both include what float32
    positions are off and what the source had rounded: they hold for the heights that it was made of, too. `terms_px`
    and `terms_m` divide them.
    `bound_edge_px`, `bound_area_px`: longest edge, largest triangle, also of float32 corners. `relaxed`: the factor by
    which a triangle limit coarsened what was asked. `limited`: what kept a bound above what was asked: "",
    "max_triangles", "max_depth", or of what cannot be refined away the first that is too much on top of those before
    it: "resampling" (at import), "precision" (float32), "source" (its rounding). `changed`: False if the mesh is the
    one of the last update.
    """

    surface: Surface
    leaves: int
    changed: bool
    bound_px: float | None
    bound_m: float
    bound_edge_px: float | None
    bound_area_px: float | None
    relaxed: float
    limited: str
    terms_px: Terms | None
    terms_m: Terms
    ms: dict[str, float] = field(compare=False)

    @property
    def triangles(self) -> int:
        return len(self.surface.level)


class Terrain:
    """The adaptive mesh of one height field. Updates are pure: the same arguments give the same bytes."""

    def __init__(self, field: HeightField, threads: int | None = None):
        self.field = field
        self.threads = launch.default_threads() if threads is None else max(1, threads)
        self._buffers = Buffers()
        self._refinement = Refinement(field, self._buffers, self.threads)
        self._builder = SurfaceBuilder(field, self._buffers, self.threads)
        self._domain, self._domain_key = None, None
        self._asked_key = None
        self._shape_key = None
        self._last: Update | None = None
        self._stamp: object = None

    @property
    def tree(self):
        """The concurrent binary tree of the last update."""
        return self._refinement.tree

    @property
    def buffer_bytes(self) -> int:
        """Address space of the engine's arrays; the system commits what is touched of it."""
        return self._buffers.nbytes + (self.tree.nbytes if self.tree else 0)

    def update(
        self,
        criterion: Criterion,
        views: Sequence[View] = (),
        placement: np.ndarray | None = None,
        vertical_scale: float = 1.0,
        vertical_offset: float = 0.0,
    ) -> Update:
        """Refine, weld and displace for the views (their union), the terrain standing at `placement` (4 x 4, to world).

        Heights become `height * vertical_scale + vertical_offset` metres. Raises TerrainError and leaves the last mesh
        as it is if a number cannot be used.
        """
        placement = np.eye(4) if placement is None else np.array(placement, np.float64)
        key = (criterion, tuple(v.key() for v in views), placement.tobytes(), vertical_scale, vertical_offset)
        if key == self._asked_key and not self._edited():
            return Update(**{**self._last.__dict__, "changed": False, "ms": {}})
        with launch.stopwatch() as ms, launch.timed("total"):
            update = self._update(criterion, views, placement, float(vertical_scale), float(vertical_offset), ms)
        self._asked_key, self._last, self._stamp = key, update, self.tree.stamp
        return update

    def _edited(self) -> bool:
        """Whether the tree is another one than the last update left."""
        return self.tree is None or self.tree.stamp is not self._stamp

    def _update(self, criterion, views, placement, vertical_scale, vertical_offset, ms) -> Update:
        box = box_of(self.field, vertical_scale, vertical_offset)
        if placement.shape != (4, 4) or not np.isfinite(placement).all():
            raise TerrainError(
                "The terrain's matrix has a value that is not finite; check its location and its parents."
            )
        if not abs(np.linalg.det(placement[:3, :3])) > 0:
            raise TerrainError("The terrain is scaled to nothing in some direction; give it a scale other than 0.")
        if criterion.needs_view and not views:
            raise TerrainError("The criterion is measured in pixels and there is no camera; add one or ask in metres.")
        depth = self._max_depth(criterion)
        domain = self._placed_domain(criterion.meshlet, depth, vertical_scale, vertical_offset)
        shape = (criterion.meshlet, depth, vertical_scale, vertical_offset)
        views = views if criterion.needs_view else ()
        slants = [slant_of(v, placement) for v in views]
        widened = [widening(v, s, criterion) for v, s in zip(views, slants, strict=True)]
        scales = [w * s for w, s in zip(widened, slants, strict=True)]
        edge_scale, lengths, off, stretch = 1.0, (0.0, 0.0), 0.0, 1.0
        if views and (criterion.edge_px or criterion.area_px):
            # Spans of a pixel are those of heights, edges may lie across the view. One scale for the edges of all
            # views: they must not depend on what errors do to each.
            secants = [secant_of(v) for v in views]
            edge_scale = max(scale / secant for scale, secant in zip(scales, secants, strict=True))
            scales = [edge_scale * secant for secant in secants]
            widened = [scale / slant for scale, slant in zip(scales, slants, strict=True)]
            of_views = [unit_lengths(v, placement, (domain.unit_x, domain.unit_y)) for v in views]
            lengths = tuple(max(of_one) for of_one in zip(*of_views, strict=True))
            rounded = position_rounding(self.field, depth + 2 * criterion.meshlet, vertical_scale, vertical_offset)
            off = max(largest_offset(v, placement, rounded) for v in views)
            stretch = min(_stretch(lengths, domain.unit_bits, depth, off), 1 + MOST_STRETCH)
            edge_scale /= stretch
        unsure = domain.rounding + domain.source
        local = [localise(v, placement, box, criterion, s, unsure) for v, s in zip(views, scales, strict=True)]
        asked = _pack(criterion, local, edge_scale, domain.source)
        asked.diagonal2, asked.axis2 = lengths
        # From here on an update that is stopped leaves nothing that the next one may take for a mesh.
        self._asked_key, shape_key, self._shape_key = None, self._shape_key, None
        edited = self._edited()
        leaves, relaxed = self._refinement.run(
            domain, asked, depth, _max_leaves(criterion), criterion.max_triangles is not None
        )
        # The same leaves displaced the same way are the same mesh.
        changed = bool(leaves.changed_cells) or shape != shape_key or edited
        surface = self._last.surface if self._last else None
        if changed:
            surface = self._builder.build(leaves, domain, criterion.meshlet)
        self._shape_key = shape
        return Update(
            surface=surface,
            leaves=leaves.total,
            changed=changed,
            **_contract(criterion, domain, self.field, leaves.stopped, relaxed, bool(views)),
            relaxed=relaxed,
            ms=ms,
        )

    def _placed_domain(self, meshlet: int, depth: int, vertical_scale: float, vertical_offset: float) -> Domain:
        key = (meshlet, depth, vertical_scale, vertical_offset)
        if key != self._domain_key:
            rounded = rounding(self.field, depth + 2 * meshlet, vertical_scale, vertical_offset)
            self._domain = make_domain(self.field, meshlet, vertical_scale, vertical_offset, rounded)
            self._domain_key = key
        return self._domain

    def _max_depth(self, criterion: Criterion) -> int:
        """Deepest bisection of a leaf, its meshlet's own bisections taken off."""
        limit = depth_limit(self.field)
        depth = min(limit, self.field.lattice.cell_depth + DEPTH_BELOW_CELLS)
        if criterion.max_depth is not None:
            depth = min(limit, criterion.max_depth)
        return max(1, depth - 2 * criterion.meshlet)


def box_of(field: HeightField, vertical_scale: float, vertical_offset: float) -> np.ndarray:
    """float64 [2, 3]: the corners of everything that the terrain occupies in its own space, metres.

    Raises TerrainError where a mesh, which has float32 positions, cannot hold that.
    """
    _, _, x, y = field.lattice.rectangle()
    z = sorted(h * vertical_scale + vertical_offset for h in (field.min_height, field.max_height))
    box = np.array([[-x, -y, z[0]], [x, y, z[1]]])
    largest = float(np.finfo(np.float32).max)
    if not max(x, y) < largest:
        raise TerrainError(f"The terrain is {2 * x:g} x {2 * y:g} m, more than a mesh can hold; import it smaller.")
    if not np.abs(box).max() < largest:
        raise TerrainError(
            f"The vertical scale {vertical_scale} and offset {vertical_offset} give heights beyond what a mesh can "
            "hold (3e38 metres); make them smaller."
        )
    return box


def _max_leaves(criterion: Criterion) -> int:
    triangles = MAX_TRIANGLES if criterion.max_triangles is None else min(MAX_TRIANGLES, criterion.max_triangles)
    return triangles >> (2 * criterion.meshlet)


def _stretch(lengths: tuple[float, float], unit_bits: int, depth: int, off: float) -> float:
    """How many times longer than on the lattice the edges of leaves at `depth` or above may be, at most, where corners
    are `off` from their places. `lengths`: squared diagonal and side of a lattice unit, in the space of `off`."""
    diagonal2, axis2 = lengths
    side = 2.0 ** (unit_bits - (depth - 1) // 2)
    shortest = side * (math.sqrt(axis2) if depth % 2 else 0.5 * math.sqrt(diagonal2))
    return 1 + 2 * off / shortest


def _contract(criterion: Criterion, domain: Domain, field: HeightField, stopped: bool, relaxed: float, seen: bool):
    """What leaves that nothing stopped hold: what was asked, times what a triangle limit relaxed."""
    scale = domain.error_scale
    within = (field.max_height - field.min_height) * scale + domain.rounding + domain.source
    free = stopped or not criterion.error_m
    bound_m = within if free else min(within, _reached(criterion.error_m * relaxed, domain))
    bound_px = LARGEST if stopped or not criterion.error_px else criterion.error_px * relaxed
    edge_px = criterion.edge_px or math.sqrt(8 * criterion.area_px)
    area_px = criterion.area_px or 0.5 * criterion.edge_px**2
    rest = 0.0, 0.0, domain.rounding, domain.source
    parts = max(bound_m - sum(rest), 0.0), *rest[1:]
    return {
        "bound_px": bound_px if seen else None,
        "bound_m": bound_m,
        "bound_edge_px": (LARGEST if stopped else edge_px * relaxed) if edge_px else None,
        "bound_area_px": (LARGEST if stopped else area_px * relaxed**2) if edge_px else None,
        "limited": "max_triangles" if relaxed > 1 else "max_depth" if stopped else "",
        "terms_px": Terms.shares(bound_px, *parts) if seen else None,
        "terms_m": Terms.shares(bound_m, *parts),
    }


def _reached(asked: float, domain: Domain) -> float:
    """Metres of error that an error asked for in metres ends with, by how `metres2_of` weighs it."""
    rest = domain.rounding + domain.source
    return max(asked, 0.25 * asked + rest, 0.8 * asked + domain.source) * (1 + MARGIN)


def _pack(criterion: Criterion, views: list[LocalView], edge_scale: float, source: float) -> Asked:
    """What is asked, in spans of a pixel as the kernels measure them; an edge has `edge_scale` of them a pixel.

    `source`: metres that the source's own heights may be off. An error in metres is asked for as the kernels weigh it
    with that (`metres2_of`), so that all of it holds.
    """
    asked = Asked()

    def squared(value: float) -> float:
        return value**2 if value > 0 else math.inf

    asked.view_count = len(views)
    asked.measures_edges = int(criterion.edge_px > 0 or criterion.area_px > 0)
    asked.error_px2, asked.edge_px2 = squared(criterion.error_px), squared(criterion.edge_px * edge_scale)
    asked.area_px2 = 2 * squared(math.sqrt(criterion.area_px) * edge_scale)
    left = left_of(criterion.error_m, source)
    asked.metres2 = squared(min(left + source, 1.25 * left) * (1 - 2 * MARGIN))
    asked.limit = 1.0
    views = views or [LocalView()]
    asked.view, asked.views = views[0], wp.array(views, dtype=LocalView, device="cpu")
    return asked
