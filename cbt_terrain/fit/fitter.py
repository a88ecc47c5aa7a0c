# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights fitted to a bound.

Over a curved stretch a chord that starts on the surface errs twice as much as one that is moved to the middle of its
error, so heights that are free allow a coarser mesh. The mesh of the walk for a larger error is a start. A few sweeps
move its vertices (kernels/fitting/moving.py); triangles that are still too far are split in place where they stand out
(kernels/fitting/mesh.py), and so on until none is. Each split is raised in a copy of the error hierarchy, so that the
walk makes that mesh, in its order, and the mesh keeps its heights.

A triangle is split only if interpolation would split it too, else its vertices return to the surface for good: at worst
the end is the interpolating mesh, and on the way the triangle count never exceeds that mesh's. Decisions and the bound
use each triangle's exact distance from the whole surface, of heights as they are delivered, and the rounding of the
source.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ...kernels.fitting import binding
from ...kernels.fitting import mesh as mesh_kernels
from ...kernels.fitting import moving as kernels
from ...kernels.refine.local_view import LocalView
from ...kernels.refine.pixels import CriterionArrays, unlimited
from ..field.depths import DEPTH_BELOW_CELLS, usual_depth
from ..field.domain import box_of
from ..field.heightfield import HeightField
from ..field.shared_pages import stored_from
from ..history.frame_history import FrameHistory
from ..mesh import borders
from ..mesh.builder import SurfaceRequest, build_surface
from ..mesh.surface import Surface
from ..refine.refinement import MAX_TRIANGLES, refine
from ..refine.request import RefinementRequest, refinable_domain
from ..refine.terms import (
    DISPLACEMENT_ERROR,
    SINGLE_BITS,
    Rounding,
    Terms,
    error_without_source,
    position_rounding,
    rounding,
)
from ..run import launch
from ..run.buffers import Buffers, shared
from ..terrain import Update
from ..view.linear import add_up
from . import fit_codes
from .sweeps import FEW, Sweeps

MAX_MESHES = 16
# Nanoseconds that a sweep takes for a triangle, and for a sample of it.
TRIANGLE_NS, SAMPLE_NS = 80.0, 1.2
# Vertices in raster cells are multiples of 2^-FINEST of a cell.
FINEST = DEPTH_BELOW_CELLS // 2 + 1
# Far more than float64 rounds off the sum of a few terms.
OUTWARD = 1.0 + 1e-12


@dataclass(frozen=True)
class FittedMesh:
    """A mesh that `Fitter` made, with its bound."""

    surface: Surface  # of whole leaves, see `Fitter.end_at_borders`
    bound_m: float
    worst_m: float  # largest measured distance, with the error of finer tiles' change; 0 if none was measured
    terms: Terms  # of the bound
    limited: str  # why the bound exceeds the requested error, "" if it does not
    rounds: int  # meshes that the fit walked, 0 for an interpolating mesh
    relaxed: float = 1.0  # factor by which a triangle limit coarsened it

    @property
    def triangles(self) -> int:
        """Return the number of triangles of the surface, of whole leaves."""
        return len(self.surface.triangles)


class Fitter:
    """The parts that fits of one height field at one vertical scale share.

    `placement`: vertical scale and offset. `scale`: the vertical scale's magnitude. `source`: largest rounding of the
    source, metres after scaling. `depth`: deepest level of leaves. `plain`: domain of the field with its own errors.
    `finer`: its finer tiles or None. `finest`: vertices are multiples of 2^-finest of a cell. `raised`: codes of errors
    that splits raise. `rounds`: finished rounds, for the progress.
    """

    def __init__(
        self,
        field: HeightField,
        vertical_scale: float,
        vertical_offset: float,
        threads: int,
        on_progress: Callable[[float], None],
    ):
        """Prepare fits of a height field at one vertical scale and offset (metres).

        `on_progress` gets the finished fraction and may raise. Raises TerrainError for a scale or offset that is
        unusable.
        """
        box_of(field, vertical_scale, vertical_offset)  # refuses numbers that cannot be used
        # The kernels of the fit read rows of floats.
        field = field.with_raster(samples=field.heights(), steps=None)
        self.field, self.threads, self.on_progress = field, threads, on_progress
        self.rounds = 0
        self.placement = (float(vertical_scale), float(vertical_offset))
        self.scale = abs(self.placement[0])
        self.source = field.source_max * self.scale
        self.depth = max(1, usual_depth(field))
        self.finer = field.raster.finer
        self.finest = FINEST + (self.finer.bits if self.finer else 0)
        # Triangles at this depth are not split, so `raise_cells` gets at most a halving for two levels below cells.
        self.raised = fit_codes.raised_codes(self.finer, max(0, self.depth - field.lattice.cell_depth) // 2)
        # 0: without meshlets.
        self.plain = refinable_domain(field, 0, *self.placement, rounding(field, self.depth, *self.placement))

    def run(self, error_m: float) -> FittedMesh | None:
        """Fit a mesh to one error in metres.

        Returns None if MAX_MESHES did not reach it, or for a vertical scale of 0.
        """
        if not self.scale:
            return None
        field, buffers = self.field, Buffers()
        history = FrameHistory()
        # The walk splits by `error`, a copy of the stored errors as codes (table: metres of each), which splits raise.
        error, table = self._codes(error_m)
        domain = refinable_domain(replace(field, error=error), 0, *self.placement, Rounding())
        domain.table = shared(table, wp.float32)
        domain.is_raised = 1  # errors may exceed the surface's on purpose, to split where the fit needs it
        # m: the mesh for kernels; known: fitted heights and states of vertices, which are kept from mesh to mesh
        m, known = self._mesh(error_m), self._nothing_known()
        criterion = _vertical_criterion(error_m)
        if self.finer is not None:
            # The fit cannot split in finer tiles, so the walk splits all that is beyond the bound. That excludes the
            # source's rounding already.
            criterion, domain.source = _vertical_criterion(m.bound), 0.0
            domain.enough = min(self.plain.enough, m.bound)  # smaller errors are not split
        m.codes, sweeps = shared(error, wp.uint8), Sweeps(self, m, buffers)
        for rounds in range(1, MAX_MESHES + 1):
            # Walk the raised errors to a mesh, whose vertices get their fitted heights of earlier meshes.
            refine(field, RefinementRequest(domain, criterion, self.depth, MAX_TRIANGLES), history, self.threads)
            surface = build_surface(field, SurfaceRequest(domain, whole=True), history, self.threads)
            history.commit()
            sweeps.bind(surface, known)
            if rounds > 1:  # the mesh is done if no triangle is beyond the bound
                self._measure(m, surface)
                beyond = sweeps.beyond()
                if not beyond.any():
                    return self._bounded_mesh(surface, buffers, error_m, rounds)
            sweeps.link(surface)
            # The sweeps measure all of the first mesh, and of a later one the triangles beyond the bound if they are
            # many.
            if rounds > 1 and beyond.sum() > FEW * sweeps.triangles:
                sweeps.mark_unmeasured(beyond)
            elif rounds > 1:  # a few: split them or pin their vertices to the surface; else this mesh is the best
                counts = sweeps.refine(0.0)
                if not counts["splits"] and not counts["pins"]:
                    return self._bounded_mesh(surface, buffers, error_m, rounds, counts["deepest"] > 0)
            sweeps.sweep_and_split()
            self.spread(binding.store_heights, sweeps.vertices, [m, *known])
        return None

    def end_at_borders(self, mesh: FittedMesh) -> Surface:
        """Return the surface as it is delivered: cut at the raster's border."""
        return borders.cut_ends(mesh.surface, self.field, self.plain, threads=self.threads)[0]

    def measure_interpolating(self, update: Update, error_m: float) -> FittedMesh:
        """Return the interpolating mesh of an update, with its bound measured as for fitted meshes.

        Both the measured bound and the update's hold, and the smaller one is returned. error_m: requested error
        in metres.
        """
        assert update.bound_m is not None and update.terms_m is not None  # its criterion has an error in metres
        if not self.scale:  # flat, so there is nothing to measure
            return FittedMesh(
                update.surface,
                update.bound_m,
                worst_m=0.0,
                terms=update.terms_m,
                limited=update.limited,
                rounds=0,
                relaxed=update.relaxed,
            )
        buffers, m = Buffers(), self._mesh(error_m)
        Sweeps(self, m, buffers).bind(update.surface, self._nothing_known())
        self._measure(m, update.surface)
        mesh = self._bounded_mesh(update.surface, buffers, error_m, rounds=0)
        if update.bound_m < mesh.bound_m:
            mesh = replace(mesh, bound_m=update.bound_m, limited=update.limited, terms=update.terms_m)
        # The update's reason is kept, whichever bound is smaller.
        return replace(mesh, limited=update.limited or mesh.limited, relaxed=update.relaxed)

    def within(self, error_m: float) -> float:
        """Return the largest bound of a mesh that holds an error as far as the source's rounding allows."""
        return max(error_m, error_without_source(error_m, self.source) + self.source)

    def _mesh(self, error_m: float) -> mesh_kernels.FitMesh:
        """Return an empty mesh for the kernels, with its error and its bound in metres.

        The bound, which measured distances must not exceed, is the error without the rounding that is added to them.
        The mesh's rounding takes at most half of the error that remains beside the source's.
        """
        m = mesh_kernels.FitMesh()
        # Vertices are multiples of 2^snap units, 2^-finest of a cell, whose side is 2^(unit_bits - levels) units.
        m.domain, m.snap = self.plain, max(0, self.plain.unit_bits - self.plain.levels - self.finest)
        remaining = error_without_source(error_m, self.source)
        rounded = self._expected_plane_error(error_m) + self._computing_error(error_m)
        m.error, m.bound, m.raised = error_m, remaining - min(rounded, remaining / 2), self.raised
        return m

    def _codes(self, error_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the codes of the diamonds' errors for the first mesh, uint8, and the errors of these codes, metres.

        The latter are float32, 256 for each group of depths. Splits raise codes later (fit_codes.py).
        """
        return fit_codes.make_codes(self.field, self.plain, self.raised, error_m / self.scale, self.threads)

    def _nothing_known(self) -> list[wp.array]:
        """Return empty heights and states of vertices, for every sample and its continuation into the padding.

        The system gives zeros memory only where they are written, so few vertices take little.
        """
        across, up = self.field.lattice.span  # cells of the lattice with the padding
        vertices = (across + 1) * (up + 1)
        return [shared(np.zeros(vertices, np.float32), wp.float32), shared(np.zeros(vertices, np.uint8), wp.uint8)]

    def _measure(self, m: mesh_kernels.FitMesh, surface: Surface) -> None:
        """Compute the largest distance of each triangle of `m`, metres, into its array `worst` ("fit_worst").

        surface: the mesh that `Sweeps.bind` has given to `m`.
        """
        triangles = len(surface.triangles)
        # A cost of 1 is about 15 ns.
        self.spread(kernels.measure, triangles, [m], cost=self.ns_each(triangles) / 15.0)

    def _bounded_mesh(
        self, surface: Surface, buffers: Buffers, error_m: float, rounds: int, deepest: bool = False
    ) -> FittedMesh:
        """Return a mesh with its bound: the largest measured distance plus the rounding of the mesh and of the source.

        buffers: have the measured distances ("fit_worst"). rounds: number of meshes that the fit walked. deepest:
        whether a triangle is too coarse at the deepest level. Rounding a plane coordinate moves a facet sideways, which
        changes heights by its slope. A facet may be steeper than the surface: two corners that are off by the largest
        distance in opposite directions, over the shortest edge at its level. The bound is rounded up, but not beyond
        `within(error_m)` if the sum is within it: the requested error, or more if the source's rounding requires that.
        The mesh's `limited` has the reason for a bound above the request.
        """
        lattice, triangles = self.field.lattice, len(surface.triangles)
        worst = buffers.numpy("fit_worst")[:triangles]
        worst_of_level = np.zeros(int(surface.level.max()) + 1)
        np.maximum.at(worst_of_level, surface.level, worst)
        # By level, metres a cell; edges are 2^levels cells at level 0, and half as long after two levels.
        steeper = 2.0 * worst_of_level / 2.0 ** (lattice.levels - np.arange(len(worst_of_level)) // 2)
        far = float(worst.max())
        divided = 2.0 ** max(0, len(worst_of_level) // 2 - lattice.levels)  # shortest edges along a cell, at least 1
        precision = self._plane_rounding_error(float(steeper.max()), divided) + self._computing_error(far)
        terms_m = far, precision, self.source
        total = add_up(terms_m)
        bound, limited = total * OUTWARD, ""
        if total <= self.within(error_m):
            bound = min(bound, self.within(error_m))
            limited = "source" if bound > error_m else ""
        else:
            limited = "max_depth" if deepest else "precision"
        terms = Terms.shares(bound, *terms_m)  # scaled so that their sum is the bound
        return FittedMesh(surface, bound, terms_m[0], terms, limited, rounds)

    def _computing_error(self, far: float) -> float:
        """Return the metres by which a distance computed in float64 may be off.

        Where a border is cut afterwards, its new vertices are rounded to float32 besides, on a mesh that is
        `far` metres off the surface. With finer tiles, heights are rounded to float32 four times: those of the raster
        where a tile holds them, at both ends of an edge, and those of vertices before and after the change is added.
        """
        highest = max(abs(h) for h in (self.field.min_height, self.field.max_height))
        reach = highest * self.scale + abs(self.placement[1])  # largest magnitude of a scaled height, metres
        cut = 2.0**-SINGLE_BITS * (reach + far) if self.field.lattice.is_padded else 0.0
        finer = 4.0 * 2.0**-SINGLE_BITS * (reach + far) if self.finer is not None else 0.0
        return DISPLACEMENT_ERROR * reach + cut + finer

    def _expected_plane_error(self, error_m: float) -> float:
        """Return the metres of error that rounded plane coordinates may add to a mesh that is yet to be fitted.

        A fit moves vertices by up to `error_m`, metres, which makes facets steeper.
        """
        lattice = self.field.lattice
        # A fit moves no vertex inside a raster cell. twist: largest error of cells before they are divided, metres.
        codes = stored_from(self.field.error, lattice.cell_base)
        twist = float(self.field.table[lattice.groups][codes.max()]) * self.scale
        # Triangles per side of a cell: each halving of the side leaves a quarter of the twist's error, so about
        # log4(twist / error_m) halvings reach the request; 1 to spare.
        divided = 2.0 ** math.ceil(0.5 * math.log2(twist / error_m) + 1) if error_m and twist > error_m else 1.0
        if self.finer is not None:
            divided = max(divided, 2.0 ** (self.finer.bits + 1))
        # Two corners may move in opposite directions, at least a cell's side / `divided` apart.
        return self._plane_rounding_error(2.0 * error_m * divided, divided)

    def _plane_rounding_error(self, steeper: float, divided: float) -> float:
        """Return the metres of error that rounding plane coordinates to float32 adds.

        Coordinates count from the anchor, the point of the raster that is the mesh's origin. A facet whose corners were
        rounded away from the raster's border is extended to it. Its slope grows by the factor 1 + 2 * rounding /
        length; 4 instead of 2 covers second-order terms.

        steeper: by how many metres a cell facets may be steeper than the surface. divided: a cell is this number of
        times as long as the shortest facet, 1 at least.
        """
        lattice, error = self.field.lattice, 0.0
        times = 2.0 if lattice.is_padded else 1.0  # vertices cut at the border are rounded twice
        axes = (
            (lattice.cells_x, lattice.span[0], lattice.step_x, lattice.anchor_x, self.field.steepest_x),
            (lattice.cells_y, lattice.span[1], lattice.step_y, lattice.anchor_y, self.field.steepest_y),
        )
        # A bound for all lattice points. Without finer tiles the possible positions are few enough to round each.
        largest = position_rounding(self.field, self.depth, *self.placement)
        for axis, (cells, span, step, anchor, slope) in enumerate(axes):
            offset = largest[axis]  # the largest rounding of a vertex at any depth, metres
            if self.finer is None:  # vertices are multiples of 2^-FINEST of a cell: take their largest rounding
                positions = (np.arange((span << FINEST) + 1) * 0.5**FINEST - 0.5 * cells) * step - anchor
                offset = float(np.abs(positions.astype(np.float32) - positions).max())
            offset *= times
            error += offset * (slope * self.scale + steeper / step) * (1.0 + 4.0 * offset * divided / step)
        return error

    def ns_each(self, triangles: int) -> float:
        """Return the nanoseconds that measuring one of `triangles` takes, by which work is divided over threads."""
        return TRIANGLE_NS + SAMPLE_NS * self.field.samples.size / triangles

    def tell_progress(self) -> None:
        """Report progress: the number of rounds is unknown, so that each is a fifth of the rest."""
        self.rounds += 1
        self.on_progress(1.0 - 0.8**self.rounds)

    def spread(self, kernel: wp.Kernel, count: int, inputs: list, cost: float = 1.0) -> None:
        """Launch a kernel over `count` items as a step of the fit. cost: of an item, see `launch.spread`."""
        launch.spread(kernel, count, inputs, step=f"fit {kernel.key}", threads=self.threads, cost=cost)


def _vertical_criterion(error_m: float) -> CriterionArrays:
    """Return a criterion with a vertical error alone, in metres; its one view is empty, since kernels expect one."""
    criterion = unlimited()
    criterion.metres2 = error_m * error_m
    criterion.view, criterion.views = LocalView(), wp.array([LocalView()], dtype=LocalView, device="cpu")
    return criterion
