# SPDX-License-Identifier: GPL-3.0-or-later
"""Measure Accuracy: a curve and the errors of the mesh are kept in the file; nothing half-measured ever is."""

import json
import math
import threading
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import pytest
from adaptive_terrain.cbt_terrain.accuracy import rows as rows_of_sweep
from adaptive_terrain.cbt_terrain.accuracy.cost_curve import CostCurve
from adaptive_terrain.cbt_terrain.accuracy.sweep_settings import PIXELS
from adaptive_terrain.operators import handlers, jobs
from adaptive_terrain.operators.accuracy import measure as measure_accuracy
from adaptive_terrain.operators.accuracy.measure import MeasureAccuracy, read_measured
from adaptive_terrain.operators.accuracy.panel import (
    StatisticsPanel,
    measured_lines,
    prediction_lines,
    statistics_lines,
)
from adaptive_terrain.operators.jobs import JobStopped
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain.request import gather
from modal_runs import running, to_the_end

OLD = CostCurve("px", (4.0, 1.0), (1000.0, 8000.0), (1.0, 5.0))


@pytest.fixture
def terrain(scene, add_terrain):
    """Add a terrain with an older cost curve, seen in a small picture: rays through its pixels take longest."""
    scene.render.resolution_percentage = 10
    obj = add_terrain()
    for detail in (obj.adaptive_terrain.viewport, obj.adaptive_terrain.render):
        detail.curve = OLD.to_json()
    return obj


@pytest.fixture(autouse=True)
def undisturbed(monkeypatch):
    """Accept any spread of the times, which other programs may disturb, and time each error once."""
    monkeypatch.setattr(rows_of_sweep, "MAX_SPREAD", math.inf)
    monkeypatch.setattr(measure_accuracy, "timed_runs", partial(measure_accuracy.timed_runs, count=1))


@pytest.fixture
def short(monkeypatch):
    """Limit the sweep to two errors."""
    monkeypatch.setattr(measure_accuracy, "PIXELS", (8.0, 2.0))


def curves(obj):
    return obj.adaptive_terrain.viewport.curve, obj.adaptive_terrain.render.curve


@pytest.fixture
def held(monkeypatch):
    """Hold a measurement at its first report until `go` is set; `reached` is set when it waits."""
    gate = SimpleNamespace(go=threading.Event(), reached=threading.Event())

    def measure_request(field, request, on_progress):
        on_progress(0.25, "waiting")
        gate.reached.set()
        gate.go.wait(60)
        on_progress(0.5, "going on")
        return measure_accuracy.Result(CostCurve("px", (2.0, 1.0), (1.0, 2.0), (1.0, 2.0)), MEASURED, "digest")

    monkeypatch.setattr(measure_accuracy, "measure_request", measure_request)
    yield gate
    gate.go.set()
    for job in list(jobs.running):
        job.close()


def some_errors():
    from adaptive_terrain.cbt_terrain.accuracy.measure import Measurement
    from adaptive_terrain.cbt_terrain.accuracy.mesh import Errors

    errors = Errors(count=10, max=0.5, p95=0.25, p999=0.5, mean=0.125, rms=0.1875)
    return Measurement(errors, 0.75, 1e-5, errors, errors, errors, Errors(0, 0.0, 0.0, 0.0, 0.0, 0.0), None)


MEASURED = some_errors()


def test_it_keeps_a_curve_and_errors_for_each_mode(terrain):
    settings = terrain.adaptive_terrain
    settings.viewport.error_px, settings.render.error_px = 3.0, 1.0
    assert bpy.ops.adaptive_terrain.measure_accuracy() == {"FINISHED"}
    viewport, render = (CostCurve.from_json(text) for text in curves(terrain))
    assert viewport.error == tuple(sorted({3.0, *PIXELS}, reverse=True)) and render.error == PIXELS
    update = session.update_object(terrain)
    assert dict(zip(viewport.error, viewport.triangles, strict=True))[3.0] == update.triangles
    assert 0.0 < read_measured(settings.viewport)["screen_px"]["max"] <= update.bound_px == 3.0
    status = session.record_of(terrain).status
    assert read_measured(settings.viewport)["digest"] == status.digest
    settings.viewport.error_px = 2.0
    session.update_object(terrain)
    assert read_measured(settings.viewport)["digest"] != session.record_of(terrain).status.digest


def test_the_file_keeps_what_was_measured(terrain, short, tmp_path):
    bpy.ops.adaptive_terrain.measure_accuracy()
    before = curves(terrain), terrain.adaptive_terrain.viewport.measured
    path = str(tmp_path / "measured.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    terrain = bpy.data.objects["Terrain"]
    assert (curves(terrain), terrain.adaptive_terrain.viewport.measured) == before
    assert before[0][0] != OLD.to_json()


def test_the_curve_costs_what_the_settings_cost(terrain, short):
    """Meshlets and other criteria stay as they are: only the error is swept."""
    terrain.adaptive_terrain.viewport.meshlet = 2
    terrain.adaptive_terrain.viewport.edge_px = 60.0
    bpy.ops.adaptive_terrain.measure_accuracy()
    terrain.adaptive_terrain.viewport.error_px = 8.0
    triangles = session.update_object(terrain).triangles
    curve = CostCurve.from_json(terrain.adaptive_terrain.viewport.curve)
    assert curve.at(8.0)[0] == pytest.approx(triangles)


def test_metres_are_swept_where_only_metres_are_asked(terrain, scene, monkeypatch):
    monkeypatch.setattr(measure_accuracy, "metre_steps", lambda relief_m: [relief_m / 8, relief_m / 16])
    scene.camera = None
    for detail in (terrain.adaptive_terrain.viewport, terrain.adaptive_terrain.render):
        detail.error_px, detail.error_m = 0.0, 3.0
    assert bpy.ops.adaptive_terrain.measure_accuracy() == {"FINISHED"}
    curve = CostCurve.from_json(terrain.adaptive_terrain.viewport.curve)
    assert curve.unit == "m" and 3.0 in curve.error
    measured = read_measured(terrain.adaptive_terrain.viewport)
    assert 0.0 < measured["vertical_max_m"] <= 3.0 and measured["screen_px"] is None


def test_one_mode_is_measured_where_the_other_cannot_be(terrain, short):
    terrain.adaptive_terrain.render.error_px, terrain.adaptive_terrain.render.edge_px = 0.0, 50.0
    assert bpy.ops.adaptive_terrain.measure_accuracy() == {"FINISHED"}
    viewport, render = curves(terrain)
    assert viewport != OLD.to_json() == render


def test_the_thread_beside_the_window_measures_the_same(terrain, short):
    operator = running(MeasureAccuracy, terrain)
    assert operator.began == {"RUNNING_MODAL"}
    assert not MeasureAccuracy.poll(SimpleNamespace(object=terrain)), "one at a time"
    assert to_the_end(operator) == {"FINISHED"}
    curve = CostCurve.from_json(terrain.adaptive_terrain.viewport.curve)
    assert curve.error == (8.0, 2.0, 1.0) and not jobs.running
    [viewport, render] = [call.args for call in operator.report.call_args_list]
    largest = read_measured(terrain.adaptive_terrain.viewport)["screen_px"]["max"]
    assert viewport[0] == {"INFO"} and f"Viewport: measured at most {largest:.3g} px" in viewport[1]
    assert render[1].startswith("Render: measured at most ")


def test_a_cancelled_measurement_leaves_the_old_curve(terrain, held):
    operator = running(MeasureAccuracy, terrain)
    assert held.reached.wait(60)
    layout = draw(terrain)
    layout.row().progress.assert_called_once_with(factor=0.125, text="Viewport: waiting")
    with bpy.context.temp_override(object=terrain):
        assert bpy.ops.adaptive_terrain.cancel_job(kind="MEASURE") == {"FINISHED"}
    held.go.set()
    assert to_the_end(operator) == {"CANCELLED"}
    assert curves(terrain) == (OLD.to_json(), OLD.to_json()) and session.record_of(terrain).status.error == ""


def test_undo_stops_it_and_leaves_the_old_curve(terrain, held):
    operator = running(MeasureAccuracy, terrain)
    assert held.reached.wait(60)
    handlers.on_undo(None)
    held.go.set()
    assert to_the_end(operator) == {"CANCELLED"}
    assert curves(terrain) == (OLD.to_json(), OLD.to_json())


def test_cancel_waits_for_one_update_at_most(terrain):
    """Also between the runs of one error."""
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    field, reports = session.open_field(request.store), []

    def on_progress(fraction, message):
        reports.append(message)
        if len(reports) == 3:
            raise JobStopped

    with pytest.raises(JobStopped):
        measure_accuracy.measure_request(field, request, on_progress)
    assert reports == ["time at 16 px"] * 3


def test_a_terrain_that_is_gone_is_left_alone(terrain, held):
    operator = running(MeasureAccuracy, terrain)
    assert held.reached.wait(60)
    bpy.data.objects.remove(terrain)
    held.go.set()
    assert to_the_end(operator) == {"CANCELLED"}


def test_an_opened_file_ends_it(terrain, held):
    operator = running(MeasureAccuracy, terrain)
    assert held.reached.wait(60)
    threading.Timer(0.1, held.go.set).start()
    operator.cancel(operator.context)
    assert operator.job.result is None and not jobs.running
    assert not [thread for thread in threading.enumerate() if thread.name == "adaptive_terrain_measure"]


def test_what_is_wrong_is_told(terrain, store, monkeypatch):
    for detail in (terrain.adaptive_terrain.viewport, terrain.adaptive_terrain.render):
        detail.error_px, detail.edge_px = 0.0, 40.0
    with pytest.raises(RuntimeError, match="Screen Error or Vertical Error"):
        bpy.ops.adaptive_terrain.measure_accuracy()
    terrain.adaptive_terrain.viewport.error_px = 1.0
    terrain.adaptive_terrain.store = "/nowhere/at/all"
    with pytest.raises(RuntimeError, match="no terrain store"):
        bpy.ops.adaptive_terrain.measure_accuracy()
    assert session.record_of(terrain).status.error == ""  # the panel would call the terrain not up to date
    terrain.adaptive_terrain.store = store
    monkeypatch.setattr(measure_accuracy, "measure_request", lambda *arguments: 1 / 0)
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        bpy.ops.adaptive_terrain.measure_accuracy()
    assert curves(terrain) == (OLD.to_json(), OLD.to_json())


def test_errors_that_take_too_many_triangles_are_left_out(terrain, monkeypatch):
    limit = session.update_object(terrain).triangles  # of 1 px
    monkeypatch.setattr(measure_accuracy, "MAX_TRIANGLES", limit)
    assert bpy.ops.adaptive_terrain.measure_accuracy() == {"FINISHED"}
    curve = CostCurve.from_json(terrain.adaptive_terrain.viewport.curve)
    assert curve.error == (16.0, 8.0, 4.0, 2.0, 1.0) and curve.triangles[-1] == limit
    monkeypatch.setattr(measure_accuracy, "MAX_TRIANGLES", 10)
    with pytest.raises(RuntimeError, match="An error of 16 px takes more than 10 triangles"):
        bpy.ops.adaptive_terrain.measure_accuracy()
    assert CostCurve.from_json(terrain.adaptive_terrain.viewport.curve) == curve


def disturbed(monkeypatch, factors):
    """Make the runs of each further measurement of an error differ by the next factor, at last by the last one."""
    factors = list(factors)

    def timed_runs(terrain, criterion, frame, write):
        write()
        factor = factors.pop(0) if len(factors) > 1 else factors[0]
        return [{"total": 5.0, "cpu": 10.0}, {"total": 5.0, "cpu": 10.0 * factor}]

    monkeypatch.setattr(rows_of_sweep, "MAX_SPREAD", 2.0)
    monkeypatch.setattr(measure_accuracy, "timed_runs", timed_runs)


def test_runs_that_disagree_leave_no_curve_and_say_why(terrain, short, monkeypatch):
    terrain.adaptive_terrain.viewport.limit_time = True
    terrain.adaptive_terrain.viewport.error_px = 4.0
    disturbed(monkeypatch, [1.0, 1.5, 2.5])  # steady at 8 and 4 px, never at 2 px
    operator = running(MeasureAccuracy, terrain)
    assert to_the_end(operator) == {"FINISHED"}
    reason = "at 2 px runs of the same update took 10 to 25 ms of CPU"
    reports = [call.args for call in operator.report.call_args_list]
    assert [kind for kind, text in reports if reason in text and text.startswith("Viewport: ")] == [{"WARNING"}]
    assert curves(terrain)[0] == "" and reason in terrain.adaptive_terrain.viewport.no_curve
    # The budget falls back to the error asked for, of which the errors are kept, and there is one message.
    update = session.update_object(terrain)
    status = session.record_of(terrain).status
    assert status.request.criterion.error_px == 4.0 and "Measure Accuracy again" in status.request.note
    measured = read_measured(terrain.adaptive_terrain.viewport)
    assert measured["digest"] == status.digest and 0.0 < measured["screen_px"]["max"] <= update.bound_px == 4.0
    labels = " ".join(call.kwargs["text"] for call in draw(terrain).box().column().label.mock_calls)
    assert reason in labels and "Time budget needs a curve, but times differed: Measure Accuracy again" in labels
    # A later measurement that is not disturbed takes all of that back.
    disturbed(monkeypatch, [1.0])
    assert bpy.ops.adaptive_terrain.measure_accuracy() == {"FINISHED"}
    assert CostCurve.from_json(curves(terrain)[0]).ms == (5.0, 5.0, 5.0)
    assert terrain.adaptive_terrain.viewport.no_curve == ""
    session.update_object(terrain)
    assert session.record_of(terrain).status.request.note == ""


def test_runs_that_were_disturbed_once_are_repeated(terrain, short, monkeypatch):
    disturbed(monkeypatch, [3.0, 2.1, 1.5])
    assert bpy.ops.adaptive_terrain.measure_accuracy() == {"FINISHED"}
    assert [CostCurve.from_json(curve).ms for curve in curves(terrain)] == [(5.0,) * 3] * 2
    assert terrain.adaptive_terrain.viewport.no_curve == ""


def draw(terrain):
    """Draw the panel Last Update into a mock layout."""
    layout = Mock()
    panel = SimpleNamespace(layout=layout, _columns=lambda: layout)
    draw_measured = StatisticsPanel._draw_measured_and_predicted
    panel._draw_measured_and_predicted = lambda *arguments: draw_measured(panel, *arguments)
    StatisticsPanel.draw(panel, SimpleNamespace(object=terrain))
    return layout


def labels(layout):
    return [call.kwargs["text"] for call in layout.mock_calls if call[0].endswith("label")]


def test_without_a_curve_the_panel_shows_the_button_alone(scene, add_terrain):
    terrain = add_terrain()
    session.update_object(terrain)
    layout = draw(terrain)
    assert not [text for text in labels(layout) if "~" in text or "largest" in text]
    layout.operator.assert_called_once_with("adaptive_terrain.measure_accuracy", icon="DRIVER_DISTANCE")


def test_measured_errors_are_shown_for_their_mesh_only(terrain, short):
    bpy.ops.adaptive_terrain.measure_accuracy()
    session.update_object(terrain)
    assert {"Measured", "Screen (px)", "Vertical (m)"} <= set(labels(draw(terrain)))
    terrain.location.x = 5.0
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert "Measured" not in labels(draw(terrain))
    assert [text[:6] for text in labels(draw(terrain)) if "~" in text] == ["0.5 px", "2 px: "]


def test_a_damaged_curve_is_told_and_gives_no_number(terrain):
    terrain.adaptive_terrain.viewport.curve = '{"unit": "px"}'
    session.update_object(terrain)
    for measured in (
        "[1, 2",
        "[1, 2]",
        "[" * 100_000,
        json.dumps({"digest": session.record_of(terrain).status.digest}),
    ):
        terrain.adaptive_terrain.viewport.measured = measured
        shown = labels(draw(terrain))
        assert "damaged" in " ".join(shown) and not {"~", "Measured"} & set(" ".join(shown).split())


def status_of(terrain, **changes):
    session.update_object(terrain)
    status = session.record_of(terrain).status
    for name, value in changes.items():
        setattr(status, name, value)
    return status


def test_the_curve_is_exact_for_the_measured_mesh(terrain):
    curve = CostCurve("px", (4.0, 1.0, 0.25), (1000.0, 16_000.0, 256_000.0), (2.0, 8.0, 32.0))
    lines = prediction_lines(status_of(terrain, triangles=1), curve, exact=True)
    assert lines == ["0.5 px: ~64,000 triangles, ~16 ms", "2 px: ~4,000 triangles, ~4 ms"]


def test_the_curve_is_scaled_to_go_through_any_other_update(terrain):
    curve = CostCurve("px", (4.0, 1.0, 0.25), (1000.0, 16_000.0, 256_000.0), (2.0, 8.0, 32.0))
    status = status_of(terrain, triangles=160_000, changed=True, ms={"total": 24.0})
    lines = prediction_lines(status, curve, exact=False)
    assert lines == ["0.5 px: ~640,000 triangles, ~48 ms", "2 px: ~40,000 triangles, ~12 ms"]
    status = status_of(terrain, triangles=160_000, changed=False, ms={"total": 0.5})
    assert prediction_lines(status, curve, exact=False)[1] == "2 px: ~40,000 triangles, ~4 ms"
    status.bounds = replace(status.bounds, relaxed=2.0)  # a triangle limit: the mesh has the error of 2 px
    assert [line.split(":")[0] for line in prediction_lines(status, curve, exact=False)] == ["1 px", "4 px"]


def test_a_curve_in_another_unit_predicts_nothing(terrain):
    curve = CostCurve("m", (4.0, 1.0), (1000.0, 16_000.0), (2.0, 8.0))
    assert prediction_lines(status_of(terrain), curve, exact=False) == []


def test_every_measured_figure_has_its_unit():
    from dataclasses import asdict

    lines = {name: figures for name, *figures in measured_lines(json.loads(json.dumps(asdict(MEASURED))))}
    assert lines.pop("Measured") == ["largest", "95 %"]
    assert (
        lines["Screen (px)"] == lines["Facet normal (°)"] == ["0.5", "0.25"] and lines["Rounding (m)"][0] == "< 0.001"
    )
    assert lines["Vertical (m)"] == ["0.75", "0.25"], "the largest of the whole surface"
    assert all(name.endswith(("(px)", "(m)", "(°)")) for name in lines)
    assert not [name for name in lines if name.startswith(("Silhouette", "Hidden"))], "none was in the frame"


def test_the_last_update_says_what_was_asked(terrain):
    assert dict(statistics_lines(status_of(terrain)))["Asked"] == "1 px"
