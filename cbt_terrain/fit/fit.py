# SPDX-License-Identifier: GPL-3.0-or-later
"""A static mesh: one error in metres everywhere, no camera, as `adaptive-terrain bake` makes it.

With `fit` its vertices may leave the surface: fewer triangles for the same vertical error. The bound is that of greedy
insertion (Garland and Heckbert 1995), here on the triangles of longest-edge bisection; fitter.py fits the heights.
Finer tiles count as a displacement: the raster's surface is fitted, and vertices get the change at their position. The
alternative to a fit, here called interpolation, is a mesh whose vertices are all on the surface.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from ..errors import TerrainError, check_function
from ..field.heightfield import HeightField, check_field
from ..plain_numbers import plain_number, vertical
from ..refine.refinement import MAX_TRIANGLES
from ..run import launch
from ..terrain import Terrain, Update
from ..view.criterion import Criterion
from .fitter import FittedMesh, Fitter

# A budget coarsens the requested error in steps of 2^(1/8).
STEPS_PER_OCTAVE = 8
# A fit always needs more triangles than interpolation for this many times the error: moving a chord halves its error
# at most.
MAX_GAIN = 2.6


@dataclass(frozen=True, repr=False)
class Fitted(Update):
    """The result of a fit, as `Update`.

    `worst_m`: the exact largest distance of the delivered heights from the surface, metres; with finer tiles a bound of
    it, because the stored error of their change counts. `bound_m` includes the rounding of plane coordinates and of the
    source. `rounds`: meshes it took; 0 if the interpolating mesh was best.
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
    on_progress: Callable[[float], None] = lambda _fraction: None,
) -> Fitted:
    """Return the mesh that is nowhere more than `error_m` metres of height off, with vertices moved to save triangles.

    It never has more triangles than interpolation needs. If `max_triangles` are too few for the error, the finest error
    for which they suffice is taken, in steps of a factor 2^(1/8). Heights become `height * vertical_scale +
    vertical_offset` metres. The bytes are the same for any number of threads. `on_progress` gets the finished fraction,
    and may raise, which cancels. If the error could not be kept, the result's `limited` has the reason, else "". Raises
    TerrainError if a number cannot be used, and for bicubic surfaces, a detail or holes.
    """
    check_field(field)
    check_function(on_progress, "on_progress")
    check_interpolation(field.interpolation)
    if field.valid is not None:  # it would fit what fills them
        raise TerrainError(
            "A terrain with holes cannot be fitted",
            expected="one whose no-data is filled",
            fix="bake it without Fit (--fit), or import it without Cut Out No-Data (--holes)",
        )
    if field.detail:
        raise TerrainError(
            "A surface with detail cannot be fitted",
            expected="none",
            fix="set the amplitude of the terrain's detail to 0",
        )
    threads = launch.checked_threads(threads)
    criterion = Criterion(error_px=0.0, error_m=error_m, max_triangles=max_triangles)
    error_m, max_triangles = criterion.error_m, criterion.max_triangles
    vertical_scale, vertical_offset = vertical(vertical_scale, vertical_offset)
    triangle_limit = MAX_TRIANGLES if max_triangles is None else min(max_triangles, MAX_TRIANGLES)
    with launch.stopwatch() as ms, launch.timed("total"):
        fitter = Fitter(field, vertical_scale, vertical_offset, threads, on_progress)
        heights: dict[str, Any] = {"vertical_scale": vertical_scale, "vertical_offset": vertical_offset}
        # Make the interpolating mesh, of whole leaves: triangles that are not cut at the raster's border yet.
        whole = Terrain(field, threads, whole=True)
        if max_triangles is None:
            plain = whole.update(criterion, **heights)
        else:  # the limit is for delivered triangles: find how many whole leaves keep it after the cut at the border
            delivered = Terrain(field, threads).update(criterion, **heights)
            plain = whole.update(replace(criterion, max_triangles=delivered.leaves), **heights)
            plain = replace(plain, relaxed=delivered.relaxed)
        assert plain.bound_m is not None  # the criterion has an error in metres
        # Fit a mesh, and keep it only if it is better than the interpolating one.
        best = None
        if plain.relaxed > 1.0:  # the limit of triangles has coarsened the error
            best = _fit_within(fitter, error_m, plain.relaxed, triangle_limit, plain.bound_m)
        elif plain.limited != "max_depth":  # else the deepest leaves are too coarse, which a fit cannot split either
            best = fitter.run(error_m)
        max_cut = None if max_triangles is None else triangle_limit
        if best is None or not _is_better(best, plain, fitter, error_m, max_cut):
            best = fitter.measure_interpolating(plain, error_m)
        surface = fitter.end_at_borders(best)
    on_progress(1.0)
    limited = "max_triangles" if best.relaxed > 1.0 else best.limited
    return Fitted(
        surface=surface,
        leaves=best.triangles,
        changed=True,
        ms=ms,
        bound_m=best.bound_m,
        relaxed=best.relaxed,
        limited=limited,
        terms_m=best.terms,
        worst_m=best.worst_m,
        rounds=best.rounds,
    )


def bake(
    field: HeightField,
    error_m: float,
    *,
    fitted: bool = False,
    max_triangles: int | None = None,
    meshlet: int = 0,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    threads: int | None = None,
    on_progress: Callable[[float], None] = lambda _fraction: None,
) -> Update:
    """Return the mesh that is nowhere more than `error_m` metres of height from a height field.

    `open_store` gives the height field. `meshlet`: each leaf becomes 4**meshlet triangles.

    `fitted`: vertices leave the surface within that error, so that fewer triangles suffice (the result is a `Fitted`,
    without meshlets); `on_progress` gets the finished fraction, 0 .. 1, and may raise, which cancels. If
    `max_triangles` are too few for the error, it is increased until they suffice. Heights become `height *
    vertical_scale + vertical_offset` metres. Raises TerrainError if a number cannot be used, and for a fit as `fit`.
    """
    heights: dict[str, Any] = {"vertical_scale": vertical_scale, "vertical_offset": vertical_offset}
    if plain_number(fitted, bool, "The argument fitted"):
        limits: dict[str, Any] = {"max_triangles": max_triangles, "threads": threads, "on_progress": on_progress}
        return fit(field, error_m, **limits, **heights)
    criterion = Criterion(error_px=0.0, error_m=error_m, max_triangles=max_triangles, meshlet=meshlet)
    return Terrain(field, threads).update(criterion, **heights)


def check_interpolation(name: str) -> None:
    """Raise TerrainError unless a surface with this interpolation can be fitted. Call it before the surface is made."""
    if name != "bilinear":
        raise TerrainError(
            f"A {name} surface cannot be fitted", expected="a bilinear one", fix="choose bilinear interpolation"
        )


def _is_better(best: FittedMesh, plain: Update, fitter: Fitter, error_m: float, max_cut: int | None) -> bool:
    """Return whether the fit `best` is used instead of the interpolating mesh `plain`.

    fitter: that of the fit. error_m: the requested error, metres. max_cut: limit of triangles after the cut at borders,
    None for no limit.
    """
    assert plain.bound_m is not None  # the criterion has an error in metres
    if plain.relaxed == 1.0 and (best.triangles, best.bound_m) > (plain.triangles, plain.bound_m):
        # Without a relaxed error: more triangles than interpolation, or as many for a larger bound.
        return False
    if max_cut is not None and len(fitter.end_at_borders(best).triangles) > max_cut:
        return False
    # `within`: the requested error, or more if the source's rounding requires it.
    return best.bound_m <= max(plain.bound_m, fitter.within(error_m))


def _fit_within(
    fitter: Fitter, error_m: float, relaxed: float, triangle_limit: int, plain_m: float
) -> FittedMesh | None:
    """Return the fit for the smallest error, `error_m` times a power of 2^(1/8), that is within the triangle limit.

    Bisection finds it. The limit counts triangles after the cut at borders. None if no such error is below `plain_m`.

    triangle_limit: the limit. relaxed, plain_m: factor by which interpolation had to coarsen the error for it, and the
    bound that it reached, metres.
    """
    if not plain_m > error_m:
        return None
    # Step n is the error error_m * 2^(n / STEPS_PER_OCTAVE). Steps up to `low` have too many triangles: interpolation
    # needs error_m * relaxed, and a fit reaches at best 1 / MAX_GAIN of that. Steps from `high` on are no better than
    # interpolation, or than `best`.
    low = max(-1, math.floor(STEPS_PER_OCTAVE * math.log2(relaxed / MAX_GAIN)))
    high = math.ceil(STEPS_PER_OCTAVE * math.log2(plain_m / error_m))
    best = None
    while high - low > 1:
        step = (low + high) // 2
        factor = 2.0 ** (step / STEPS_PER_OCTAVE)
        mesh = fitter.run(error_m * factor)
        if mesh is not None and len(fitter.end_at_borders(mesh).triangles) <= triangle_limit:
            best, high = replace(mesh, relaxed=factor), step
        else:
            low = step
    return best
