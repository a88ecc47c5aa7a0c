# SPDX-License-Identifier: GPL-3.0-or-later
"""Write Accuracy Report: the panel's whole sweep beside the window, which leaves the scene unchanged."""

import csv
import dataclasses
import shutil
import threading
from types import SimpleNamespace

import bpy
import pytest
from adaptive_terrain.cbt_terrain.accuracy import sweep as engine_sweep
from adaptive_terrain.cbt_terrain.accuracy.sweep_settings import Setting
from adaptive_terrain.operators import handlers, jobs, registration
from adaptive_terrain.operators.accuracy import measuring
from adaptive_terrain.operators.accuracy import report as accuracy_report
from adaptive_terrain.operators.accuracy import subject as accuracy_subject
from adaptive_terrain.operators.accuracy import sweep as sweep_accuracy
from adaptive_terrain.operators.accuracy.panel import AccuracyReportPanel
from adaptive_terrain.operators.accuracy.sweep import SweepAccuracy
from adaptive_terrain.operators.session import session
from drawn_panels import draw_mocked
from modal_runs import running, to_the_end, turn
from store_exports import run

FEW = [
    Setting("px", 8.0),
    Setting("px", 2.0),
    Setting("px", 2.0, max_depth=9),
    Setting("px", 2.0, meshlet=2),
    Setting("px", 8.0, interpolation="bicubic"),
    Setting("m", 4.0),
    Setting("m", 4.0, fitted=True),
]


@pytest.fixture
def terrain(scene, add_terrain, tmp_path, monkeypatch):
    """Add a terrain with a tolerance of 2 px, a report folder and a sweep of two settings, timed once."""
    monkeypatch.setattr(engine_sweep, "RUNS", 1)
    monkeypatch.setattr(accuracy_subject, "settings_for", lambda heights, frame, morph: FEW[:2])
    scene.render.resolution_percentage = 10  # looking takes longest
    obj = add_terrain()
    obj.adaptive_terrain.render.error_px = 2.0
    obj.adaptive_terrain.reports = str(tmp_path / "reports")
    return obj


@pytest.fixture
def every_kind(terrain, monkeypatch):
    """Sweep a setting of every kind."""
    monkeypatch.setattr(accuracy_subject, "settings_for", lambda heights, frame, morph: list(FEW))


@pytest.fixture
def held(monkeypatch):
    """Hold a sweep before its first row until `go` is set; `reached` is set when it waits."""
    gate = SimpleNamespace(go=threading.Event(), reached=threading.Event())
    sweep = engine_sweep.sweep

    def waiting(*arguments, **options):
        options["on_progress"](0.5)
        gate.reached.set()
        gate.go.wait(60)
        return sweep(*arguments, **options)

    monkeypatch.setattr(engine_sweep, "sweep", waiting)
    yield gate
    gate.go.set()
    for job in list(jobs.running):
        job.close()


def rows_of(terrain):
    folder = sweep_accuracy.report_folder(terrain)
    with (folder / "accuracy.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def data_blocks():
    return [[block.name for block in blocks] for blocks in (bpy.data.scenes, bpy.data.meshes, bpy.data.objects)]


def animate(scene):
    for frame, x in ((1, 0.0), (10, 900.0)):
        scene.camera.location.x = x
        scene.camera.keyframe_insert("location", frame=frame)
    scene.frame_set(4)


def test_it_sweeps_every_setting_and_writes_all_files(terrain, scene, every_kind):
    animate(scene)
    assert bpy.ops.adaptive_terrain.sweep_accuracy() == {"FINISHED"}
    rows = rows_of(terrain)
    assert [(row["unit"], row["max_depth"], row["meshlet"], row["fitted"], row["interpolation"]) for row in rows] == [
        (setting.unit, str(setting.max_depth or ""), str(setting.meshlet), str(setting.fitted), setting.interpolation)
        for setting in FEW
    ]
    assert all(0.0 < float(row["measured"]) <= float(row["bound"]) for row in rows)
    assert all(float(row["ms_ingest"]) > 0.0 for row in rows if row["fitted"] == "False")
    popping = [float(row["popping_px_max"]) for row in rows if row["unit"] == "px"]
    assert max(popping) > 0.0, "the camera moves to the next frame"
    folder = sweep_accuracy.report_folder(terrain)
    assert {path.suffix for path in folder.iterdir()} == {".html", ".md", ".csv", ".json", ".svg", ".png"}
    page = (folder / "index.html").read_text()
    assert "2 px (current)" in page and "through the camera of the scene, 64 x 36 pixels, frame 4." in page


@pytest.mark.thorough
def test_it_measures_what_the_command_measures(terrain, tmp_path, every_kind):
    """The same triangles and errors; only times differ."""
    bpy.ops.adaptive_terrain.sweep_accuracy()
    here = rows_of(terrain)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert run("accuracy", "--scene", tmp_path / "scene.blend", "--out", tmp_path / "command") == 0
    with (tmp_path / "command" / "accuracy.csv").open(newline="") as file:
        there = list(csv.DictReader(file))
    names = [name for name in here[0] if not name.startswith("ms_")]
    assert [[row[name] for name in names] for row in here] == [[row[name] for name in names] for row in there]


def test_the_scene_stays_as_it_is_also_what_has_no_keyframe(terrain, scene):
    animate(scene)
    scene.camera.location.x = 33.0
    before = data_blocks()
    bpy.ops.adaptive_terrain.sweep_accuracy()
    assert (scene.frame_current, scene.camera.location.x, data_blocks()) == (4, 33.0, before)
    assert handlers.on_frame_change in bpy.app.handlers.frame_change_post


def test_only_meshes_are_written_on_the_main_thread(terrain, monkeypatch):
    writers, before = set(), data_blocks()
    write = accuracy_report.time_mesh_writing

    def noted(surface):
        writers.add(threading.current_thread())
        return write(surface)

    monkeypatch.setattr(accuracy_report, "time_mesh_writing", noted)
    operator = running(SweepAccuracy, terrain)
    assert operator.began == {"RUNNING_MODAL"}
    assert not bpy.ops.adaptive_terrain.measure_accuracy.poll(), "one measurement at a time"
    assert to_the_end(operator) == {"FINISHED"}
    assert writers == {threading.main_thread()} and data_blocks() == before
    assert len(rows_of(terrain)) == 2
    kind, said = operator.report.call_args.args
    assert kind == {"INFO"} and said.endswith("index.html: 2 settings measured")


def test_what_handlers_of_others_move_comes_back(terrain, scene):
    def follow(of, _depsgraph=None):
        of.camera.location.x = 10.0 * of.frame_current

    scene.frame_set(5)
    bpy.app.handlers.frame_change_post.append(follow)
    scene.frame_set(5)
    try:
        bpy.ops.adaptive_terrain.sweep_accuracy()
    finally:
        bpy.app.handlers.frame_change_post.remove(follow)
    assert (scene.frame_current, scene.camera.location.x) == (5, 50.0)


def test_what_looks_at_the_scene_itself_is_named_in_the_report(terrain, scene):
    bpy.ops.adaptive_terrain.sweep_accuracy()
    page = sweep_accuracy.report_folder(terrain) / "index.html"
    assert "driver" not in page.read_text()
    variable = scene.camera.driver_add("location", 0).driver.variables.new()
    variable.targets[0].id_type, variable.targets[0].id, variable.targets[0].data_path = "SCENE", scene, "frame_current"
    bpy.ops.adaptive_terrain.sweep_accuracy()
    assert "Camera may follow the scene by a driver" in page.read_text()


def test_one_measurement_at_a_time_whatever_the_terrain(terrain, add_terrain, held):
    operator = running(SweepAccuracy, terrain)
    assert held.reached.wait(60)
    add_terrain("Other")
    assert not bpy.ops.adaptive_terrain.measure_accuracy.poll() and not bpy.ops.adaptive_terrain.sweep_accuracy.poll()
    held.go.set()
    assert to_the_end(operator) == {"FINISHED"} and bpy.ops.adaptive_terrain.sweep_accuracy.poll()


def test_a_render_ends_it_with_the_reason(terrain, held, monkeypatch):
    operator = running(SweepAccuracy, terrain)
    assert held.reached.wait(60)
    monkeypatch.setattr(jobs, "is_rendering", lambda: True)
    held.go.set()
    assert to_the_end(operator) == {"CANCELLED"}
    assert operator.report.call_args.args == ({"ERROR"}, str(measuring.error_while_rendering()))
    assert running(SweepAccuracy, terrain).began == {"CANCELLED"}


def test_a_mesh_that_an_undo_brings_back_is_removed(terrain):
    users = bpy.data.meshes.new("accuracy")
    accuracy_report.time_mesh_writing(session.update_object(terrain).surface)
    assert len(bpy.data.meshes) == 3
    handlers.on_undo(None)
    assert {mesh.name for mesh in bpy.data.meshes} == {terrain.data.name, users.name}


def test_switching_the_extension_off_leaves_no_mesh(terrain):
    before = data_blocks()
    operator = running(SweepAccuracy, terrain)
    while len(bpy.data.meshes) == len(before[1]):
        turn(operator)
    operator.job.timer = bpy.context.window_manager.event_timer_add(1.0)
    registration.unregister()
    registration.register()
    assert not jobs.running and [mesh.name for mesh in bpy.data.meshes] == before[1]


def test_reports_of_two_terrains_never_share_a_folder(terrain, add_terrain):
    other = add_terrain("a/b")
    terrain.name = "A_b"
    other.adaptive_terrain.reports = terrain.adaptive_terrain.reports
    with pytest.raises(RuntimeError, match="would both be written to 'a_b': rename one"):
        bpy.ops.adaptive_terrain.sweep_accuracy()
    other.name = "c"
    assert bpy.ops.adaptive_terrain.sweep_accuracy() == {"FINISHED"}


def test_a_long_name_fits_into_those_of_files(terrain):
    terrain.name = "é" * 255
    assert bpy.ops.adaptive_terrain.sweep_accuracy() == {"FINISHED"}
    assert len(rows_of(terrain)) == 2


def test_a_folder_that_vanishes_meanwhile_is_made_again(terrain, tmp_path, held):
    operator = running(SweepAccuracy, terrain)
    assert held.reached.wait(60)
    shutil.rmtree(tmp_path / "reports")
    held.go.set()
    assert to_the_end(operator) == {"FINISHED"} and len(rows_of(terrain)) == 2


def test_a_cancelled_sweep_leaves_the_last_report(terrain, held):
    folder = sweep_accuracy.report_folder(terrain)
    folder.mkdir(parents=True)
    (folder / "accuracy.csv").write_text("the last one")
    operator = running(SweepAccuracy, terrain)
    assert held.reached.wait(60)
    draw_mocked(AccuracyReportPanel, terrain).row().progress.assert_called_once_with(factor=0.5, text="Report: 2 px")
    assert bpy.ops.adaptive_terrain.cancel_job(kind="MEASURE") == {"FINISHED"}
    held.go.set()
    assert to_the_end(operator) == {"CANCELLED"}
    assert [path.name for path in folder.iterdir()] == ["accuracy.csv"]
    assert (folder / "accuracy.csv").read_text() == "the last one"


def test_cancel_does_not_wait_for_the_main_thread(terrain, monkeypatch):
    """The job asks for a mesh to be written and is stopped before it gets a turn: nothing is written any more."""
    before = data_blocks()
    monkeypatch.setattr(
        accuracy_report, "time_mesh_writing", lambda surface: pytest.fail("written after it was stopped")
    )
    operator = running(SweepAccuracy, terrain)
    while operator.job._calls.empty():
        assert operator.job in jobs.running
    operator.job.stop()
    assert to_the_end(operator) == {"CANCELLED"}
    assert data_blocks() == before and session.record_of(terrain).status.error == ""


def test_undo_and_an_opened_file_end_it(terrain, held):
    operator = running(SweepAccuracy, terrain)
    assert held.reached.wait(60)
    handlers.on_undo(None)
    held.go.set()
    assert to_the_end(operator) == {"CANCELLED"}
    operator = running(SweepAccuracy, terrain)
    operator.cancel(operator.context)
    assert operator.job.result is None and not jobs.running


def test_a_terrain_without_a_view_is_told(terrain, scene):
    scene.camera = None
    with pytest.raises(RuntimeError, match="The scene 'Scene' has no camera to refine for"):
        bpy.ops.adaptive_terrain.sweep_accuracy()
    assert session.record_of(terrain).status.error == "" and len(bpy.data.scenes) == 1
    assert handlers.on_frame_change in bpy.app.handlers.frame_change_post


def test_an_unwritable_folder_is_an_error_before_measuring(terrain, tmp_path, monkeypatch):
    monkeypatch.setattr(engine_sweep, "sweep", lambda *arguments, **options: pytest.fail("measured for nothing"))
    terrain.adaptive_terrain.reports = "//accuracy/"
    with pytest.raises(RuntimeError, match="save the file, or choose another folder"):
        bpy.ops.adaptive_terrain.sweep_accuracy()
    for folder in ("", "reports"):
        terrain.adaptive_terrain.reports = folder
        with pytest.raises(RuntimeError, match="which is not a whole path"):
            bpy.ops.adaptive_terrain.sweep_accuracy()
    (tmp_path / "file").write_text("")
    terrain.adaptive_terrain.reports = str(tmp_path / "file")
    with pytest.raises(RuntimeError, match="expected a folder"):
        bpy.ops.adaptive_terrain.sweep_accuracy()
    (tmp_path / "taken" / "Terrain" / "index.html").mkdir(parents=True)
    terrain.adaptive_terrain.reports = str(tmp_path / "taken")
    with pytest.raises(RuntimeError, match="index.html is a folder"):
        bpy.ops.adaptive_terrain.sweep_accuracy()


def test_a_broken_bound_is_an_error_and_in_the_report(terrain, monkeypatch):
    sweep = engine_sweep.sweep

    def too_proud(*arguments, **options):
        first, *rest = sweep(*arguments, **options)
        return [dataclasses.replace(first, bound=first.error / 2), *rest]

    monkeypatch.setattr(engine_sweep, "sweep", too_proud)
    with pytest.raises(RuntimeError, match="The bound does not hold in 1 row, first of Terrain at 8 px"):
        bpy.ops.adaptive_terrain.sweep_accuracy()
    assert len(rows_of(terrain)) == 2


def test_the_panel_opens_a_report_that_is_there(terrain):
    layout = draw_mocked(AccuracyReportPanel, terrain)
    layout.operator.assert_called_once_with("adaptive_terrain.sweep_accuracy", icon="GRAPH")
    bpy.ops.adaptive_terrain.sweep_accuracy()
    layout = draw_mocked(AccuracyReportPanel, terrain)
    assert layout.operator.call_args.args == ("wm.path_open",)
    assert layout.operator.return_value.filepath == str(sweep_accuracy.report_folder(terrain) / "index.html")
    terrain.adaptive_terrain.reports = "//accuracy/"
    draw_mocked(AccuracyReportPanel, terrain).box.assert_called_once()
