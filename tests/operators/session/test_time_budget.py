# SPDX-License-Identifier: GPL-3.0-or-later
"""The time budget uses the finest error that fits the stored curve; the live viewport corrects it."""

import math
from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import bpy
import pytest
from adaptive_terrain.cbt_terrain.accuracy import rows as rows_of_sweep
from adaptive_terrain.cbt_terrain.accuracy.cost_curve import CostCurve
from adaptive_terrain.operators.session import live, session
from adaptive_terrain.operators.terrain.overrides import Overrides
from adaptive_terrain.operators.terrain.panel import ViewportPanel
from adaptive_terrain.operators.terrain.request import RENDER, VIEWPORT, gather
from blender_meshes import positions
from drawn_panels import draw_mocked
from live_windows import show_window

CURVE = CostCurve("px", (16.0, 4.0, 1.0), (500.0, 2000.0, 8000.0), (1.0, 4.0, 16.0))


@pytest.fixture
def terrain(scene, add_terrain):
    obj = add_terrain()
    for detail, ms in ((obj.adaptive_terrain.viewport, 2.0), (obj.adaptive_terrain.render, 8.0)):
        detail.limit_time, detail.max_ms, detail.curve = True, ms, CURVE.to_json()
    bpy.context.view_layer.update()
    return obj


def request_of(terrain, mode=VIEWPORT):
    return gather(terrain, bpy.context.evaluated_depsgraph_get(), mode)


def test_the_finest_error_that_fits_is_asked_for_in_each_mode(terrain):
    assert request_of(terrain).criterion.error_px == CURVE.error_for_ms(2.0) == pytest.approx(8.0, rel=1e-3)
    assert request_of(terrain, RENDER).criterion.error_px == pytest.approx(2.0, rel=1e-3)
    assert request_of(terrain).note == ""


def test_the_error_is_finer_than_asked_where_there_is_time(terrain):
    terrain.adaptive_terrain.viewport.error_px = 12.0
    bpy.context.view_layer.update()
    assert request_of(terrain).criterion.error_px == pytest.approx(8.0, rel=1e-3)


def test_the_mesh_depends_on_no_clock(terrain):
    session.update_object(terrain)
    first = positions(terrain).tobytes()
    for slowness in (0.01, 1000.0):  # times of later updates
        session.record_of(terrain).status.ms["total"] = slowness
        terrain.data.clear_geometry()
        session.update_object(terrain)
        assert positions(terrain).tobytes() == first
    session.clear()
    session.update_object(terrain)
    assert positions(terrain).tobytes() == first and len(terrain.data.polygons) > 100
    terrain.adaptive_terrain.viewport.max_ms = 8.0
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert positions(terrain).tobytes() != first


def test_metres_are_budgeted_where_only_metres_are_asked(terrain):
    detail = terrain.adaptive_terrain.viewport
    detail.error_px, detail.error_m = 0.0, 1.0
    detail.curve = CostCurve("m", (8.0, 2.0), (500.0, 2000.0), (1.0, 4.0)).to_json()
    bpy.context.view_layer.update()
    criterion = request_of(terrain).criterion
    assert (criterion.error_px, criterion.error_m) == (0.0, pytest.approx(4.0, rel=1e-3))


@pytest.mark.parametrize(
    ("curve", "settings", "message"),
    [
        ("", {}, "Time budget needs a measured curve: press Measure Accuracy"),
        ("{", {}, "damaged"),
        (CURVE.to_json(), {"error_px": 0.0, "error_m": 2.0}, "a curve measured in m"),
        (CURVE.to_json(), {"error_px": 0.0, "edge_px": 50.0}, "needs an error to vary"),
    ],
)
def test_the_criterion_is_used_if_the_budget_cannot_be(terrain, curve, settings, message):
    detail = terrain.adaptive_terrain.viewport
    detail.curve = curve
    for name, value in settings.items():
        setattr(detail, name, value)
    bpy.context.view_layer.update()
    request = request_of(terrain)
    assert message in request.note
    for name in ("error_px", "error_m", "edge_px"):
        assert getattr(request.criterion, name) == getattr(detail, name)
    session.update_object(terrain)
    assert message in session.record_of(terrain).status.request.note


def test_an_error_from_the_command_line_comes_before_the_budget(terrain):
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert gather(terrain, depsgraph, RENDER, overrides=Overrides({"error_px": 3.0})).criterion.error_px == 3.0
    unlike = gather(terrain, depsgraph, RENDER, overrides=Overrides({"meshlet": 2})).criterion
    assert unlike.meshlet == 2 and unlike.error_px == request_of(terrain, RENDER).criterion.error_px != 3.0


def draw(terrain):
    calls = draw_mocked(ViewportPanel, terrain).mock_calls
    texts = [call.kwargs["text"] for call in calls if call[0].endswith("label")]
    return [text for text in texts if text != "off"]


def test_the_panel_says_which_error_fits_or_what_is_missing(terrain):
    assert draw(terrain) == [f"Finest error that fits: {CURVE.error_for_ms(2.0):.4g} px", ""], "always two lines"
    detail, beyond = terrain.adaptive_terrain.viewport, "Beyond the measured errors"
    detail.max_ms = 1e5
    assert draw(terrain) == [f"Finest error that fits: {CURVE.error[-1] / 4:.4g} px.", beyond]
    detail.max_ms = 1e-3
    assert draw(terrain) == [f"None fits; coarsest error: {CURVE.error[0] * 16:.4g} px.", beyond]
    terrain.adaptive_terrain.viewport.curve = ""
    assert " ".join(draw(terrain)) == "Time budget needs a measured curve: press Measure Accuracy"
    detail.no_curve = "at 2 px runs of the same update took 10 to 25 ms"
    assert draw(terrain) == ["Time budget needs a curve, but times", "differed: Measure Accuracy again"]
    terrain.adaptive_terrain.viewport.limit_time = False
    assert draw(terrain) == []


def test_a_new_curve_is_followed_and_measured_for(terrain, monkeypatch):
    """Measure Accuracy keeps the errors of the mesh that its new curve gives."""
    from adaptive_terrain.operators.accuracy import measure as measure_accuracy
    from adaptive_terrain.operators.accuracy.measure import read_measured

    monkeypatch.setattr(measure_accuracy, "PIXELS", (16.0, 4.0, 1.0))
    monkeypatch.setattr(measure_accuracy, "timed_runs", partial(measure_accuracy.timed_runs, count=1))
    monkeypatch.setattr(rows_of_sweep, "MAX_SPREAD", math.inf)  # other programs may disturb the times
    assert bpy.ops.adaptive_terrain.measure_accuracy() == {"FINISHED"}
    detail = terrain.adaptive_terrain.viewport
    assert detail.curve != CURVE.to_json()
    session.update_object(terrain)
    status = session.record_of(terrain).status
    assert status.request.criterion.error_px == CostCurve.from_json(detail.curve).error_for_ms(2.0)
    assert read_measured(detail)["digest"] == status.digest


def test_the_viewport_follows_a_new_curve(terrain, monkeypatch):
    show_window(monkeypatch)
    terrain.adaptive_terrain.viewport.curve = ""
    bpy.context.view_layer.update()
    key = live._next_job().request.key()
    terrain.adaptive_terrain.viewport.curve = CURVE.to_json()
    bpy.context.view_layer.update()
    job = live._next_job()
    assert job.request.key() != key and job.request.criterion.error_px == pytest.approx(8.0, rel=1e-3)
    job.future.result(20)


def test_the_live_viewport_corrects_the_curve_by_its_own_times(terrain, monkeypatch):
    """If updates take twice the predicted time, live updates get coarser; explicit updates and renders do not."""
    show_window(monkeypatch)
    errors = []
    for _ in range(5):
        bpy.context.scene.camera.location.x += 1.0
        bpy.context.view_layer.update()
        job = live._next_job()
        errors.append(job.request.criterion.error_px)
        update, serial, whole = job.future.result(20)
        slow = replace(update, ms={"total": 2.0 * CURVE.at(errors[-1])[1]})
        live._show_result(replace(job, future=Mock(**{"result.return_value": (slow, serial, whole)})))
        assert live._next_job() is None, "a camera that stands still keeps its mesh"
    assert errors == [CURVE.error_for_ms(2.0)] * 3 + [pytest.approx(CURVE.error_for_ms(1.0), rel=1e-3)] * 2
    assert session.record_of(terrain).time_correction.factor == pytest.approx(2.0, rel=1e-3)
    assert request_of(terrain).criterion.error_px == CURVE.error_for_ms(2.0)
    assert request_of(terrain, RENDER).criterion.error_px == CURVE.error_for_ms(8.0)
