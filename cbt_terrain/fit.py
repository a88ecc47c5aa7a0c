# SPDX-License-Identifier: GPL-3.0-or-later
"""A static mesh whose vertices need not lie on the surface: fewer triangles for the same vertical error.

Between two points of a bend a chord that starts on the surface errs twice as much as one that is moved to the middle
of its error, so heights that are free allow a coarser mesh. The mesh of the walk for a larger error is a start. A few
sweeps move its vertices (kernels/fitting/sweep.py); triangles that are still too far are split where they stand out, by
raising their diamonds in a copy of the error hierarchy, and the walk makes the next mesh, which keeps the heights. A
triangle is split only if interpolation would split it too, else its vertices go back to the surface for good: at worst
the end is the interpolating mesh, and on the way a triangle count can only stay below its own. What decides, and what
is told, is each triangle's exact distance from the whole surface, of heights as they are delivered.

The bound is that of greedy insertion (Garland and Heckbert 1995), here on the triangles of longest-edge bisection.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from ..kernels.criterion import Asked, LocalView
from ..kernels.fitting import refine as refine_kernels
from ..kernels.fitting import sweep as kernels
from . import launch
from .buffers import Buffers, shared
from .criterion import Criterion
from .heightfield import HeightField
from .refinement import DEPTH_BELOW_CELLS, MAX_TRIANGLES, Refinement, depth_limit, make_domain
from .surface import Surface, SurfaceBuilder
from .terms import DISPLACEMENT_ERROR, Terms
from .terrain import Terrain, Update, box_of

# The first mesh is the interpolating one for this many times the error: less leaves triangles that could be merged,
# more has so many to split that neighbours of those that need it are split as well.
START = 1.75
SWEEPS = 4
# Length of a step over the mean push, and the part of the bound that vertices are pushed to keep.
STRETCH, AIM = 1.25, 0.95
# A triangle is split if its excess is this part of the largest that it touches; all are, once few are left or many
# rounds have gone.
LOCAL, FEW, MANY_ROUNDS = 0.75, 0.02, 16
MAX_ROUNDS = 64
# Part of the error that resampling at import may have taken: with less of it left, a fit saves nothing.
MOST_MOVED = 0.5
# Vertices in raster cells lie on parts of a cell of 2^-FINEST.
FINEST = DEPTH_BELOW_CELLS // 2 + 1
# Far more than float64 rounds off the sum of a few terms.
OUTWARD = 1.0 + 1e-12
# A budget coarsens what was asked in steps of 2^(1/8).
STEPS_PER_OCTAVE = 8

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Fitted(Update):
    """What a fit did, as `Update`.

    `worst_m`: the exact largest distance of the delivered heights from the surface, metres; `bound_m` is that with
    what resampling at import and rounding of plane coordinates add. `rounds`: meshes it took; 0 if the interpolating
    mesh was best.
    """

    worst_m: float = 0.0
    rounds: int = 0


def fit(
    field: HeightField,
    error_m: float,
    *,
    max_triangles: int | None = None,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    threads: int | None = None,
    on_progress: Progress = lambda _fraction: None,
) -> Fitted:
    """The mesh that is nowhere more than `error_m` metres of height off, with vertices moved to save triangles.

    Never more triangles than interpolation needs. With a limit of `max_triangles` the finest error that fits, in steps
    of 2^(1/8), if that is better than what interpolation reaches. Heights become `height * vertical_scale +
    vertical_offset` metres. The same bytes for any number of threads. `on_progress` may raise: that cancels.
    Raises TerrainError if a number cannot be used.
    """
    threads = launch.default_threads() if threads is None else max(1, threads)
    criterion = Criterion(error_px=0.0, error_m=error_m, max_triangles=max_triangles)
    error_m = criterion.error_m
    most = MAX_TRIANGLES if max_triangles is None else min(max_triangles, MAX_TRIANGLES)
    with launch.stopwatch() as ms, launch.timed("total"):
        fitter = _Fitter(field, vertical_scale, vertical_offset, threads, on_progress)
        best = fitter.run(error_m)
        # Interpolation allows for what resampling moved in each place, the fit for the most of it everywhere.
        unsure = best is None or best.beyond_plain or best.limited or fitter.moved_m > 0.0
        if unsure or best.triangles > most:
            plain = Terrain(field, threads).update(criterion, (), None, vertical_scale, vertical_offset)
            if best is not None and best.triangles > most:
                best = _within(fitter, error_m, most, plain)
            more = best is not None and plain.relaxed == 1.0 and best.triangles > plain.triangles
            if best is None or more or best.bound_m > max(plain.bound_m, error_m):
                best = fitter.interpolated(plain, error_m)
    on_progress(1.0)
    limited = "max_triangles" if best.relaxed > 1.0 else best.limited
    return Fitted(
        surface=best.surface,
        leaves=best.triangles,
        changed=True,
        bound_px=None,
        bound_m=best.bound_m,
        bound_edge_px=None,
        bound_area_px=None,
        relaxed=best.relaxed,
        limited=limited,
        terms_px=None,
        terms_m=best.terms,
        ms=ms,
        worst_m=best.worst_m,
        rounds=best.rounds,
    )


def _within(fitter: "_Fitter", error_m: float, most: int, plain: Update) -> "_Mesh | None":
    """The fit for the least step above `error_m` that has at most `most` triangles, as bisection finds it."""
    if not plain.bound_m > error_m:
        return None
    low, high = 0, math.ceil(STEPS_PER_OCTAVE * math.log2(plain.bound_m / error_m))
    found = None
    while high - low > 1:
        step = (low + high) // 2
        relaxed = 2.0 ** (step / STEPS_PER_OCTAVE)
        mesh = fitter.run(error_m * relaxed)
        if mesh is not None and mesh.triangles <= most:
            found, high = replace(mesh, relaxed=relaxed), step
        else:
            low = step
    return found


@dataclass(frozen=True)
class _Mesh:
    surface: Surface
    bound_m: float
    worst_m: float
    terms: Terms
    limited: str
    rounds: int
    beyond_plain: bool = False  # it was split where interpolation would not be
    relaxed: float = 1.0

    @property
    def triangles(self) -> int:
        return len(self.surface.level)


class _Fitter:
    """What fits of one height field at one vertical scale have in common."""

    def __init__(
        self, field: HeightField, vertical_scale: float, vertical_offset: float, threads: int, on_progress: Progress
    ):
        box_of(field, vertical_scale, vertical_offset)  # refuses numbers that cannot be used
        self.field, self.threads, self.on_progress = field, threads, on_progress
        self.placement = (float(vertical_scale), float(vertical_offset))
        self.scale = abs(self.placement[0])
        self.depth = max(1, min(depth_limit(field), field.lattice.cell_depth + DEPTH_BELOW_CELLS))
        self.plain = make_domain(field, 0, *self.placement)
        self.moved_m = field.resample_max * self.scale

    def run(self, error_m: float) -> _Mesh | None:
        """The fit for one error; None if it was given up after MAX_ROUNDS, or resampling leaves it too little."""
        if not self.scale or self.moved_m > error_m * MOST_MOVED:
            return None
        buffers, field = Buffers(), self.field
        refinement = Refinement(field, buffers, self.threads)
        builder = SurfaceBuilder(buffers, self.threads)
        own_m = error_m - self.moved_m
        f = self._fit(own_m - min(self._shift(own_m) + self._rounded(), own_m / 2))
        errors = field.error * np.float32(1.0 / START)
        domain = make_domain(replace(field, error=errors, moved=None, _expanded={}), 0, *self.placement)
        asked = _asked(own_m)
        known = self._nothing_known()
        stack, found = wp.zeros(1024, wp.vec3i, device="cpu"), wp.zeros(4, wp.int32, device="cpu")
        allowed, raised = wp.float64(own_m / self.scale), wp.float64(2.0 * own_m / self.scale)
        beyond_plain = False
        for rounds in range(1, MAX_ROUNDS + 1):
            self.on_progress(1.0 - 0.8**rounds)
            leaves, _ = refinement.run(domain, asked, self.depth, MAX_TRIANGLES)
            surface = builder.build(leaves, domain, 0)
            triangles, vertices = len(surface.level), len(surface.positions)
            _bind(f, surface, buffers)
            self._spread(kernels.gather, vertices, [f, *known])
            beyond = self._sweep(f, triangles, vertices, buffers)
            local = LOCAL if beyond > FEW * triangles and rounds < MANY_ROUNDS else 0.0
            inputs = [triangles, self.depth, allowed, raised, wp.float64(local), f, shared(errors, wp.float32)]
            launch.once(refine_kernels.refine, [*inputs, stack, found], step="fit refine")
            if not found.numpy()[:2].any():  # now what was not looked at in this round, too
                self._spread(kernels.pull, triangles, [-1, f], cost=5.0)
                launch.once(refine_kernels.refine, [*inputs, stack, found], step="fit refine")
            splits, pins, forced, deepest = found.numpy().tolist()
            beyond_plain |= forced > 0
            if not splits and not pins:
                worst, precision = self._worst(surface, buffers)
                bound, limited = self._bound(worst, precision, error_m)
                limited = "max_depth" if limited and deepest else limited
                return _Mesh(surface, bound, worst, self._terms(bound, worst, precision), limited, rounds, beyond_plain)
            self._spread(kernels.keep, vertices, [f, *known])
        return None

    def interpolated(self, update: Update, error_m: float) -> _Mesh:
        """The mesh of an update, measured as a fit is."""
        worst, precision, buffers = 0.0, 0.0, Buffers()
        if self.scale:
            f = self._fit(error_m)
            _bind(f, update.surface, buffers)
            self._spread(kernels.gather, len(update.surface.positions), [f, *self._nothing_known()])
            self._spread(kernels.pull, update.triangles, [-1, f], cost=5.0)
            worst, precision = self._worst(update.surface, buffers)
        bound, limited = self._bound(worst, precision, error_m)
        terms = self._terms(bound, worst, precision)
        if update.bound_m < bound:  # it allows for what resampling moved in each place
            bound, limited, terms = update.bound_m, update.limited, update.terms_m
        return _Mesh(update.surface, bound, worst, terms, update.limited or limited, 0, relaxed=update.relaxed)

    def _fit(self, bound_m: float) -> kernels.Fit:
        f = kernels.Fit()
        f.domain, f.snap = self.plain, max(0, self.plain.unit_bits - self.plain.levels - FINEST)
        f.bound, f.aim, f.stretch = bound_m, AIM * bound_m, STRETCH
        return f

    def _nothing_known(self) -> list[wp.array]:
        """Of every sample the height of its vertex and what is known of it; memory is committed where it is used."""
        samples = self.field.samples.size
        return [
            shared(np.zeros(samples, np.float32), wp.float32),
            shared(np.zeros(samples, np.uint8), wp.uint8),
        ]

    def _worst(self, surface: Surface, buffers: Buffers) -> tuple[float, float]:
        """Largest distance that was found, and what rounding adds to it at most, metres.

        A plane coordinate that is rounded moves a facet sideways, and no facet is steeper than the surface but for
        twice the distance of its corners over the shortest way between them.
        """
        lattice, worst = self.field.lattice, buffers.numpy("fit_worst")[: len(surface.level)]
        of_level = np.zeros(int(surface.level.max()) + 1)
        np.maximum.at(of_level, surface.level, worst)
        steeper = 2.0 * of_level / 2.0 ** (lattice.levels - np.arange(len(of_level)) // 2)  # metres a cell
        return float(worst.max()), self._sideways(float(steeper.max())) + self._rounded()

    def _rounded(self) -> float:
        """Metres by which a distance may be off that is computed in float64."""
        highest = max(abs(self.field.min_height), abs(self.field.max_height))
        return DISPLACEMENT_ERROR * (highest * self.scale + abs(self.placement[1]))

    def _bound(self, worst_m: float, shift_m: float, error_m: float) -> tuple[float, str]:
        """All that adds to the largest distance, and what of it passes the error asked for.

        It is rounded outward, but not over what holds already.
        """
        total = worst_m + shift_m + self.moved_m
        if total <= error_m:
            return min(total * OUTWARD, error_m), ""
        return total * OUTWARD, "resampling" if worst_m + shift_m <= error_m else "precision"

    def _terms(self, bound_m: float, worst_m: float, shift_m: float) -> Terms:
        return Terms.shares(bound_m, worst_m, self.moved_m, shift_m)

    def _sweep(self, f: kernels.Fit, triangles: int, vertices: int, buffers: Buffers) -> int:
        """Move the vertices; returns how many triangles were beyond the bound before the last move."""
        beyond = buffers.get("fit_beyond", 1, wp.int32)
        for sweep in range(1, SWEEPS + 1):
            self._spread(kernels.pull, triangles, [sweep, f], cost=5.0)
            launch.once(kernels.move, [sweep, triangles, vertices, f, beyond], step="fit move")
            if not buffers.numpy("fit_beyond")[0]:
                break
        self._spread(kernels.pull, triangles, [sweep + 1, f], cost=5.0)
        return int(buffers.numpy("fit_beyond")[0])

    def _spread(self, kernel, count: int, inputs: list, cost: float = 1.0) -> None:
        launch.spread(kernel, count, inputs, step=f"fit {kernel.key}", threads=self.threads, cost=cost)

    def _shift(self, error_m: float) -> float:
        """Metres of height that rounding the plane coordinates to float32 may add, vertices moved by `error_m`."""
        lattice = self.field.lattice
        # Of what is split in raster cells only the corners of the cells are moved.
        twist = float(self.field.error[lattice.range_count :].max()) * self.scale
        finer = 2.0 ** math.ceil(0.5 * math.log2(twist / error_m) + 1) if error_m and twist > error_m else 1.0
        return self._sideways(2.0 * error_m * finer)

    def _sideways(self, steeper: float) -> float:
        """The same for facets that are `steeper` metres a cell steeper than the surface."""
        lattice, shift = self.field.lattice, 0.0
        axes = (
            (lattice.width, lattice.step_x, self.field.steepest_x),
            (lattice.height, lattice.step_y, self.field.steepest_y),
        )
        for samples, step, slope in axes:
            places = (np.arange(((samples - 1) << FINEST) + 1) * 0.5**FINEST - 0.5 * (samples - 1)) * step
            off = float(np.abs(places.astype(np.float32) - places).max())
            shift += off * (slope * self.scale + steeper / step)
        return shift


def _asked(error_m: float) -> Asked:
    """Nothing but a vertical error."""
    asked = Asked()
    asked.error_px2 = asked.edge_px2 = asked.area_px2 = math.inf
    asked.metres2, asked.limit = error_m**2, 1.0
    asked.view, asked.views = LocalView(), wp.array([LocalView()], dtype=LocalView, device="cpu")
    return asked


def _bind(f: kernels.Fit, surface: Surface, buffers: Buffers) -> None:
    """The mesh whose vertices are moved in place."""
    triangles, vertices = len(surface.level), len(surface.positions)
    f.corner_verts = shared(surface.corner_verts, wp.int32)
    f.level = shared(surface.level, wp.int32)
    f.positions = shared(surface.positions, wp.vec3f)
    f.point = buffers.get("fit_point", vertices, wp.vec2i)
    f.state = buffers.get("fit_state", vertices, wp.uint8)
    f.moved = buffers.get("fit_moved", vertices, wp.int32)
    f.push = buffers.get("fit_push", 2 * vertices, wp.float64)
    f.worst = buffers.get("fit_worst", triangles, wp.float64)
    f.pushes = buffers.get("fit_pushes", 3 * triangles, wp.vec2f)
