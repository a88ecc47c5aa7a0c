# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure what errors cost on a terrain with its settings, and how large the errors of its mesh are.

A Request holds everything that an update of a terrain depends on, so it can be measured without touching Blender.
"""

import json
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import bpy

from ...cbt_terrain.accuracy.cost_curve import CostCurve
from ...cbt_terrain.accuracy.sweep_settings import PIXELS, metre_steps
from ...cbt_terrain.accuracy.timed_runs import TimedFrame, fastest_run, timed_runs
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.view.criterion import requested_unit
from ..session import session
from ..terrain.request import RENDER, VIEWPORT, Request, gather
from .measuring import MeasuringOperator

if TYPE_CHECKING:
    from ...cbt_terrain.accuracy.measure import Measurement

# Triangles of the largest measured mesh. A finer error is left out: it takes long, and memory that the scene needs.
MAX_TRIANGLES = 1 << 22
TRIES = 3  # measurements of an error whose runs differ too much: the window is drawn by this process, too
DETAIL = {VIEWPORT: "viewport", RENDER: "render"}  # mode -> property group of its settings


@dataclass(frozen=True)
class Result:
    """What was measured for one mode, viewport or render.

    Attributes:
        curve: what errors cost, None where runs of the same update differ too much.
        measured: the errors of the mesh that the mode's settings give.
        digest: that mesh, by Request.digest.
        no_curve: why there is no curve, "" if there is one.
    """

    curve: CostCurve | None
    measured: "Measurement"
    digest: str
    no_curve: str = ""

    def store(self, detail) -> None:
        """Write the result into a DetailSettings, which the .blend file keeps."""
        detail.measured = json.dumps({"digest": self.digest, **asdict(self.measured)})
        detail.no_curve = self.no_curve
        detail.curve = "" if self.curve is None else self.curve.to_json()


def read_measured(detail) -> dict:
    """Return what `Result.store` wrote: the fields of a Measurement, its Errors as dicts, and "digest".

    The result is {} if the text is missing, is not JSON or lacks a field; values are not checked.
    """
    from ...cbt_terrain.accuracy.measure import Measurement

    try:
        measured = json.loads(detail.measured)
    except (ValueError, RecursionError):
        return {}
    names = {"digest", *Measurement.__dataclass_fields__}
    return measured if isinstance(measured, dict) and measured.keys() >= names else {}


def errors_text(measured: "Measurement") -> str:
    """Describe the largest measured errors: of visible points in pixels, if there is a view, and of heights."""
    seen = "" if measured.screen_px is None else f"{measured.screen_px.max:.3g} px on screen, "
    return f"measured at most {seen}{measured.vertical_max_m:.3g} m of height"


def measure_requests(requests: dict[str, Request], on_progress) -> dict[str, Result]:
    """Measure requests by mode, of one or both modes, without touching Blender; return a Result by mode.

    on_progress: called with the fraction done and a message; may raise to stop. Raises TerrainError if one fails.
    """
    results = {}
    for i, (mode, request) in enumerate(requests.items()):
        with session.engine_lock:
            field = session.field_of(request)

        def on_part(fraction: float, message: str, i: int = i, mode: str = mode) -> None:
            """Report the finished fraction of one request as one of all requests."""
            on_progress((i + fraction) / len(requests), f"{DETAIL[mode].capitalize()}: {message}")

        results[mode] = measure_request(field, request, on_part)
    return results


def measure_request(field, request: Request, on_progress) -> Result:
    """Measure what different errors cost on a terrain, and the true errors of the mesh of `request`.

    The errors are those of a sweep and the request's own, coarse first, until one needs too many triangles. Each is
    timed up to TRIES times, until its runs agree; if they never do, there is no curve of costs. The mesh has the error
    of the request's criterion; with a time budget the one that fits it by the new curve, if there is one. Of several
    views, the largest errors count.

    field: the height field. request: its criterion has an error. on_progress: called with the fraction done and a
    message; may raise to stop. Raises TerrainError if no two errors can be measured.
    """
    from ...cbt_terrain.accuracy.measure import measure
    from ...cbt_terrain.accuracy.rows import is_unsteady, spread_of, unsteady_text, worst
    from ...cbt_terrain.terrain import Terrain

    request = replace(request, frozen="")  # costs are those of a mesh that follows its camera
    unit = requested_unit(request.criterion)
    field_name = f"error_{unit}"  # of the criterion
    relief_m = (field.max_height - field.min_height) * abs(request.vertical_scale)
    swept = PIXELS if unit == "px" else metre_steps(relief_m)
    errors = sorted({getattr(request.criterion, field_name), *swept}, reverse=True)
    frame = TimedFrame(request.views, request.placement, request.vertical_scale, request.vertical_offset)
    views = frame.views or [None]  # None: without a view only heights are measured
    steps = len(errors) + len(views)
    terrain, points, no_curve = Terrain(field), [], ""  # points: (error, triangles, milliseconds)
    for i, error in enumerate(errors):

        def on_run(_surface=None, done: int = i, error: float = error) -> float:
            """Report progress, before the first timed run and after each; return 0 ms as the time of writing."""
            on_progress(done / steps, f"time at {error:.3g} {unit}")
            return 0.0  # nothing is written

        on_run()
        criterion = replace(request.criterion, **{field_name: error}, max_triangles=MAX_TRIANGLES)
        update = terrain.update(criterion, frame.views, *frame.placement_and_heights)
        if update.relaxed > 1:  # MAX_TRIANGLES made the error larger than requested, and would for every finer one
            break
        for _ in range(TRIES):
            runs = timed_runs(terrain, criterion, frame, write=on_run)
            spread = spread_of([run["cpu"] for run in runs])
            if not is_unsteady(spread):
                break
        else:
            no_curve = no_curve or f"No curve of errors against time: {unsteady_text(f'{error:g} {unit}', spread)}"
        points.append((error, update.triangles, fastest_run(runs)["total"]))
    if len(points) < 2:
        raise TerrainError(
            f"An error of {errors[len(points)]:g} {unit} takes more than {MAX_TRIANGLES:,} triangles with these "
            "settings, too many to measure",
            fix="make Meshlet Level, Edge Length or Triangle Area coarser",
        )
    curve = None if no_curve else CostCurve.through(unit, points)
    if curve is not None and request.max_ms is not None:  # from now on this curve says which error fits
        fitting_error = curve.error_for_ms(request.max_ms)
        request = replace(request, criterion=replace(request.criterion, **{field_name: fitting_error}))
    surface = terrain.update(request.criterion, frame.views, *frame.placement_and_heights).surface
    measurements = []
    for i, view in enumerate(views, len(errors)):

        def on_part(fraction: float, done: int = i) -> None:
            """Report the finished fraction of one view's measurement as one of all steps."""
            on_progress((done + fraction) / steps, "errors")

        measurements.append(measure(field, surface, view, *frame.placement_and_heights, on_progress=on_part))
    on_progress(1.0, "done")
    digest = request.digest(field.key)  # of the inputs of this mesh: another digest makes the figures outdated
    return Result(curve, worst(measurements), digest, no_curve)


def _measurable_requests(obj, depsgraph) -> tuple[dict[str, Request], list[TerrainError]]:
    """Return the requests that can be measured, by mode, each with an error in its criterion, and why others cannot.

    Raises TerrainError if none can.
    """
    requests, problems = {}, []
    for mode in DETAIL:
        try:
            request = gather(obj, depsgraph, mode)
            unit = requested_unit(request.criterion)
            if not unit:
                raise TerrainError("Measure Accuracy has no error to vary", fix="set Screen Error or Vertical Error")
            # The user's own error, not the one that a time budget chose: its curve is about to be replaced.
            detail = getattr(obj.evaluated_get(depsgraph).adaptive_terrain, DETAIL[mode])
            error = {f"error_{unit}": getattr(detail, f"error_{unit}")}
            requests[mode] = replace(request, criterion=replace(request.criterion, **error))
        except TerrainError as error:
            problems.append(error.within(f"The {DETAIL[mode]}'s detail cannot be measured"))
    if not requests:
        raise problems[0]
    return requests, problems


class MeasureAccuracy(MeasuringOperator, bpy.types.Operator):
    """Measure how far the mesh is from the true ground, and the time of finer and coarser meshes, for the viewport's
    and the render's detail. Leave the view alone until it is done; measure again after large changes"""

    bl_idname = "adaptive_terrain.measure_accuracy"
    bl_label = "Measure Accuracy"
    bl_options = {"REGISTER", "UNDO"}

    def prepare(self, context):
        """Return the function that measures on the job's thread; report modes that cannot be measured.

        Raises TerrainError if neither can.
        """
        requests, problems = _measurable_requests(context.object, context.evaluated_depsgraph_get())
        for problem in problems:
            self.report({"WARNING"}, str(problem))
        return lambda job: measure_requests(requests, job.progress)

    def finish(self, _context, obj, results: dict[str, Result]) -> None:
        """Store the results in the terrain's settings, and report the errors."""
        for mode, result in results.items():
            result.store(getattr(obj.adaptive_terrain, DETAIL[mode]))
            if result.no_curve:
                self.report({"WARNING"}, f"{DETAIL[mode].capitalize()}: {result.no_curve}")
            self.report({"INFO"}, f"{DETAIL[mode].capitalize()}: {errors_text(result.measured)}")
