# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs beside the window: progress, cancelling, errors and threads."""

import threading
import time
from types import SimpleNamespace

import bpy
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators import jobs
from adaptive_terrain.operators.job_operator import JobOperator
from drawn_panels import DrawnLayout


@pytest.fixture(autouse=True)
def no_job_is_left(empty):
    yield
    left = list(jobs.running)
    for job in left:
        job.close()
    assert not left and not threads()


def threads():
    return [thread for thread in threading.enumerate() if thread.name.startswith("adaptive_terrain_bake")]


def endless(job):
    while True:
        job.raise_if_stopped()
        yield


def on_thread(work):
    return jobs.BackgroundJob(jobs.BAKE, None, lambda job: jobs.run_on_thread(job, lambda: work(job)))


def to_the_end(job):
    end = time.monotonic() + 60
    while not job.advance():
        assert time.monotonic() < end
        time.sleep(0.002)


def test_cancel_ends_the_job_of_the_active_terrain(scene, add_terrain):
    first, second = (add_terrain(name) for name in ("First", "Second"))
    imports = [jobs.BackgroundJob(jobs.IMPORT, obj.session_uid, endless) for obj in (first, second)]
    packing = jobs.BackgroundJob(jobs.PACK, None, endless)
    bpy.context.view_layer.objects.active = second
    for kind, ended in (("IMPORT", imports[1]), ("PACK", packing)):
        assert bpy.ops.adaptive_terrain.cancel_job(kind=kind) == {"FINISHED"}
        assert [job for job in list(jobs.running) if job.stopped and job.advance()] == [ended]
    assert jobs.running == imports[:1]
    assert bpy.ops.adaptive_terrain.cancel_job(kind="PACK") == {"CANCELLED"}, "nothing is packed any more"
    imports[0].close()
    assert not bpy.ops.adaptive_terrain.cancel_job.poll()


def test_a_cancelled_job_says_so_until_it_ends():
    job = jobs.BackgroundJob(jobs.BAKE, None, endless)
    job.advance()
    for is_stopped, text in ((False, "Baking maps: Starting"), (True, "Baking maps: Cancelling")):
        layout = DrawnLayout()
        jobs.draw_progress(layout, job, "Loaded to 80 m here")
        assert ("Cancelling" in layout.texts) is is_stopped and job.text == text
        job.stop()
    job.advance()


@pytest.mark.parametrize("kind", jobs.KINDS)
def test_the_cancel_button_names_what_stays(kind):
    text = jobs.CancelJob.description(None, SimpleNamespace(kind=kind))
    assert text == f"Cancel; {jobs.KINDS[kind].stays}" and ("stay" in text or "kept" in text)


def test_a_result_and_calls_come_from_the_right_threads():
    progress = []

    def work(job):
        job.progress(0.5, "half")
        progress.append(job.text)
        return job.call_on_main(threading.current_thread), threading.current_thread()

    job = on_thread(work)
    to_the_end(job)
    main, other = job.result
    assert main is threading.main_thread() and other.name == "adaptive_terrain_bake"
    assert progress == ["Baking maps: half"] and (job.fraction, job.error) == (0.5, "")


def test_an_error_in_a_call_reaches_the_thread():
    job = on_thread(lambda job: job.call_on_main(lambda: 1 / 0))
    to_the_end(job)
    assert job.result is None
    assert job.error == (
        "Baking maps failed unexpectedly (ZeroDivisionError: division by zero); the maps stay as they were."
    )


def test_a_terrain_error_is_the_error_of_the_job():
    def fail(_job):
        raise TerrainError("The disk is full", fix="make room")

    job = on_thread(fail)
    to_the_end(job)
    assert (job.result, job.error) == (None, "The disk is full: make room.")


def test_a_script_gets_no_report_of_a_cancellation():
    """A script runs a job to its end; the operator then closes it, which cancels nothing."""
    reports, finished = [], []

    class Operator(JobOperator):
        kind = jobs.BAKE
        subject = staticmethod(lambda _context: None)
        steps = staticmethod(lambda _context, job: jobs.run_on_thread(job, lambda: "maps"))
        finish = staticmethod(lambda _context, _obj, result: finished.append(result))
        report = staticmethod(lambda *report: reports.append(report))

    assert Operator().execute(bpy.context) == {"FINISHED"}
    assert finished == ["maps"] and reports == []


def test_closing_a_job_waits_for_its_thread():
    reached = threading.Event()

    def work(job):
        while True:
            reached.set()
            job.progress(0.0)
            time.sleep(0.01)

    job = on_thread(work)
    assert not job.advance() and reached.wait(60) and threads()
    job.close()
    assert not threads() and not jobs.running and (job.result, job.error) == (None, "")


def test_a_stop_with_a_reason_is_an_error():
    job = jobs.BackgroundJob(jobs.MEASURE, None, endless)
    assert not job.advance()
    job.stop("Blender is rendering.")
    assert job.advance() and job.error == "Blender is rendering."


@pytest.mark.parametrize("published", [False, True])
def test_a_child_that_ended_before_its_cancel_counts(published):
    report = {"filled": 0}
    child = SimpleNamespace(cancelled=False)
    states = [SimpleNamespace(done=False, fraction=0.25, message="Reading", preview=None)]
    child.poll = lambda: states[-1]

    def cancel():
        child.cancelled = not published
        error = None if published else "cancelled"
        states.append(SimpleNamespace(done=True, error=error, report=report if published else None))

    child.cancel = cancel
    job = jobs.BackgroundJob(jobs.IMPORT, None, lambda job: jobs.run_in_child(job, child))
    assert not job.advance() and (job.fraction, job.text) == (0.25, "Importing: Reading")
    job.stop()
    assert job.advance() and job.result == (report if published else None) and not job.error


def test_frames_are_visited_until_a_turn_is_over(monkeypatch):
    closed = []

    now = [0.0]
    monkeypatch.setattr(jobs, "time", SimpleNamespace(monotonic=lambda: now[0]))

    def visits():
        try:
            for number in range(10):
                now[0] += 0.01
                yield number / 10
            yield "views"
        finally:
            closed.append(True)

    monkeypatch.setattr(jobs, "TURN_S", 0.025)
    job = jobs.BackgroundJob(jobs.BAKE, None, lambda job: jobs.visit_frames(job, visits()))
    assert not job.advance() and job.fraction == 0.2 and job.message == "Looking at frames"
    to_the_end(job)
    assert job.result == "views" and closed == [True]
    job = jobs.BackgroundJob(jobs.BAKE, None, lambda job: jobs.visit_frames(job, visits()))
    job.advance()
    job.stop()
    assert job.advance() and job.result is None and closed == [True, True]


@pytest.mark.parametrize("wait", [jobs.wait_for_kernels, lambda job: jobs.prepare_kernels(job, [])])
def test_a_cancel_does_not_wait_for_kernels(wait, preparing):
    job = jobs.BackgroundJob(jobs.MEASURE, None, wait)
    assert not job.advance() and not job.advance()
    job.stop()
    assert job.advance() and job.error == "" and not preparing.done.is_set()


def test_a_complete_result_is_not_cancelled(preparing):
    """Its files have been renamed into place, so it cannot be said that the store stays as it was."""
    job = jobs.BackgroundJob(jobs.IMPORT, None, jobs.wait_with_result)
    job.stop()
    assert not job.advance()
    preparing.done.set()
    to_the_end(job)
    orphan = jobs.BackgroundJob(jobs.IMPORT, None, jobs.wait_with_result)
    preparing.done.clear()
    orphan.is_orphan = True
    assert orphan.advance()
