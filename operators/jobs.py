# SPDX-License-Identifier: GPL-3.0-or-later
"""Background jobs, which leave the window usable: their progress, their steps and the operator that cancels them.

A job is a generator of steps. A timer takes the steps on the main thread; long work runs on a thread (`run_on_thread`)
or in a child process (`run_in_child`) while the steps only wait for it, and the scene's frames are visited a few at a
time (`visit_frames`).
"""

import queue
import threading
import time
import traceback
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, wait
from contextlib import closing
from dataclasses import dataclass
from types import ModuleType

import bpy

from ..cbt_terrain.errors import TerrainError
from ..cbt_terrain.run import warmup
from ..cbt_terrain.sandbox.store_job import ChildJob
from .session import session
from .text.translations import phrase

POLL_S = 0.1
CALL_S = 0.02  # between looks for calls that a thread waits for
TURN_S = 0.05  # for which frames are visited before the window has its turn
STARTING, LOOKING, CHECKING = "Starting", "Looking at frames", "Checking the shaped land"
CANCELLING = "Cancelling"
PREPARING = "Preparing kernels (first use)"
SHOWN_STEPS = 200  # a progress bar is redrawn when it has grown by one
Steps = Generator[None, None, object]


@dataclass(frozen=True)
class JobKind:
    """A kind of job.

    `title`: its name for the user. `stays`: clause about the things that a cancelled job leaves unchanged. `alone`:
    only one job of the kind runs at a time, instead of one a terrain.
    """

    name: str
    title: str
    stays: str
    alone: bool = False


IMPORT = JobKind("IMPORT", "Importing", "the store stays as it was")
SHAPE = JobKind(
    "SHAPE",
    "Shaping",
    "the land stays as it was, and finished tiles are reused. A resting view begins again only after the stack changes",
)
PACK = JobKind("PACK", "Packing stores", "every store stays where it was", alone=True)
BAKE = JobKind("BAKE", "Baking maps", "the maps stay as they were", alone=True)
MEASURE = JobKind("MEASURE", "Measuring", "earlier measurements are kept", alone=True)  # two would slow each other
WATER = JobKind("WATER", "Adding water", "the water stays as it was")
BAKE_LAND = JobKind("BAKE_LAND", "Baking to a store", "its list and its heights stay as they were")
EXPORT = JobKind("EXPORT", "Exporting", "files that are complete stay, without the JSON file that lists them")
MAP = JobKind("MAP", "Rendering a map", "pictures that are complete stay, without GeoTIFF files", alone=True)
SUBMIT = JobKind("SUBMIT", "Writing a farm job", "an earlier job in the folder stays as it was", alone=True)
KINDS = {kind.name: kind for kind in (IMPORT, SHAPE, PACK, BAKE, MEASURE, WATER, BAKE_LAND, EXPORT, MAP, SUBMIT)}


class JobStopped(Exception):
    """The job was cancelled."""


class BackgroundJob:
    """Work in the background, while the window stays usable.

    It is in `running` from its creation until its steps have ended.

    Attributes:
        uid: session_uid of the job's terrain, None for a job of the whole file.
        file: path of the .blend file when the job began; the user may save it elsewhere meanwhile.
        fraction: progress, 0 .. 1.
        message: present step of the job, "" if its kind suffices.
        result: return value of the steps, None until they have ended well.
        error: why the job failed, "" if it did not.
        stopped: the job is to end at its next check.
        is_orphan: its terrain is gone.
        child: the child process that the job waits for, None if there is none.
        timer: Blender's timer that advances it, None without one.
    """

    def __init__(self, kind: JobKind, uid: int | None, steps: Callable[["BackgroundJob"], Steps]):
        """Create a job whose first step is run by the first `advance`. steps: returns the generator of the steps."""
        self.kind, self.uid, self.file = kind, uid, bpy.data.filepath
        self.fraction, self.message = 0.0, STARTING
        self.result, self.error = None, ""
        self.stopped = self.is_orphan = False
        self.child: ChildJob | None = None
        self.timer = None
        self._steps = steps(self)
        self._calls: queue.SimpleQueue[tuple[Future, Callable]] = queue.SimpleQueue()
        running.append(self)

    @property
    def text(self) -> str:
        """Return the name and the current step of the job, for places that show jobs of all kinds."""
        title, step = phrase(self.kind.title), CANCELLING if self.stopped else self.message
        return f"{title}: {phrase(step)}" if step else title

    def terrain(self):
        """Return the job's object, None if it is gone."""
        return next((obj for obj in session.all_terrains() if obj.session_uid == self.uid), None)

    def stop(self, error: str = "") -> None:
        """Ask the job to end at its next check, without a result.

        `error`: the reason that is shown, "" if the user cancelled it.
        """
        self.stopped, self.error = True, self.error or error
        if self.child is not None:
            self.child.cancel()

    def close(self) -> None:
        """End the job at once, before this returns, unless it has ended: its steps run their `finally` clauses."""
        if self in running:
            self.stop()
            self._steps.close()
            self._remove_from_running()

    def advance(self) -> bool:
        """Run the job up to its next pause; return whether it has ended.

        Then `result` or `error` is set; neither is after a cancellation.
        """
        try:
            next(self._steps)
            return False
        except StopIteration as end:
            self.result = end.value
        except JobStopped:
            pass
        except TerrainError as error:
            self.error = str(error)
        except Exception as error:
            traceback.print_exc()
            reason = f"{type(error).__name__}: {error}"
            self.error = f"{self.kind.title} failed unexpectedly ({reason}); {self.kind.stays}."
        self._remove_from_running()
        return True

    def _remove_from_running(self) -> None:
        """Remove the job from the list of running jobs, which the panels and `find` read."""
        if self in running:
            running.remove(self)

    def raise_if_stopped(self) -> None:
        """Raise JobStopped if the job was cancelled."""
        if self.stopped:
            raise JobStopped

    def progress(self, fraction: float, message: str = "") -> None:
        """Set the progress (0 .. 1), on any thread. Raises JobStopped once the job is to end."""
        self.raise_if_stopped()
        self.fraction, self.message = fraction, message

    def call_on_main(self, function: Callable):
        """Return `function()`, called on the main thread while the job's thread waits, or raise its exception.

        Raises JobStopped once the job is to end; the function may then be running still.
        """
        answer = Future()
        self._calls.put((answer, function))
        while not wait([answer], timeout=CALL_S).done:
            if self.stopped:
                answer.cancel()
                raise JobStopped
        return answer.result()

    def answer_calls(self) -> None:
        """Call the functions that the job's thread passed to `call_on_main`, on this thread, the main one."""
        while not (self.stopped or self._calls.empty()):
            answer, function = self._calls.get()
            if answer.set_running_or_notify_cancel():
                try:
                    answer.set_result(function())
                except Exception as error:
                    answer.set_exception(error)


running: list[BackgroundJob] = []


def find(kind: JobKind, obj=None) -> BackgroundJob | None:
    """Return the running job of a kind, None if none runs.

    `obj`: the terrain whose job it has to be; ignored if the kind runs only one job at a time, None for any
    terrain.
    """
    is_any = kind.alone or obj is None
    return next((job for job in running if job.kind is kind and (is_any or job.uid == obj.session_uid)), None)


def progress_shown() -> list[tuple[int, str]]:
    """Return progress and text of all running jobs as the panels show them: they are redrawn only if this changes."""
    return [(round(job.fraction * SHOWN_STEPS), job.text) for job in running]


def is_rendering() -> bool:
    """Return whether Blender renders on its own thread."""
    return bpy.app.is_job_running("RENDER")


def draw_progress(layout, job: BackgroundJob, text: str = ""):
    """Draw a row with the progress bar of a job and its cancel button; return the row.

    text: in the bar, by default the job's message; a cancelled job, which may end seconds later, has another.
    While the job renders there is no button, since only Esc ends a render at once.
    """
    row = layout.row(align=True)
    row.progress(factor=job.fraction, text=CANCELLING if job.stopped else text or job.message or job.kind.title)
    if job.kind is not MAP or not is_rendering():
        button = row.row(align=True)
        button.enabled = not job.stopped
        button.operator(CancelJob.bl_idname, text="", icon="CANCEL").kind = job.kind.name
    return row


def draw_button(layout, kind: JobKind, obj, operator: str, **options) -> None:
    """Draw the button of an operator, or the progress of its job in the same row, so that no row moves.

    obj: the terrain of the job. options: further arguments of `layout.operator`, such as text and icon.
    """
    if job := find(kind, obj):
        draw_progress(layout, job, job.text)
    else:
        layout.operator(operator, **options)


def redraw_panels() -> None:
    """Redraw the editors that show panels, and image editors, which show a render that waits."""
    shown = {"VIEW_3D": "UI", "PROPERTIES": "WINDOW", "IMAGE_EDITOR": "WINDOW"}
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions:
                if region.type == shown.get(area.type):
                    region.tag_redraw()


def run_on_thread(job: BackgroundJob, work: Callable[[], object]) -> Steps:
    """Run `work()` on a thread; yield until it has returned, and return its result or raise its exception.

    The main thread stays free for the window between the yields. If these steps are closed before, the job is stopped,
    and they wait for the end of the thread.
    """
    outcome = Future()

    def run() -> None:
        """Do the work and keep its result or its exception for the caller."""
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    thread = threading.Thread(target=run, name=f"adaptive_terrain_{job.kind.name.lower()}", daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            job.answer_calls()  # functions that `work` wants to be called on the main thread
            yield
    finally:
        if thread.is_alive():
            job.stop()
            thread.join()
    return outcome.result()


def run_in_child(
    job: BackgroundJob, child: ChildJob, on_preview: Callable[[dict], None] = lambda _preview: None
) -> Steps:
    """Yield until a child process has ended, and show its progress; return its report.

    on_preview: is called once with a report that the child makes before its long work, if it makes one. Raises
    JobStopped if it was cancelled, and the child's TerrainError. If these steps are closed before, the child is
    cancelled.
    """
    job.child, previewed = child, False
    try:
        while not (progress := child.poll()).done:
            job.fraction, job.message = progress.fraction, progress.message
            if progress.preview is not None and not previewed:
                previewed = True
                on_preview(progress.preview)
            yield
    finally:
        child.cancel()  # only if it still runs
        job.child = None
    if child.cancelled:
        raise JobStopped
    if progress.error is not None:
        raise progress.error
    return progress.report


def visit_frames(job: BackgroundJob, visits: Iterator) -> Steps:
    """Advance a generator that visits the frames of the scene, a few at a time so that the window responds.

    visits: yields a float after each frame, the fraction done, and as its last item the result, which this returns. It
    is closed in any case. Raises JobStopped if the job was cancelled, or undo has replaced the scene.
    """
    with closing(visits):  # its end returns the scene to the frame before
        turn_ends = time.monotonic() + TURN_S
        try:
            for found in visits:
                if not isinstance(found, float):
                    return found
                job.progress(found, LOOKING)
                if time.monotonic() >= turn_ends:
                    yield
                    job.raise_if_stopped()
                    turn_ends = time.monotonic() + TURN_S
        except ReferenceError:  # undo has replaced the scene, or the terrain is gone
            raise JobStopped from None


def wait_for_kernels(job: BackgroundJob) -> Steps:
    """Yield until the kernels that an update needs are compiled, and load them. Raises JobStopped."""
    while warmup.preparing():
        job.raise_if_stopped()
        yield
    warmup.wait()


def wait_with_result(job: BackgroundJob) -> Steps:
    """Yield until the kernels of an update that shows the job's result are compiled, and load them.

    A cancellation comes too late, because the files of the result are complete. Raises JobStopped only if the job's
    terrain is gone.
    """
    while warmup.preparing():
        if job.is_orphan:
            raise JobStopped
        yield
    warmup.wait()


def prepare_kernels(job: BackgroundJob, modules: Iterable[ModuleType]) -> Steps:
    """Yield until child processes have compiled some modules of kernels, and show their progress.

    modules: a collection, no iterator, because it is passed on at each step. Raises JobStopped.
    """
    while not warmup.prepare_modules(modules):
        job.progress(warmup.progress() or 0.0, PREPARING)
        yield
    yield from wait_for_kernels(job)


class CancelJob(bpy.types.Operator):
    """Cancel a job that runs beside the window"""

    bl_idname = "adaptive_terrain.cancel_job"
    bl_label = "Cancel"

    kind: bpy.props.EnumProperty(items=[(kind.name, kind.title, "") for kind in KINDS.values()])

    @classmethod
    def description(cls, _context, properties):
        """Return the tooltip of a cancel button, which says which part of the work stays."""
        return f"Cancel; {KINDS[properties.kind].stays}"

    @classmethod
    def poll(cls, _context):
        """Return whether any job runs."""
        return bool(running)

    def execute(self, context):
        """Stop the job that `find` returns for this kind and the active object, or report that it has ended."""
        job = find(KINDS[self.kind], context.object)
        if job is None:
            self.report({"INFO"}, f"{KINDS[self.kind].title} has ended already")
            return {"CANCELLED"}
        job.stop()
        return {"FINISHED"}


def stop_all() -> None:
    """End every job at once, because its operator is about to be unregistered."""
    for job in list(running):
        job.close()
        if job.timer is not None:
            bpy.context.window_manager.event_timer_remove(job.timer)
