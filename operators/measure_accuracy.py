# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure what errors cost on a terrain, and how large they are, on a thread beside the window."""

import json
import threading
import traceback
from dataclasses import asdict, dataclass, replace

import bpy

from ..cbt_terrain import warmup
from ..cbt_terrain.accuracy import Measured, measure
from ..cbt_terrain.cost_curve import CostCurve
from ..cbt_terrain.criterion import unit_asked
from ..cbt_terrain.errors import TerrainError
from ..cbt_terrain.sweep import PIXELS, metre_steps, worst
from ..cbt_terrain.terrain import Terrain
from ..cbt_terrain.timed_runs import Frame, median_by_step, timed_runs
from . import live, session
from .request import RENDER, VIEWPORT, Request, gather

POLL_S = 0.1
MAX_TRIANGLES = 1 << 22  # a finer error is left out of the curve: it would take long, and memory that the scene needs
DETAIL = {VIEWPORT: "viewport", RENDER: "render"}  # mode -> property group of its settings
NO_ERROR_ASKED = "Measure Accuracy needs an error to vary: set Screen Error or Vertical Error."
_jobs: dict[int, "MeasureJob"] = {}  # by the object's session_uid


class Stopped(Exception):
    """The measurement was stopped."""


@dataclass(frozen=True)
class Result:
    """Of one mode: what errors cost, and the errors of the mesh (named by Request.digest) that its settings give."""

    curve: CostCurve
    measured: Measured
    digest: str

    def store(self, detail) -> None:
        """Keep it in a DetailSettings, and with it in the .blend file."""
        detail.measured = json.dumps({"digest": self.digest, **asdict(self.measured)})
        detail.curve = self.curve.to_json()


def read_measured(detail) -> dict:
    """What `Result.store` kept: accuracy.Measured as a dict, and "digest"; {} where there is none, or it is damaged."""
    try:
        measured = json.loads(detail.measured)
    except (ValueError, RecursionError):
        return {}
    names = {"digest", *Measured.__dataclass_fields__}
    return measured if isinstance(measured, dict) and measured.keys() >= names else {}


def errors_text(measured: Measured) -> str:
    """The largest error that was measured: of visible points in pixels, if there is a view, and of heights."""
    seen = "" if measured.screen_px is None else f"{measured.screen_px.max:.3g} px on screen, "
    return f"measured at most {seen}{measured.vertical_max_m:.3g} m of height"


class MeasureJob:
    """Measures each mode's request, on a thread after `start` or on this one by `run`; touches nothing of Blender.

    `fraction`, `message`: how far it is. `error`: why it ended without `results`, or "".
    """

    def __init__(self, requests: dict[str, Request]):
        self.requests = requests
        self.fraction, self.message = 0.0, "Starting"
        self.error = ""
        self.results: dict[str, Result] = {}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self.run, name="adaptive_terrain_measure", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End it soon, without results."""
        self._stopping.set()

    @property
    def stopped(self) -> bool:
        return self._stopping.is_set()

    @property
    def done(self) -> bool:
        return not self._thread.is_alive()

    def wait(self) -> None:
        self._thread.join()

    def run(self) -> None:
        try:
            warmup.wait()
            results = {}
            for i, (mode, request) in enumerate(self.requests.items()):
                with session.engine_lock:
                    field = session.field_of(request)

                def on_progress(fraction: float, message: str, i: int = i, mode: str = mode) -> None:
                    if self.stopped:
                        raise Stopped
                    self.fraction = (i + fraction) / len(self.requests)
                    self.message = f"{DETAIL[mode].capitalize()}: {message}"

                results[mode] = measure_request(field, request, on_progress)
            self.results = results
        except Stopped:
            pass
        except TerrainError as error:
            self.error = str(error)
        except Exception as error:
            traceback.print_exc()
            self.error = f"Measuring failed unexpectedly ({type(error).__name__}: {error}); nothing was changed."


def measure_request(field, request: Request, on_progress) -> Result:
    """What errors cost with all else as `request` asks, and the errors of the mesh that it gives.

    `on_progress` gets the fraction done and what is being done; it may raise, which ends the measurement.
    """
    unit = unit_asked(request.criterion)
    name = f"error_{unit}"
    relief_m = (field.max_height - field.min_height) * abs(request.vertical_scale)
    swept = PIXELS if unit == "px" else metre_steps(relief_m)
    errors = sorted({getattr(request.criterion, name), *swept}, reverse=True)
    frame = Frame(request.views, request.placement, request.vertical_scale, request.vertical_offset)
    looks = frame.views or [None]
    steps = len(errors) + len(looks)
    terrain, points = Terrain(field), []
    for i, error in enumerate(errors):

        def on_run(_surface=None, done: int = i, error: float = error) -> None:
            on_progress(done / steps, f"time at {error:.3g} {unit}")

        on_run()
        criterion = replace(request.criterion, **{name: error}, max_triangles=MAX_TRIANGLES)
        update = terrain.update(criterion, frame.views, *frame.heights)
        if update.relaxed > 1:
            break
        runs = timed_runs(terrain, criterion, frame, write=on_run)
        points.append((error, update.triangles, median_by_step(runs)["total"]))
    if len(points) < 2:
        raise TerrainError(
            f"An error of {errors[len(points)]:g} {unit} takes more than {MAX_TRIANGLES:,} triangles with these "
            "settings, too many to measure; make Meshlet Level, Edge Length or Triangle Area coarser."
        )
    curve = CostCurve.through(unit, points)
    if request.max_ms is not None:  # from now on this curve says which error fits
        request = replace(request, criterion=replace(request.criterion, **{name: curve.error_for_ms(request.max_ms)}))
    surface = terrain.update(request.criterion, frame.views, *frame.heights).surface
    found = []
    for i, view in enumerate(looks, len(errors)):

        def on_part(fraction: float, done: int = i) -> None:
            on_progress((done + fraction) / steps, "errors")

        found.append(measure(field, surface, view, *frame.heights, on_progress=on_part))
    on_progress(1.0, "done")
    return Result(curve, worst(found), request.digest(field.key))


def progress_of(obj) -> tuple[float, str] | None:
    """Fraction done (0 .. 1) and what is being measured, or None when nothing is measured for the object."""
    job = _jobs.get(obj.session_uid)
    return None if job is None else (job.fraction, job.message)


def stop_all() -> None:
    """Undo may have changed what is being measured: end every measurement."""
    for job in _jobs.values():
        job.stop()


def _requests(obj, depsgraph) -> tuple[dict[str, Request], list[str]]:
    """What can be measured of the terrain, and why the rest cannot. Raises TerrainError if nothing can."""
    requests, problems = {}, []
    for mode in DETAIL:
        try:
            request = gather(obj, depsgraph, mode)
            if not unit_asked(request.criterion):
                raise TerrainError(NO_ERROR_ASKED)
            requests[mode] = request
        except TerrainError as error:
            problems.append(f"{DETAIL[mode].capitalize()}: {error}")
    if not requests:
        raise TerrainError(problems[0])
    return requests, problems


class MeasureAccuracy(bpy.types.Operator):
    """Measure the errors of the mesh and what finer and coarser ones cost, for this camera: once with the viewport's
    detail and once with the render's own camera, resolution and detail. Leave the view alone meanwhile, so that the
    times are right; measure again after large changes"""

    bl_idname = "adaptive_terrain.measure_accuracy"
    bl_label = "Measure Accuracy"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        obj = context.object
        return obj is not None and session.is_terrain(obj) and obj.session_uid not in _jobs

    def invoke(self, context, event):
        obj = context.object
        job = self._job(context)
        if job is None:
            return {"CANCELLED"}
        self.uid = obj.session_uid
        _jobs[self.uid] = job
        job.start()
        self.timer = context.window_manager.event_timer_add(POLL_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        live.redraw_panels()
        job = _jobs[self.uid]
        if not job.done:
            return {"PASS_THROUGH"}
        self._end(context)
        obj = next((item for item in session.all_terrains() if item.session_uid == self.uid), None)
        return {"CANCELLED"} if obj is None else self._finish(obj, job)

    def execute(self, context):
        obj = context.object
        job = self._job(context)
        if job is None:
            return {"CANCELLED"}
        job.run()
        return self._finish(obj, job)

    def cancel(self, context):
        """Another file is loaded, or Blender quits."""
        _jobs[self.uid].stop()
        self._end(context)

    def _job(self, context) -> MeasureJob | None:
        obj = context.object
        try:
            requests, problems = _requests(obj, context.evaluated_depsgraph_get())
        except TerrainError as error:
            self._failed(obj, str(error))
            return None
        for problem in problems:
            self.report({"WARNING"}, problem)
        session.record_of(obj).status.error = ""
        return MeasureJob(requests)

    def _end(self, context):
        context.window_manager.event_timer_remove(self.timer)
        del _jobs[self.uid]
        live.redraw_panels()

    def _finish(self, obj, job: MeasureJob):
        if job.stopped:
            self.report({"INFO"}, "Measuring was stopped; what was measured before stays")
            return {"CANCELLED"}
        if job.error:
            return self._failed(obj, job.error)
        for mode, result in job.results.items():
            result.store(getattr(obj.adaptive_terrain, DETAIL[mode]))
            self.report({"INFO"}, f"{DETAIL[mode].capitalize()}: {errors_text(result.measured)}")
        return {"FINISHED"}

    def _failed(self, obj, message: str):
        session.record_of(obj).status.error = message
        self.report({"ERROR"}, message)
        return {"CANCELLED"}


class CancelMeasure(bpy.types.Operator):
    """Stop measuring; what was measured before stays"""

    bl_idname = "adaptive_terrain.cancel_measure"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.session_uid in _jobs

    def execute(self, context):
        _jobs[context.object.session_uid].stop()
        return {"FINISHED"}


CLASSES = (MeasureAccuracy, CancelMeasure)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for job in _jobs.values():
        job.stop()
        job.wait()
    _jobs.clear()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
