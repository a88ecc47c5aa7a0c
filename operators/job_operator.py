# SPDX-License-Identifier: GPL-3.0-or-later
"""The bases of operators that run a job (jobs.py)."""

import time

import bpy
from bpy_extras.io_utils import ExportHelper

from ..cbt_terrain.errors import TerrainError
from ..cbt_terrain.run import stopping
from . import jobs
from .session import session
from .session.polls import cancelled_by_errors, invoke_with_file, on_terrain, on_terrain_object


class JobOperator:
    """Base of operators that run a job: in the background when they are invoked, at once when a script calls them.

    A subclass has `kind`, a JobKind; `steps(context, job)`, which does the work and returns a result that is not None;
    and `finish(context, obj, result)`, which puts the result into the file. `context` of `steps` is that of the first
    step only. One that leaves the terrain as it is has `shows_error_on_panel = False`: its errors are only reported,
    and the panel keeps that of the last update. One that runs in Object Mode only has `needs_object_mode = True`.

    Attributes:
        job: the BackgroundJob, None before it is started.
        poll_s: seconds between ticks of the timer.
        beside_window: whether the operator was invoked, so that its job runs in the background.
        shown, looked: progress when panels were last redrawn, and time when the terrain was last looked for.
    """

    poll_s = jobs.POLL_S
    shows_error_on_panel = True
    needs_object_mode = False
    beside_window = False
    job: jobs.BackgroundJob | None = None

    @classmethod
    def poll(cls, context):
        """Return whether the active object is a terrain without such a job; otherwise set the reason to show."""
        if not (on_terrain_object if cls.needs_object_mode else on_terrain)(cls, context):
            return False
        cls.poll_message_set(f"{cls.kind.title} is under way: wait for it, or cancel it beside its progress bar")
        return jobs.find(cls.kind, context.object) is None

    def invoke(self, context, event):
        """Start the job, and continue it with a timer while the user works, unless its first step ends it."""
        self.beside_window = True
        self._start_job(context)
        if self.job.advance():
            return self._report_end(context)
        self.shown, self.looked = None, 0.0
        self.job.timer = context.window_manager.event_timer_add(self.poll_s, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Advance the job at each tick of the timer, redraw progress bars, and report the result at the end.

        Escape cancels it if `stops_on_escape`; a terrain that is gone does, too.
        """
        if event.type == "ESC" and event.value == "PRESS" and self.stops_on_escape():
            self.job.stop()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if time.monotonic() - self.looked >= jobs.POLL_S / 2:  # not at each tick of a fast timer
            self.looked = time.monotonic()
            self._stop_if_terrain_is_gone()
        ended = self.job.advance()
        if self.shown != (shown := jobs.progress_shown()):
            self.shown = shown
            jobs.redraw_panels()
        return self._report_end(context) if ended else {"PASS_THROUGH"}

    def execute(self, context):
        """Run the job to its end before returning: a script calls it, and Ctrl-C stops it."""
        self._start_job(context)
        with stopping.listening():
            try:
                while not self.job.advance():
                    stopping.check()
                    time.sleep(jobs.CALL_S)
            finally:
                self.job.close()
        return self._report_end(context)

    def cancel(self, context):
        """End the job because another file is opened or Blender quits; none has begun if a file dialog is cancelled."""
        if self.job is not None:
            self.job.close()
            self._remove_timer(context)

    def stops_on_escape(self) -> bool:
        """Return whether Escape cancels the job now."""
        return False

    def abandon(self) -> None:
        """React to the removal of the job's terrain from the file. A subclass overrides it if needed."""

    def subject(self, context):
        """Return the job's terrain, None for a job of the whole file."""
        return context.object

    def fail(self, obj, message: str):
        """Report an error, and keep it for the panel of the terrain, if there is one; return Blender's result set."""
        if obj is not None and self.shows_error_on_panel:
            session.record_of(obj).status.error = message
        self.report({"ERROR"}, message)
        return {"CANCELLED"}

    def _start_job(self, context) -> None:
        """Clear the terrain's last error if the panel shows errors of the job, and create it; no step has run yet."""
        obj = self.subject(context)
        if obj is not None and self.shows_error_on_panel:
            session.record_of(obj).status.error = ""
        uid = None if obj is None else obj.session_uid
        self.job = jobs.BackgroundJob(self.kind, uid, lambda job: self.steps(context, job))

    def _stop_if_terrain_is_gone(self) -> None:
        """Stop the job once its terrain is no longer in the file."""
        job = self.job
        if job.uid is not None and not job.is_orphan and job.terrain() is None:
            job.is_orphan = True
            job.stop()

    def _remove_timer(self, context) -> None:
        """Remove the timer that advances the job, and redraw the panels without its progress bar."""
        if self.job.timer is not None:
            context.window_manager.event_timer_remove(self.job.timer)
            self.job.timer = None
        jobs.redraw_panels()

    def _report_end(self, context):
        """Pass the result of an ended job to `finish`, or report its error or cancellation; return Blender's
        result set.
        """
        self._remove_timer(context)
        job = self.job
        obj = job.terrain()
        if job.uid is not None and obj is None:
            self.abandon()  # lets a subclass react to the removal of the terrain
            return {"CANCELLED"}
        if job.result is not None:
            self.finish(context, obj, job.result)
            if job.stopped:  # a first picture or other parts that are worth keeping
                self.report({"INFO"}, f"{self.kind.title} was cancelled; the finished part stays")
            return {"FINISHED"}
        if job.error:
            return self.fail(obj, job.error)
        self.report({"INFO"}, f"{self.kind.title} was cancelled; {self.kind.stays}")
        return {"CANCELLED"}


class DialogJobOperator(JobOperator):
    """Base of operators that show a dialog, and then run a job with the chosen options.

    A subclass also has `ask(context, event)`, which shows the dialog and may raise TerrainError.
    """

    shows_error_on_panel = False

    # Set when the operator is run again with the chosen options, once the kernels are ready (session/polls.py).
    is_chosen: bpy.props.BoolProperty(options={"HIDDEN", "SKIP_SAVE"})

    def invoke(self, context, event):
        """Show the dialog, or start the job once the options are chosen."""
        if self.is_chosen:
            return JobOperator.invoke(self, context, event)
        try:
            return self.ask(context, event)
        except TerrainError as error:
            return self.fail(self.subject(context), str(error))

    @cancelled_by_errors
    def execute(self, context):
        """Write before returning when a script calls it. After the dialog, invoke the operator that runs the job."""
        if not self.options.is_invoke:
            return JobOperator.execute(self, context)
        return invoke_with_file(self, context)


class FileJobOperator(DialogJobOperator, ExportHelper):
    """Base of operators that ask for a file and write it in a job.

    A subclass also has `propose(context)`, which proposes a file to the dialog and may raise TerrainError.
    """

    def ask(self, context, event):
        """Show the file dialog with the proposed file."""
        self.propose(context)
        return ExportHelper.invoke(self, context, event)
