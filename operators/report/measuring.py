# SPDX-License-Identifier: GPL-3.0-or-later
"""Measuring takes long: it runs on a thread beside the window, one measurement at a time, because it takes times."""

import queue
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future, wait

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run import warmup
from ..scene import session
from ..scene.polls import on_terrain
from ..viewport import live

POLL_S = 0.02  # what a job asks of the main thread waits as long
RENDERING = "Blender is rendering, which would be in every time; measure again when it is done."
_job: "Job | None" = None  # under way beside a window


class Stopped(Exception):
    """The measurement was stopped."""


class Job:
    """Carries out `work(job)`, on a thread after `start` or on this one by `run`; it touches nothing of Blender's but
    through `on_main`.

    `uid`: session_uid of the object that is measured. `fraction`, `message`: how far it is. `result`: what `work` has
    returned, or None and in `error` why, "" if it was merely stopped.
    """

    def __init__(self, uid: int, work: Callable[["Job"], object]):
        self.uid, self._work = uid, work
        self.fraction, self.message = 0.0, "Starting"
        self.result, self.error = None, ""
        self.timer = None  # of the window, while it runs beside one
        self._stopping = threading.Event()
        self._asked: queue.SimpleQueue[tuple[Future, Callable]] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self.run, name="adaptive_terrain_measure", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End it soon, without a result."""
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
            self.result = self._work(self)
        except Stopped:
            pass
        except TerrainError as error:
            self.error = str(error)
        except Exception as error:
            traceback.print_exc()
            self.error = f"Measuring failed unexpectedly ({type(error).__name__}: {error}); nothing was changed."

    def progress(self, fraction: float, message: str) -> None:
        """Say how far it is (0 .. 1); raises Stopped once it is to end."""
        if self.stopped:
            raise Stopped
        self.fraction, self.message = fraction, message

    def on_main(self, function: Callable):
        """What `function()` returns, on the thread that may touch Blender's data; raises Stopped as `progress` does."""
        if threading.current_thread() is not self._thread:
            return function()
        answer = Future()
        self._asked.put((answer, function))
        while not wait([answer], timeout=POLL_S).done:
            if self.stopped:
                answer.cancel()
                raise Stopped
        return answer.result()

    def serve(self) -> None:
        """Do what `on_main` waits for; on the main thread, often."""
        while not self._asked.empty():
            answer, function = self._asked.get()
            if answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(function())
                except Exception as error:
                    answer.set_exception(error)


def rendering() -> bool:
    return bpy.app.is_job_running("RENDER")


def progress_of(obj) -> tuple[float, str] | None:
    """Fraction done (0 .. 1) and what is being measured, or None when nothing is measured for the object."""
    return (_job.fraction, _job.message) if _job is not None and _job.uid == obj.session_uid else None


def stop() -> None:
    """Undo may have changed what is being measured: end it."""
    if _job is not None:
        _job.stop()


def _object_of(job: Job):
    """None where it is gone."""
    return next((item for item in session.all_terrains() if item.session_uid == job.uid), None)


class MeasuringOperator:
    """Base of operators that measure: beside the window when invoked, at once when a script runs them.

    A subclass has `work(context)`, which returns the work of a Job or raises TerrainError; `finish(obj, result)`, which
    puts its result into the file and into the report; and may have `clean_up()`, which is called however it ends.
    """

    @classmethod
    def poll(cls, context):
        if _job is not None:
            cls.poll_message_set("A measurement is under way: two at once would be in each other's times")
            return False
        return on_terrain(cls, context)

    def invoke(self, context, event):
        global _job
        job = self._new_job(context)
        if job is None:
            return {"CANCELLED"}
        self.shown = None
        _job = job
        job.start()
        job.timer = context.window_manager.event_timer_add(POLL_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        job = _job
        if rendering() and not job.done:
            job.error = RENDERING
            job.stop()
        if not job.stopped:
            job.serve()
        shown = round(job.fraction, 2), job.message
        if shown != self.shown:
            self.shown = shown
            live.redraw_panels()
            if _object_of(job) is None:
                job.stop()
        if not job.done:
            return {"PASS_THROUGH"}
        self._end(context)
        obj = _object_of(job)
        if obj is None:
            self.report({"INFO"}, "The terrain is gone; what was measured of it is not kept")
            return {"CANCELLED"}
        return self._finish(obj, job)

    def execute(self, context):
        job = self._new_job(context)
        if job is None:
            return {"CANCELLED"}
        job.run()
        self.clean_up()
        return self._finish(context.object, job)

    def cancel(self, context):
        """Another file is loaded, or Blender quits."""
        _job.stop()
        self._end(context)

    def clean_up(self) -> None:
        pass

    def _new_job(self, context) -> Job | None:
        try:
            if rendering():
                raise TerrainError(RENDERING)
            work = self.work(context)
        except TerrainError as error:
            self._failed(context.object, str(error))
            return None
        session.record_of(context.object).status.error = ""
        return Job(context.object.session_uid, work)

    def _end(self, context):
        global _job
        context.window_manager.event_timer_remove(_job.timer)
        _job = None
        self.clean_up()
        live.redraw_panels()

    def _finish(self, obj, job: Job):
        if job.result is not None:
            self.finish(obj, job.result)
            return {"FINISHED"}
        if job.error:
            return self._failed(obj, job.error)
        self.report({"INFO"}, "Measuring was stopped; what was measured before stays")
        return {"CANCELLED"}

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
        return _job is not None

    def execute(self, context):
        stop()
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(CancelMeasure)


def unregister() -> None:
    global _job
    if _job is not None:
        _job.stop()
        _job.wait()
        bpy.context.window_manager.event_timer_remove(_job.timer)
        _job = None
    bpy.utils.unregister_class(CancelMeasure)
