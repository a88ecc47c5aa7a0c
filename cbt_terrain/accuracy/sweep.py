# SPDX-License-Identifier: GPL-3.0-or-later
"""The cost of accuracy: one terrain refined with one setting after the other, with bounds, errors and times.

Each setting (error, unit, limits) is measured on every frame of a path, that is a placement of the terrain and its
cameras, and gives one row. A sight is what a camera sees of the exact surface; it is the same for all meshes.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from operator import itemgetter

from ..attributes.evaluate import EffectRequest, evaluate
from ..attributes.plan import AttributePlan
from ..field.bicubic import interpolated
from ..field.heightfield import HeightField
from ..fit.fit import fit
from ..mesh.attributes import Attribute
from ..mesh.surface import Surface
from ..terrain import Terrain
from ..view.criterion import Criterion
from ..view.view import View
from .measure import Measurement, look, measure, popping, shading_change
from .mesh import Errors, Progress
from .rows import Row, median_count, worst
from .screen import Sight
from .sweep_settings import Setting
from .timed_runs import FRAME_RUNS, RUNS, TimedFrame, fastest_run, median_by_step, timed_runs

# Returns the visible part of a height field in a view of a frame.
LookUp = Callable[[HeightField, View, TimedFrame], Sight]
# Cached sights, of 16 bytes a pixel and 1 byte a sample each; those of a longer path are computed anew.
MAX_SIGHTS = 16
# A fit that takes this long is timed as it is.
LONG_FIT_MS = 1000.0


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

    Settings in metres depend on no view and take the first frame, of which there is at least one.

    A setting that is `fitted` asks for a mesh whose heights are fitted to the surface, which is timed without `write`
    and `effects`. `base`: criterion from which settings take what they do not set themselves, for example culling.
    `write` copies a surface to its user, for example into a Blender mesh, and returns the milliseconds of that step,
    "ingest". `effects`: plan of the attributes that are made for every mesh. `on_row` gets each row as soon as it is
    complete, `on_progress` 0 .. 1. These functions may raise, which ends the sweep.
    """
    rows = []
    sights: dict[tuple, Sight] = {}

    def cached_sight(reference: HeightField, view: View, frame: TimedFrame) -> Sight:
        """Return the sight of a view, which is the same for every setting, from the cache if it is there.

        `look` casts no rays yet: the sight does so at the first measurement, which takes longest, and keeps the result.
        """
        new_sight = look(reference, view, *frame.placement_and_heights, threads=threads)
        if new_sight.key not in sights and len(sights) == MAX_SIGHTS:
            del sights[next(iter(sights))]
        return sights.setdefault(new_sight.key, new_sight)

    for i, setting in enumerate(settings):

        def on_part(fraction: float, done: int = i) -> None:
            """Report the finished fraction of one setting's measurement as one of the whole sweep."""
            on_progress((done + fraction) / len(settings))

        on_part(0.0)
        reference = interpolated(heights, setting.interpolation)
        if setting.fitted:
            row = _measure_fit(reference, setting, frames[0], threads, on_part)
        else:
            row = _measure_setting(
                reference,
                setting,
                frames,
                base or Criterion(),
                threads,
                cached_sight,
                write,
                effects or AttributePlan(),
                on_part,
            )
        rows.append(row)
        on_row(row)
    on_progress(1.0)
    return rows


def _measure_setting(
    heights: HeightField,
    setting: Setting,
    frames: Sequence[TimedFrame],
    base: Criterion,
    threads: int | None,
    find_sight: LookUp,
    write: Callable[[Surface], float] | None,
    effects: AttributePlan,
    on_part: Progress,
) -> Row:
    """Return the row of one setting: refine, measure and time every frame of the path.

    A setting in metres ignores the camera, so one frame without views is enough. base: criterion for all that the
    setting leaves open. find_sight: finds the visible ground in a view. write: copies a surface to its user and returns
    the milliseconds, None to leave that out. effects: plan of the attributes of each mesh. on_part: gets the finished
    fraction of the row. A frame's `after` is the next frame of the path, for popping between the two.
    """
    criterion, terrain = setting.criterion(base), Terrain(heights, threads)
    in_pixels = setting.unit == "px"
    if not in_pixels:
        frames = [dataclasses.replace(frames[0], views=(), after=None)]
    num_views = sum(int(max(1, len(frame.views))) for frame in frames)
    bounds, limit_causes, sizes, runs, spreads = [], set(), [], [], []  # one item for each frame
    measured: list[Measurement] = []  # one for each view of each frame
    changes: list[list[Errors]] = []  # for each view of frames with a next one: popping, change of shading
    # Refine the mesh of each frame, measure it in each view, then time the same update again and again.
    for frame in frames:
        update = terrain.update(criterion, frame.views, *frame.placement_and_heights)
        surface, bound = update.surface, update.bound_px if in_pixels else update.bound_m
        assert bound is not None  # the criterion has an error in this unit
        bounds.append((bound, update.terms_px if in_pixels else update.terms_m))
        limit_causes.add(update.limited)  # why the bound exceeds the requested error, "" if it does not
        sizes.append((update.triangles, len(surface.positions), _surface_bytes(surface)))
        views: Sequence[View | None] = frame.views or [None]
        for view in views:
            measured.append(
                measure(
                    heights,
                    surface,
                    view,
                    *frame.placement_and_heights,
                    threads=threads,
                    sight=find_sight(heights, view, frame) if view else None,
                    on_progress=partial(_report_part, on_part, len(measured), num_views),
                )
            )
        make_attributes = partial(_attributes_of, heights, terrain, effects, frame) if effects.steps else None
        before = surface if frame.after else None
        del update, surface  # their memory is free for the runs
        count = RUNS if len(frames) == 1 else FRAME_RUNS
        timed = timed_runs(terrain, criterion, frame, count, write, make_attributes)
        runs.append(fastest_run(timed))
        times = [run["cpu"] for run in timed]
        spreads.append((min(times), max(times)))
        if frame.after is not None and before is not None:
            changes += _transitions(terrain, criterion, before, frame.after, find_sight)
    # Combine the frames: worst errors and loosest bound, median sizes and times, and the largest ratio of the slowest
    # run to the fastest.
    popped, shaded = (worst([change[i] for change in changes]) for i in range(2))
    triangles, vertices, surface_bytes = (median_count(column) for column in zip(*sizes, strict=True))
    ms = median_by_step(runs)
    cpu = ms.pop("cpu")
    loosest, terms = max(bounds, key=itemgetter(0))
    return Row(
        setting,
        bound=loosest,
        limited=tuple(sorted(limit_causes - {""})),
        triangles=triangles,
        vertices=vertices,
        surface_mb=surface_bytes / 1e6,
        buffers_mb=terrain.buffer_bytes / 1e6,
        measured=worst(measured),
        terms=terms,
        popping_px=popped,
        shading_change=shaded,
        ms=ms,
        spread_ms=max(spreads, key=lambda times: times[1] / max(times[0], 1e-9)),
        cpu_ms=cpu,
    )


def _attributes_of(
    heights: HeightField,
    terrain: Terrain,
    effects: AttributePlan,
    frame: TimedFrame,
    surface: Surface,
    views: Sequence[View],
) -> dict[str, Attribute]:
    """Return the attributes that the effects give a surface of a frame, by name.

    heights: field that attributes read. terrain: owns the history with the values of the last surface. views: cameras,
    which decide the scale of attributes.
    """
    request = EffectRequest(effects, surface, views, *frame.placement_and_heights)
    return evaluate(heights, request, terrain.history, terrain.threads).attributes


def _report_part(report: Progress, done: int, count: int, fraction: float) -> None:
    """Report the progress of `count` equal parts: `done` of them, and a fraction of the next."""
    report((done + fraction) / count)


def _measure_fit(
    heights: HeightField, setting: Setting, frame: TimedFrame, threads: int | None, on_part: Progress
) -> Row:
    """Return the row of a fit: a mesh whose heights are fitted to an error in metres, whatever the view.

    A fit of at most LONG_FIT_MS runs twice, and the second time counts, since a short run is easily disturbed. frame:
    gives the placement, vertical scale and offset. on_part: gets the finished fraction of the row.
    """
    scale, offset = frame.vertical_scale, frame.vertical_offset
    for run in range(2):  # two of three parts of the progress; the measurement is the third
        fitted = fit(
            heights,
            setting.error,
            vertical_scale=scale,
            vertical_offset=offset,
            threads=threads,
            on_progress=partial(_report_part, on_part, run, 3),
        )
        if fitted.ms["total"] > LONG_FIT_MS:
            break
    surface = fitted.surface
    measured = measure(
        heights,
        surface,
        None,
        *frame.placement_and_heights,
        threads=threads,
        on_progress=partial(_report_part, on_part, 2, 3),
    )
    assert fitted.bound_m is not None  # a fit has an error in metres
    return Row(
        setting,
        bound=fitted.bound_m,
        limited=tuple({fitted.limited} - {""}),
        triangles=fitted.triangles,
        vertices=len(surface.positions),
        surface_mb=_surface_bytes(surface) / 1e6,
        buffers_mb=None,
        measured=measured,
        terms=fitted.terms_m,
        ms={"fit": fitted.ms["total"], "total": fitted.ms["total"]},
    )


def _transitions(
    terrain: Terrain, criterion: Criterion, before: Surface, frame: TimedFrame, find_sight: LookUp
) -> list[list[Errors]]:
    """Return popping (pixels) and changes of shading (255ths) from one frame to the next: a list of both for each view.

    before: surface of the first frame; the terrain is updated to `frame`, the next one, under `criterion`. find_sight:
    makes the Sight of a view, cached by the caller.
    """
    after = terrain.update(criterion, frame.views, *frame.placement_and_heights).surface
    errors_by_view = []
    for view in frame.views:
        sight = find_sight(terrain.field, view, frame)
        errors_by_view.append([popping(before, after, sight), shading_change(before, after, sight)])
    return errors_by_view


def _surface_bytes(surface: Surface) -> int:
    """Return the bytes of all arrays of a surface."""
    return sum(array.nbytes for array in surface.arrays().values())
