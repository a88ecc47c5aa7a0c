# SPDX-License-Identifier: GPL-3.0-or-later
"""Measurements on a thread while the window stays usable, one at a time because they measure times."""

from ...cbt_terrain.errors import TerrainError
from .. import jobs
from ..job_operator import JobOperator


def error_while_rendering() -> TerrainError:
    """Return the error for a measurement during a render."""
    fix = "measure again when it has finished"
    return TerrainError("Blender is rendering, which would disturb the measured times", fix=fix)


def stop_measurement() -> None:
    """Stop the measurement that runs, if any, because an undo may have changed its terrain."""
    if job := jobs.find(jobs.MEASURE):
        job.stop()


class MeasuringOperator(JobOperator):
    """Base of operators that measure.

    A subclass has `prepare(context)`, which returns a function of the job that measures on a thread, or raises
    TerrainError. It may have `clean_up()`, called however the measurement ends once `prepare` has returned.
    """

    kind = jobs.MEASURE
    shows_error_on_panel = False
    poll_s = jobs.CALL_S  # its thread may ask for calls on the main one between timed runs

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Prepare the measurement, wait for kernels, and measure on a thread; return its result.

        Raises TerrainError if Blender renders or if `prepare` fails; `clean_up` is not called then.
        """
        if jobs.is_rendering():
            raise error_while_rendering()
        measure = self.prepare(context)
        try:
            yield from jobs.wait_for_kernels(job)
            return (yield from jobs.run_on_thread(job, lambda: measure(job)))
        finally:
            self.clean_up()

    def modal(self, context, event):
        """Continue the job, but once a render starts, stop it with an error at its next check."""
        if jobs.is_rendering() and not self.job.stopped:
            self.job.stop(str(error_while_rendering()))
        return JobOperator.modal(self, context, event)

    def clean_up(self) -> None:
        """Remove the measurement's data from the file. A subclass overrides it if needed."""

    def abandon(self) -> None:
        """Report that the measurement was dropped because its terrain was removed."""
        self.report({"INFO"}, "The terrain is gone; its measurement was dropped")
