# SPDX-License-Identifier: GPL-3.0-or-later
"""The cost of accuracy: one terrain refined with one setting after the other, with bounds, errors and times."""

import dataclasses
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from operator import itemgetter
from typing import Any

from ..attributes.evaluate import EffectRequest, evaluate
from ..attributes.plan import AttributePlan
from ..field.bicubic import interpolated
from ..field.heightfield import HeightField
from ..fit.fit import fit
from ..mesh.attributes import Attribute
from ..mesh.surface import Surface
from ..refine.terms import Terms
from ..terrain import Terrain
from ..view.criterion import Criterion
from ..view.view import View
from . import Errors, Measurement, Sight, look, measure, popping, shading_change
from .cost_curve import CostCurve
from .mesh import Progress
from .sweep_settings import Setting
from .timed_runs import FRAME_RUNS, RUNS, TimedFrame, fastest_run, median_by_step, ms_to_finished_mesh, timed_runs

# Returns what is visible of a height field in a view of a frame.
LookUp = Callable[[HeightField, View, TimedFrame], Sight]
# Cached sights, of 16 bytes a pixel and 1 byte a sample each; those of a longer path are computed anew.
MAX_SIGHTS = 16
# Errors that differ by less than this part are the same for the Pareto front.
DIFFERENT = 0.02
# Runs of the same that differ by more than this factor do not show the cost of an error.
MAX_SPREAD = 2.0
# A fit that takes this long is timed as it is.
LONG_FIT_MS = 1000.0
STEPS = ("refine", "weld", "meshlets", "displace", "effects", "ingest", "fit")
ALIKE = "unit", "interpolation"  # settings on one cost curve
TERMS = tuple(Terms.__dataclass_fields__)
TRANSITIONS = "popping_px", "shading_change"  # between the meshes of two frames
PARTS = tuple(Errors.__dataclass_fields__)


@dataclass(frozen=True)
class Row:
    """Results of a setting over all frames: the largest errors and bounds, the median of triangles and times.

    `bound`: in the setting's unit. `limited`: those in Update, of any frame. `surface_mb`: the mesh's arrays;
    `buffers_mb`: address space of all arrays of the engine, of which the system commits the pages that are used (None
    for a fit). `terms`: the parts of the largest bound, in the setting's unit. `popping_px`, `shading_change` (255ths):
    None where no frame follows. `ms`: by step, and "total" of the update (of the fit for a fitted row); "effects",
    making attributes, and "ingest", writing a Blender mesh, come on top; of each frame those of its fastest run.
    `cpu_ms`: processor time of all threads to the finished mesh; `spread_ms`: that of the fastest and of the slowest
    run, of the frame where they differ most.
    """

    setting: Setting
    bound: float
    limited: tuple[str, ...]
    triangles: float
    vertices: float
    surface_mb: float
    buffers_mb: float | None
    measured: Measurement
    terms: Terms | None = None
    popping_px: Errors | None = None
    shading_change: Errors | None = None
    ms: dict[str, float] = field(default_factory=dict)
    spread_ms: tuple[float, float] | None = None
    cpu_ms: float | None = None

    @property
    def error(self) -> float:
        """The largest error that was measured, in the setting's unit: of visible points, or of height."""
        if self.setting.unit == "m":
            return self.measured.vertical_max_m
        assert self.measured.screen_px is not None  # it was measured in a view
        return self.measured.screen_px.max

    @property
    def whole_ms(self) -> float:
        """From the camera to the finished mesh, in Blender's memory if that was measured."""
        return ms_to_finished_mesh(self.ms)

    @property
    def cost_ms(self) -> float:
        """Processor time of all threads to the finished mesh; elapsed time where that was not measured."""
        return self.whole_ms if self.cpu_ms is None else self.cpu_ms

    def figures(self) -> dict[str, float | int | str | None]:
        """Return every figure under a name with its unit, the same names for every row.

        Figures that are not measured are None.
        """
        figures = {"asked" if k == "error" else k: v for k, v in dataclasses.asdict(self.setting).items()}
        figures |= {"bound": self.bound, "measured": self.error}
        figures |= {f"bound_{part}": getattr(self.terms, part, None) for part in TERMS}
        figures |= {"limited": ", ".join(self.limited), "triangles": self.triangles, "vertices": self.vertices}
        figures |= {f"ms_{step}": self.ms.get(step) for step in ("total", *STEPS)}
        figures["ms_cpu"] = self.cpu_ms
        figures |= dict(zip(("ms_fastest", "ms_slowest"), self.spread_ms or (None, None), strict=True))
        figures |= {"surface_mb": self.surface_mb, "buffers_mb": self.buffers_mb}
        measured = {f.name: getattr(self.measured, f.name) for f in dataclasses.fields(self.measured)}
        for name, value in (measured | {n: getattr(self, n) for n in TRANSITIONS}).items():
            if isinstance(value, float):
                figures[name] = value
            else:
                figures |= {f"{name}_{part}": getattr(value, part, None) for part in PARTS}
        return figures


def sweep(
    heights: HeightField,
    settings: Sequence[Setting],
    frames: Sequence[TimedFrame],
    *,
    base: Criterion | None = None,
    threads: int | None = None,
    write: Callable[[Surface], float] | None = None,
    effects: AttributePlan | None = None,
    on_row: Callable[[Row], None] = lambda row: None,
    on_progress: Callable[[float], None] = lambda fraction: None,
) -> list[Row]:
    """Return one row for each setting, measured over all frames.

    Settings in metres depend on no view and take the first frame.

    `base`: criterion with the guard band and culling. `write` puts a surface where it is used, a Blender mesh, and
    returns the milliseconds of that step, "ingest". `effects`: plan of the attributes that are made for every mesh.
    `on_progress` gets 0 .. 1. Any of them may raise, which ends the sweep.
    """
    rows = []
    sights: dict[tuple, Sight] = {}

    def sight(reference: HeightField, view: View, frame: TimedFrame) -> Sight:
        """Return a cached sight: it is the same for every setting, and takes longest to compute."""
        found = look(reference, view, *frame.heights, threads=threads)
        if found.key not in sights and len(sights) == MAX_SIGHTS:
            del sights[next(iter(sights))]
        return sights.setdefault(found.key, found)

    for i, setting in enumerate(settings):

        def on_part(fraction: float, done: int = i) -> None:
            on_progress((done + fraction) / len(settings))

        on_part(0.0)
        reference = interpolated(heights, setting.interpolation)
        if setting.fitted:
            row = _fitted_row(reference, setting, frames[0], threads, on_part)
        else:
            row = _row(
                reference,
                setting,
                frames,
                base or Criterion(),
                threads,
                sight,
                write,
                effects or AttributePlan(),
                on_part,
            )
        rows.append(row)
        on_row(row)
    on_progress(1.0)
    return rows


def curve_of(rows: Sequence[Row]) -> CostCurve:
    """Return the cost curve through `curve_rows`, in processor time to the finished mesh.

    Raises TerrainError if these all have one error.
    """
    points = [(row.setting.error, row.triangles, row.cost_ms) for row in curve_rows(rows)]
    return CostCurve.through(rows[0].setting.unit if rows else "px", points)


def unsteady_row(rows: Sequence[Row]) -> Row | None:
    """Return the row of the cost curve whose runs differ most, if by more than MAX_SPREAD: then there is no curve."""
    found = max(curve_rows(rows), key=lambda row: _spread_factor(row.spread_ms), default=None)
    return found if found is not None and is_unsteady(found.spread_ms) else None


def is_unsteady(spread_ms: tuple[float, float] | None) -> bool:
    """Return whether runs of the same update differ by more than MAX_SPREAD, by `spread_of` their times."""
    return _spread_factor(spread_ms) > MAX_SPREAD


def unsteady_text(setting: str, spread_ms: tuple[float, float]) -> str:
    """Return why no cost curve is drawn: the runs of `setting` differ too much.

    The text follows a colon.

    Args:
        setting: error of the runs with its unit, as "0.5 px".
        spread_ms: milliseconds of processor time of the fastest and of the slowest run.
    """
    low, high = spread_ms
    return (
        f"at {setting} runs of the same update took {low:.3g} to {high:.3g} ms of CPU, more than a factor of "
        f"{MAX_SPREAD:g} apart, so that none of these times can be relied on. Measure again while nothing else runs."
    )


def _spread_factor(spread_ms: tuple[float, float] | None) -> float:
    """Return how many times longer the slowest run took than the fastest; infinity if that is unknown."""
    low, high = spread_ms or (1.0, 1.0)
    return high / low if low > 0.0 else math.inf


def curve_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the plain rows of the first row's unit and interpolation.

    Rows that the triangle limit held back are left out.
    """
    alike = [r for r in rows if all(getattr(r.setting, n) == getattr(rows[0].setting, n) for n in ALIKE)]
    return [r for r in alike if r.setting.is_plain and r.limited != ("max_triangles",)]


def pareto(points: Sequence[tuple[float, float]]) -> list[int]:
    """Return the points (error, cost) that no other beats, by rising cost.

    Each is better than all cheaper ones by DIFFERENT or more, so that rounding and noise make no front.
    """
    front, best = [], math.inf
    for i in sorted(range(len(points)), key=lambda i: (points[i][1], points[i][0])):
        if points[i][0] < best * (1 - DIFFERENT):
            front.append(i)
            best = points[i][0]
    return front


def _row(
    heights: HeightField,
    setting: Setting,
    frames: Sequence[TimedFrame],
    base: Criterion,
    threads: int | None,
    sight: LookUp,
    write: Callable[[Surface], float] | None,
    effects: AttributePlan,
    on_part: Progress,
) -> Row:
    """Return the table row of one setting: refine, measure and time every frame of the path.

    A setting in metres ignores the camera, so one frame without views is enough. `sight` returns what is visible in a
    view, `write` writes a surface as Blender's mesh, `on_part` gets the finished fraction of the row.
    """
    criterion, terrain = setting.criterion(base), Terrain(heights, threads)
    in_pixels = setting.unit == "px"
    if not in_pixels:
        frames = [dataclasses.replace(frames[0], views=(), after=None)]
    num_views = sum(int(max(1, len(frame.views))) for frame in frames)
    bounds, limited, sizes, changes, runs, spreads = [], set(), [], [], [], []
    measured: list[Measurement] = []
    for frame in frames:
        update = terrain.update(criterion, frame.views, *frame.heights)
        surface, bound = update.surface, update.bound_px if in_pixels else update.bound_m
        assert bound is not None  # the criterion has an error in this unit
        bounds.append((bound, update.terms_px if in_pixels else update.terms_m))
        limited.add(update.limited)
        sizes.append((update.triangles, len(surface.positions), _surface_bytes(surface)))
        views: Sequence[View | None] = frame.views or [None]
        for view in views:
            measured.append(
                measure(
                    heights,
                    surface,
                    view,
                    *frame.heights,
                    threads=threads,
                    sight=sight(heights, view, frame) if view else None,
                    on_progress=partial(_report_part, on_part, len(measured), num_views),
                )
            )

        def make_attributes(surface: Surface, views: Sequence[View], frame: TimedFrame = frame) -> dict[str, Attribute]:
            request = EffectRequest(effects, surface, views, *frame.heights)
            return evaluate(heights, request, terrain.history, terrain.threads).attributes

        before = surface if frame.after else None
        del update, surface  # their memory is free for the runs
        count = RUNS if len(frames) == 1 else FRAME_RUNS
        found = timed_runs(terrain, criterion, frame, count, write, make_attributes if effects.steps else None)
        runs.append(fastest_run(found))
        times = [run["cpu"] for run in found]
        spreads.append((min(times), max(times)))
        if frame.after is not None and before is not None:
            changes += _transitions(terrain, criterion, before, frame.after, threads, sight)
    popped, shaded = (worst([change[i] for change in changes]) for i in range(2))
    triangles, vertices, surface_bytes = (median_count(column) for column in zip(*sizes, strict=True))
    ms = median_by_step(runs)
    cpu = ms.pop("cpu")
    loosest, terms = max(bounds, key=itemgetter(0))
    return Row(
        setting,
        loosest,
        tuple(sorted(limited - {""})),
        triangles,
        vertices,
        surface_bytes / 1e6,
        terrain.buffer_bytes / 1e6,
        worst(measured),
        terms,
        popped,
        shaded,
        ms,
        max(spreads, key=lambda times: times[1] / max(times[0], 1e-9)),
        cpu,
    )


def median_count(counts: Sequence[int]) -> float:
    """Return the median of counts, of an even number of them the mean of the two in the middle; whole where it can."""
    found = statistics.median(counts)
    return int(found) if found == int(found) else found


def spread_of(times_ms: Sequence[float]) -> tuple[float, float] | None:
    """Return the smallest and the largest time; None for a single time, which shows no spread."""
    return (min(times_ms), max(times_ms)) if len(times_ms) > 1 else None


def _report_part(report: Progress, done: int, count: int, fraction: float) -> None:
    """Report the progress of `count` equal parts: `done` of them, and a fraction of the next."""
    report((done + fraction) / count)


def _fitted_row(
    heights: HeightField, setting: Setting, frame: TimedFrame, threads: int | None, on_part: Progress
) -> Row:
    """Return the row of a fit.

    It depends on no view; its time is that of a second run where the first is short enough to be disturbed.
    """
    scale, offset = frame.vertical_scale, frame.vertical_offset
    for part in range(2):
        fitted = fit(
            heights,
            setting.error,
            vertical_scale=scale,
            vertical_offset=offset,
            threads=threads,
            on_progress=partial(_report_part, on_part, part, 3),
        )
        if fitted.ms["total"] > LONG_FIT_MS:
            break
    surface = fitted.surface
    measured = measure(
        heights, surface, None, *frame.heights, threads=threads, on_progress=partial(_report_part, on_part, 2, 3)
    )
    assert fitted.bound_m is not None  # a fit has an error in metres
    return Row(
        setting,
        fitted.bound_m,
        tuple({fitted.limited} - {""}),
        fitted.triangles,
        len(surface.positions),
        _surface_bytes(surface) / 1e6,
        None,
        measured,
        fitted.terms_m,
        ms={"fit": fitted.ms["total"], "total": fitted.ms["total"]},
    )


def _transitions(
    terrain: Terrain,
    criterion: Criterion,
    before: Surface,
    frame: TimedFrame,
    threads: int | None,
    sight: LookUp,
) -> list[list[Errors]]:
    """Measure popping (pixels) and changes of shading (255ths) from one frame to the next, for each view.

    before: surface of the first frame; the terrain is updated to `frame`, the next one. sight: function that makes
    the Sight of a view, cached by the caller.
    """
    after = terrain.update(criterion, frame.views, *frame.heights).surface
    found = []
    for view in frame.views:
        seen = sight(terrain.field, view, frame)
        inputs = terrain.field, before, after, view, *frame.heights
        found.append([measured(*inputs, threads=threads, sight=seen) for measured in (popping, shading_change)])
    return found


def _surface_bytes(surface: Surface) -> int:
    """Return the bytes of all arrays of a surface."""
    return sum(array.nbytes for array in surface.arrays().values())


def worst(parts: Sequence) -> Any:
    """Return the largest of every figure of several Errors or Measurements, counts added; None if there are none."""
    parts = [part for part in parts if part is not None]
    if not parts or isinstance(parts[0], float):
        return max(parts, default=None)
    if isinstance(parts[0], int):
        return sum(map(int, parts))
    names = [f.name for f in dataclasses.fields(parts[0])]
    return type(parts[0])(**{name: worst([getattr(part, name) for part in parts]) for name in names})
