# SPDX-License-Identifier: GPL-3.0-or-later
"""A large height map is shown quickly and completed beside the window; renders, farms and packing tell them apart."""

import json
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store, read_json
from adaptive_terrain.cbt_terrain.importing import import_process, refining
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.import_process import ImportJob
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators import handlers, jobs
from adaptive_terrain.operators.export import preparing
from adaptive_terrain.operators.export.frame_sources import SceneFrames, loading_note
from adaptive_terrain.operators.export.rendering import render_frames
from adaptive_terrain.operators.farm.submit import submit
from adaptive_terrain.operators.importing import import_terrain, incomplete, view_tiles
from adaptive_terrain.operators.importing.imported import changed_settings, imported_of, loaded_text
from adaptive_terrain.operators.importing.panel import draw_source
from adaptive_terrain.operators.importing.store_location import store_folder
from adaptive_terrain.operators.land import render_wait
from adaptive_terrain.operators.session import session, stale_renders
from adaptive_terrain.operators.ui import status_row
from drawn_panels import DrawnLayout
from held_imports import HeldImport, held_import, large_terrain, look_down, store_of, tiles_of, until  # noqa: F401
from modal_runs import RunningOperator, running, to_the_end, turn
from rasterio.transform import from_origin
from rasters import hills, write_raster

LOADED = "Loaded to 79.6 m of 10 m"


@pytest.fixture
def incomplete_terrain(terrain):
    """Return the terrain with an incomplete store, in the saved file."""
    settings = import_terrain.settings_of(terrain)
    terrain.adaptive_terrain.store = store_folder(terrain, settings)
    run_import(replace(settings, quick=600), store_of(terrain))
    bpy.ops.wm.save_mainfile()
    return terrain


def box_of(obj):
    """Return the corners of an object's mesh in the world, metres, without heights."""
    points = np.array([obj.matrix_world @ vertex.co for vertex in obj.data.vertices])
    return np.array([points[:, :2].min(axis=0), points[:, :2].max(axis=0)])


def test_the_land_is_shown_before_it_is_complete(terrain, scene):
    operator = running(import_terrain.ImportTerrain, terrain)
    until(operator, lambda: loaded_text(terrain.adaptive_terrain))
    path, placed = terrain.adaptive_terrain.store, terrain.matrix_world.copy()
    camera = scene.camera.matrix_world.copy()
    assert loaded_text(terrain.adaptive_terrain) == LOADED and jobs.find(jobs.IMPORT, terrain) is not None
    session.update_object(terrain)
    assert session.record_of(terrain).field.lattice.width == 26
    first = box_of(terrain)
    layout = DrawnLayout()
    status_row.draw_status(layout, SimpleNamespace(space_data=None, scene=scene), terrain, layout)
    assert "Loaded to 79.6 m" in layout.texts, "beside the progress"
    bpy.ops.ed.undo_push(message="While importing")
    assert to_the_end(operator) == {"FINISHED"}
    assert terrain.adaptive_terrain.store == path and loaded_text(terrain.adaptive_terrain) == ""
    session.update_object(terrain)
    assert session.record_of(terrain).field.lattice.width == 200
    assert np.array_equal(open_store(store_of(terrain)).heights(), hills(200, 150)[::-1])
    assert terrain.matrix_world == placed and scene.camera.matrix_world == camera and scene.frame_current == 7
    assert np.abs(box_of(terrain) - first).max() < 1e-3 * np.ptp(first), "the land stays in its place"
    bpy.ops.ed.undo_push(message="Import")
    bpy.ops.ed.undo()
    again = bpy.data.objects["Terrain"].adaptive_terrain
    assert again.store == path and imported_of(again).raster == (200, 150), "Undo does not bring the quick one back"


def test_a_cancelled_import_keeps_the_first_picture(terrain, monkeypatch):
    operator = running(import_terrain.ImportTerrain, terrain)
    until(operator, lambda: loaded_text(terrain.adaptive_terrain))
    jobs.find(jobs.IMPORT, terrain).stop()
    assert to_the_end(operator) == {"FINISHED"}, "the step of Undo has the first picture"
    assert loaded_text(terrain.adaptive_terrain) == LOADED
    report = " ".join(str(call) for call in operator.report.call_args_list)
    assert "loaded to 79.6 m of 10 m" in report
    assert operator.report.call_args.args == ({"INFO"}, "Importing was cancelled; the finished part stays")
    layout = DrawnLayout()
    draw_source(layout, terrain)
    assert "Load All" in layout.texts
    monkeypatch.setattr(status_row, "follows_viewport", lambda *_: True)
    monkeypatch.setattr(
        status_row, "sight_notice", lambda *_: ("Camera underground", status_row.CAMERA_TO_VIEW, "To View")
    )
    layout = DrawnLayout()
    status_row.draw_status(layout, SimpleNamespace(space_data=None, scene=bpy.context.scene), terrain, layout)
    assert layout.texts == ["Loaded to 79.6 m", "Load All"], "not of a camera that is not placed"
    again = running(import_terrain.ImportTerrain, terrain)
    assert to_the_end(again) == {"FINISHED"} and loaded_text(terrain.adaptive_terrain) == ""
    assert imported_of(terrain.adaptive_terrain).raster == (200, 150)
    layout = DrawnLayout()
    draw_source(layout, terrain)
    assert "Import" in layout.texts, "nothing is left to load"


def test_an_import_that_fails_later_keeps_the_first_picture(terrain, monkeypatch):
    operator = running(import_terrain.ImportTerrain, terrain)

    class FailingJob(ImportJob):
        def __init__(self, settings, store):
            raise TerrainError("The disk is full", fix="make room")

    monkeypatch.setattr(import_process, "ImportJob", FailingJob)  # the quick one runs
    assert to_the_end(operator) == {"FINISHED"} and loaded_text(terrain.adaptive_terrain) == LOADED
    assert "The disk is full: make room" in " ".join(str(call) for call in operator.report.call_args_list)


def test_a_render_waits_for_the_running_import(terrain, scene):
    operator = running(import_terrain.ImportTerrain, terrain)
    until(operator, lambda: loaded_text(terrain.adaptive_terrain))
    seen = []
    depsgraph = bpy.context.evaluated_depsgraph_get()
    thread = threading.Thread(target=lambda: seen.append(incomplete.wait_for_imports([terrain], depsgraph)))
    until(operator, lambda: getattr(jobs.find(jobs.IMPORT, terrain), "child", None) is not None)
    thread.start()
    while thread.is_alive():  # as in a locked interface, nothing advances the job
        if render_wait.waiting is not None:
            assert render_wait.waiting.text.startswith("Importing, ")
        time.sleep(0.002)
    assert seen == [[]] and render_wait.waiting is None
    assert read_json(store_of(terrain))["lattice"]["width"] == 200, "the complete store is there"
    assert to_the_end(operator) == {"FINISHED"}


def test_esc_ends_the_wait_for_an_import(incomplete_terrain, monkeypatch):
    job = jobs.BackgroundJob(jobs.IMPORT, incomplete_terrain.session_uid, lambda _job: iter(()))
    job.child = SimpleNamespace(reached=(0.5, "Reading"), cancel=lambda: None)
    monkeypatch.setattr(render_wait, "_is_cancelled", True)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    [error] = incomplete.wait_for_imports([incomplete_terrain], depsgraph)
    assert error.code == render_wait.CANCELLED and render_wait.waiting is None
    job.child = SimpleNamespace(reached=None)
    assert incomplete.wait_for_imports([incomplete_terrain], depsgraph) == [], "it has ended"
    jobs.running.remove(job)


def test_a_render_of_an_incomplete_store_says_so(incomplete_terrain, tmp_path, capsys):
    scene = bpy.context.scene
    scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = "BLENDER_WORKBENCH", 32, 18
    bpy.ops.wm.save_mainfile()
    blend, out = bpy.data.filepath, tmp_path / "out"
    source = SceneFrames(Path(blend), None, None)
    lines = []
    render_frames(source, [7, 9], out, on_frame=lambda frame, summary, skipped: lines.append(summary))
    for frame in (7, 9):
        [figures] = json.loads((out / f"frame_{frame:04d}.json").read_text())["terrains"]
        assert figures["loaded"] == "to 79.6 m of 10 m"
        assert f"frame {frame}, Terrain: {LOADED}" in capsys.readouterr().out or frame == 9
    incomplete.note_incomplete(bpy.context.scene, [bpy.data.objects["Terrain"]])
    assert stale_renders._messages == [f"Terrain: {LOADED}. Load All imports the rest"], "of a render with a window"
    handlers.on_render_end(bpy.context.scene)
    assert not stale_renders._messages
    [piece] = SceneFrames(Path(blend), None, None).pieces(7)
    assert piece.info["loaded"] == "to 79.6 m of 10 m"


def test_a_script_gets_the_complete_store_at_once(terrain, scene, capsys):
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    assert loaded_text(terrain.adaptive_terrain) == "" and imported_of(terrain.adaptive_terrain).raster == (200, 150)
    incomplete.note_incomplete(scene, [terrain])
    assert not stale_renders._messages and "Loaded" not in capsys.readouterr().out
    incomplete.check_complete(terrain, "load it")
    terrain.adaptive_terrain.holes = True  # another import into the same folder
    operator = running(import_terrain.ImportTerrain, terrain)
    while turn(operator) == {"PASS_THROUGH"}:
        assert loaded_text(terrain.adaptive_terrain) == "", "no quick store replaces a complete one"
        time.sleep(0.005)
    assert imported_of(terrain.adaptive_terrain).settings["holes"]
    bpy.ops.wm.save_mainfile()
    [piece] = SceneFrames(Path(bpy.data.filepath), None, None).pieces(7)
    assert "loaded" not in piece.info


@pytest.mark.parametrize(
    "tiles, text",
    [pytest.param((), LOADED, marks=pytest.mark.thorough), ((0,), "Loaded to 9.95 m, else 79.6 m")],
)
def test_a_farm_job_completes_the_store_first(incomplete_terrain, tmp_path, tiles, text):
    scene, terrain = bpy.context.scene, incomplete_terrain
    if tiles:
        run_import(replace(import_terrain.settings_of(terrain), quick=600, loaded_tiles=tiles), store_of(terrain))
    _, notes = submit(
        scene, [terrain], tmp_path / "job", frames=[7], chunk=1, formats=(), extension=None, allow_outside=True
    )
    assert f"Terrain: {text}; the job imports all of it first" in notes
    listed = (tmp_path / "job" / "asset_references.yaml").read_text()
    inputs = json.loads(listed)["assetReferences"]["inputs"]
    assert str(tmp_path / "a.tif") in inputs["filenames"] and str(store_of(terrain)) not in inputs["directories"]
    said = []
    preparing.prepare([terrain], [7], ["stores"], said.append, lambda _done: None)
    assert loaded_text(terrain.adaptive_terrain) == "" and "imported, 200 x 150 samples" in said[0]
    assert np.array_equal(open_store(store_of(terrain)).heights(), hills(200, 150)[::-1])
    said.clear()
    preparing.prepare([terrain], [7], ["stores"], said.append, lambda _done: None)
    assert said == ["Terrain: its store is there"]


def test_packing_refuses_an_incomplete_store(scene, add_terrain, tmp_path):
    source = write_raster(tmp_path / "a.tif", hills(200, 150), transform=from_origin(0, 0, 10, 10))
    run_import(ImportSettings(str(source), quick=600), tmp_path / "elsewhere" / "store")
    obj = add_terrain()
    obj.adaptive_terrain.store = str(tmp_path / "elsewhere" / "store")
    (tmp_path / "here").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "here" / "a.blend"))
    with pytest.raises(RuntimeError, match="is incomplete .loaded to 79.6 m of 10 m.*press Load All"):
        bpy.ops.adaptive_terrain.pack_store()
    assert not (tmp_path / "here" / "terrain").exists()


def test_tiles_in_view_are_shown_before_the_rest(terrain, scene, monkeypatch):
    monkeypatch.setattr(refining, "FEWEST", 1)  # as if the source was large
    finished, finish = [], import_terrain.ImportOperator.finish

    def finish_and_look(operator, context, obj, result):
        finish(operator, context, obj, result)
        session.update_object(obj)
        field = session.record_of(obj).field
        finished.append((loaded_text(obj.adaptive_terrain), field.lattice.width, loading_note(field).get("loaded")))

    monkeypatch.setattr(import_terrain.ImportTerrain, "finish", finish_and_look)
    assert to_the_end(running(import_terrain.ImportTerrain, terrain)) == {"FINISHED"}
    tiles = "Loaded to 9.95 m, else 79.6 m", 201, "to 79.6 m of 10 m, in 1 tile to 9.95 m"
    assert finished == [(LOADED, 26, "to 79.6 m of 10 m"), tiles, ("", 200, None)]
    assert np.array_equal(open_store(store_of(terrain)).heights(), hills(200, 150)[::-1])
    settings = import_terrain.settings_of(terrain)
    assert changed_settings(settings, imported_of(terrain.adaptive_terrain)) == []


def shown_text(terrain):
    return view_tiles.loaded_here(SimpleNamespace(space_data=None, scene=bpy.context.scene), terrain)


def test_a_moved_view_gets_its_tiles_during_an_import(terrain, held):
    before = tiles_of(terrain)
    assert 0 < len(before) < 12 and shown_text(terrain) == "Loaded to 39.8 m here"
    look_down(terrain, 700.0, 400.0)
    assert shown_text(terrain) == "Loaded to 79.6 m here"
    until(held, lambda: tiles_of(terrain) > before)
    assert shown_text(terrain) == "Loaded to 39.8 m here"
    session.update_object(terrain)
    assert session.record_of(terrain).field.lattice.width == 51, "the new tiles are shown"
    HeldImport.is_released = True
    assert to_the_end(held) == {"FINISHED"} and loaded_text(terrain.adaptive_terrain) == ""
    assert np.array_equal(open_store(store_of(terrain)).heights(), hills(200, 150)[::-1])


def test_a_render_loads_the_tiles_that_it_sees(terrain, held):
    before = tiles_of(terrain)
    terrain.adaptive_terrain.render.error_px = 1.0
    look_down(terrain, 700.0, 400.0)
    loader, depsgraph = view_tiles.loader_of(terrain), bpy.context.evaluated_depsgraph_get()
    assert not loader.wait_for(terrain, depsgraph), "between its samples may be more than a pixel"
    assert tiles_of(terrain) > before
    look_down(terrain, -900.0, 600.0)
    near = tiles_of(terrain)
    terrain.adaptive_terrain.render.error_px = open_store(store_of(terrain)).max_height  # in pixels of less than 1 m
    assert incomplete.wait_for_imports([terrain], bpy.context.evaluated_depsgraph_get()) == []
    assert tiles_of(terrain) >= near and loaded_text(terrain.adaptive_terrain), "it did not wait for all samples"
    terrain.hide_render = True
    jobs.find(jobs.IMPORT, terrain).stop()
    assert to_the_end(held) == {"FINISHED"} and shown_text(terrain).startswith("Loaded to ")
    again = running(import_terrain.ImportTerrain, terrain)
    until(again, lambda: jobs.find(jobs.IMPORT, terrain).message == "Reading")
    before = tiles_of(terrain)
    terrain.adaptive_terrain.viewport.error_px = 0.1
    look_down(terrain, 0.0, 0.0)
    until(again, lambda: tiles_of(terrain) > before)
    HeldImport.is_released = True
    assert to_the_end(again) == {"FINISHED"} and loaded_text(terrain.adaptive_terrain) == ""


@pytest.mark.parametrize(("is_placed", "modes"), [(True, ("VIEWPORT", "RENDER")), (False, ("VIEWPORT",))])
def test_tiles_of_a_camera_come_first_only_if_it_is_placed(scene, monkeypatch, is_placed, modes):
    monkeypatch.setattr(import_terrain, "follows_viewport", lambda *_: not is_placed)
    operator, loader = RunningOperator(operator_class=import_terrain.ImportTerrain), Mock()
    loader.start.return_value = None
    assert list(operator._load_seen(Mock(), loader, "")) == []
    assert loader.start.call_args.args[2:] == modes
