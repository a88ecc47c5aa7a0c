# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel says, and the one-click island."""

from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.island import SIDE
from adaptive_terrain.cbt_terrain.importing import import_process
from adaptive_terrain.cbt_terrain.view.criterion import LARGEST
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH
from adaptive_terrain.operators.accuracy.panel import statistics_lines, summary_lines
from adaptive_terrain.operators.importing.panel import ImportedPanel
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain.panel import RenderPanel, ViewportPanel
from adaptive_terrain.operators.terrain.request import gather
from adaptive_terrain.operators.terrain.update_terrain import UpdateTerrain
from adaptive_terrain.operators.text.shown_bounds import NO_BOUND
from adaptive_terrain.operators.ui import status_bar
from adaptive_terrain.operators.ui.panel_parts import error_lines, wrap_words
from adaptive_terrain.operators.ui.panels import OutputPanel, TerrainPanel
from drawn_panels import draw_mocked
from modal_runs import RunningOperator, running, turn


def test_every_figure_has_its_unit(scene, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.viewport.edge_px = 40.0
    session.update_object(terrain)
    lines = dict(statistics_lines(session.record_of(terrain).status))
    assert lines["Screen error"].endswith(" px") and "Vertical error" not in lines, "nobody has asked for metres"
    assert lines["Longest edge"].endswith(" px") and lines["Engine in all"].endswith(" ms")
    assert lines["Into Blender"].endswith(" ms")
    assert lines["Triangles"] == f"{len(terrain.data.polygons):,}"
    terrain.adaptive_terrain.viewport.error_m = 2.0
    session.update_object(terrain)
    assert dict(statistics_lines(session.record_of(terrain).status))["Vertical error"].endswith(" m")


def test_lengths_on_screen_are_shown_in_pixels(scene, add_terrain):
    properties = add_terrain().adaptive_terrain.viewport.bl_rna.properties
    assert [properties[name].subtype for name in ("error_px", "edge_px")] == ["PIXEL", "PIXEL"]


def test_the_bound_has_its_parts(scene, add_terrain):
    from adaptive_terrain.cbt_terrain.refine.reported_bounds import ReportedBounds
    from adaptive_terrain.cbt_terrain.refine.terms import Terms

    terrain = add_terrain()
    update = session.update_object(terrain)
    status = session.record_of(terrain).status
    assert status.bounds == update.bounds and status.bounds.terms_px == update.terms_px
    status.bounds = ReportedBounds(bound_px=2.0, terms_px=Terms(1.5, 0.25, 0.25))
    lines = statistics_lines(status)
    at = lines.index(("Screen error", "≤ 2 px"))
    parts = [("by triangles", "1.5 px"), ("by precision", "0.25 px"), ("by the source", "0.25 px")]
    assert lines[at + 1 : at + 4] == [(f"    {name}", part) for name, part in parts]
    status.bounds = ReportedBounds(bound_px=0.0, terms_px=Terms(0.0, 0.0, 0.0))
    assert statistics_lines(status)[at : at + 2] == [("Screen error", "≤ 0 px"), lines[at + 4]], "nothing is in view"
    assert lines[at + 4][0] == "Leaves", "what is 0 is left out"
    status.bounds = replace(status.bounds, bound_px=LARGEST, limited="precision")
    lines = statistics_lines(status)
    at = lines.index(("Screen error", NO_BOUND))
    assert lines[at + 1][0] == "Held back by", "what says nothing has no parts"
    assert ("Held back by", "float32 precision") in lines


def test_long_messages_are_cut_between_words():
    text = "one two three four five six seven"
    lines = wrap_words(text, 10)
    assert " ".join(lines) == text and max(map(len, lines)) <= 10


def test_add_makes_a_visible_mesh(scene):
    assert bpy.ops.mesh.adaptive_terrain_add(size=30.0) == {"FINISHED"}
    terrain = bpy.context.object
    assert terrain.adaptive_terrain.enabled
    assert len(terrain.data.polygons) > 0
    assert terrain.dimensions.x == pytest.approx(30.0)


def test_import_reports_what_is_wrong(scene, add_terrain):
    terrain = add_terrain()
    store = terrain.adaptive_terrain.store
    terrain.adaptive_terrain.source = "FILE"
    terrain.adaptive_terrain.source_path = "/nowhere/dem.tif"
    with pytest.raises(RuntimeError, match="/nowhere/dem.tif"):
        bpy.ops.adaptive_terrain.import_source()
    assert terrain.adaptive_terrain.store == store
    assert "/nowhere/dem.tif" in session.record_of(terrain).status.error


def test_an_export_has_the_renders_detail(scene, add_terrain, tmp_path):
    terrain = add_terrain()
    terrain.adaptive_terrain.viewport.error_px = 8.0
    session.update_object(terrain)
    viewport = len(terrain.data.polygons)
    path = tmp_path / "terrain.npz"
    assert bpy.ops.adaptive_terrain.export(filepath=str(path)) == {"FINISHED"}
    with np.load(path) as archive:
        assert len(archive["triangles"]) > 2 * viewport
    assert len(terrain.data.polygons) == viewport
    with pytest.raises(RuntimeError, match="no known format"):
        bpy.ops.adaptive_terrain.export(filepath=str(tmp_path / "terrain.doc"))


def test_a_projection_is_asked_only_of_files_that_can_have_one(scene, add_terrain):
    from adaptive_terrain.operators.importing.import_terrain import settings_of

    terrain = add_terrain()
    settings = terrain.adaptive_terrain
    settings.source, settings.project = "FILE", " utm"
    for path, project in (("/dem.TIF", "utm"), ("/dem.exr", ""), ("/dem.r16", "")):
        settings.source_path = path
        assert settings_of(terrain).project == project


def test_stores_of_unsaved_files_do_not_meet(scene, add_terrain, tmp_path):
    from adaptive_terrain.operators.importing.import_terrain import settings_of
    from adaptive_terrain.operators.importing.store_location import store_folder

    terrain = add_terrain()
    first = store_folder(terrain, settings_of(terrain))
    assert store_folder(terrain, settings_of(terrain)) == first
    terrain.adaptive_terrain.seed += 1
    assert store_folder(terrain, settings_of(terrain)) != first
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "valley.blend"))
    assert store_folder(terrain, settings_of(terrain)) == "//terrain/valley_Terrain_island"


def test_the_panel_tells_that_stores_were_moved(scene, add_terrain, monkeypatch):
    from adaptive_terrain.operators.importing import store_paths
    from adaptive_terrain.operators.importing.panel import ImportedPanel

    add_terrain()
    assert "were moved" not in str(draw_mocked(ImportedPanel).mock_calls)
    monkeypatch.setattr(store_paths, "notices", {"moved": "Stores were moved."})
    assert "were moved" in str(draw_mocked(ImportedPanel).mock_calls)


def test_import_says_what_it_did():
    from adaptive_terrain.operators.importing.import_terrain import summary

    report = {"raster": [5, 4], "lowest_m": -1.5, "highest_m": 80.0, "filled": 3, "cut_out": 0, "source_step_m": 0.5}
    assert summary(report) == (
        "5 x 4 samples, -1.5 to 80 m, 15 % without data filled, rounded by the source itself to ±0.5 m"
    )
    assert summary(report | {"source_step_m": 0.0}).endswith(", 15 % without data filled")


def test_lock_interface_button(scene):
    scene.render.use_lock_interface = False
    bpy.ops.adaptive_terrain.lock_interface()
    assert scene.render.use_lock_interface is True


def test_a_failed_export_keeps_the_viewports_detail(scene, add_terrain, tmp_path, monkeypatch):
    from adaptive_terrain.operators.export import exporting

    terrain = add_terrain()
    terrain.adaptive_terrain.viewport.error_px = 8.0
    viewport = session.update_object(terrain).triangles
    with pytest.raises(RuntimeError, match="There is no folder"):
        bpy.ops.adaptive_terrain.export(filepath=str(tmp_path / "missing" / "terrain.ply"))

    def fail(piece, path):
        raise OSError("the disk is full")

    monkeypatch.setattr(exporting, "write_piece", fail)
    with pytest.raises(RuntimeError, match="the disk is full") as failure:
        bpy.ops.adaptive_terrain.export(filepath=str(tmp_path / "terrain.ply"))
    assert "Traceback" not in str(failure.value)
    assert len(terrain.data.polygons) == viewport


def test_an_add_that_fails_leaves_nothing(scene, monkeypatch):

    monkeypatch.setattr(
        import_process,
        "ImportJob",
        Mock(side_effect=TerrainError("The disk is full")),
    )
    before = len(bpy.data.objects), len(bpy.data.meshes)
    with pytest.raises(RuntimeError, match="The disk is full") as failure:
        bpy.ops.mesh.adaptive_terrain_add()
    assert "Traceback" not in str(failure.value)
    assert (len(bpy.data.objects), len(bpy.data.meshes)) == before


def test_nothing_is_added_while_a_mesh_is_edited(scene):
    """Blender would join the new object to the mesh."""
    edited = bpy.data.objects.new("Edited", bpy.data.meshes.new("Edited"))
    scene.collection.objects.link(edited)
    bpy.context.view_layer.objects.active = edited
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="Leave the mode"):
        bpy.ops.mesh.adaptive_terrain_add()
    bpy.ops.object.mode_set(mode="OBJECT")


def test_the_panel_shows_that_kernels_are_prepared(scene, add_terrain, preparing):
    for add in (lambda: None, add_terrain):
        add()
        layout = draw_mocked(TerrainPanel)
        bars = [call.kwargs for call in layout.mock_calls if call[0].endswith("progress")]
        assert bars == [{"factor": 0.25, "text": "Preparing kernels (first use)"}]
    assert draw_mocked(OutputPanel).row().enabled is not False, "a click on a bake or an export waits beside the window"
    preparing.fraction = None
    preparing.done.set()
    assert not [call for call in draw_mocked(TerrainPanel).mock_calls if call[0].endswith("progress")]


def test_a_store_without_notes_has_no_empty_box(scene):
    bpy.ops.mesh.adaptive_terrain_add()
    boxes = [call for call in draw_mocked(ImportedPanel).mock_calls if call[0].endswith("box")]
    assert boxes == []


def test_the_panel_says_that_nothing_is_left(scene, add_terrain):
    terrain = add_terrain()
    cleanup = terrain.adaptive_terrain.cleanup

    def said() -> list[str]:
        session.update_object(terrain)
        return [call.kwargs["text"] for call in draw_mocked(TerrainPanel).mock_calls if "Nothing is left" in str(call)]

    assert said() == []
    cleanup.use_below, cleanup.below = True, 1e9
    assert said() == ["Nothing is left: all is cut away"] and not terrain.data.polygons
    cleanup.use_below = False
    assert said() == [] and terrain.data.polygons


def test_a_click_on_update_waits_beside_the_window(scene, add_terrain, preparing):
    terrain = add_terrain()
    manager, timer = Mock(), SimpleNamespace(type="TIMER")
    context = SimpleNamespace(window_manager=manager, window=None, object=terrain, mode="OBJECT")
    context.evaluated_depsgraph_get = bpy.context.evaluated_depsgraph_get
    context.temp_override = lambda **_members: nullcontext()
    update = RunningOperator(operator_class=UpdateTerrain, report=Mock())
    assert update.invoke(context, None) == {"RUNNING_MODAL"}
    assert update.modal(context, timer) == {"PASS_THROUGH"}
    assert len(terrain.data.polygons) == 0
    preparing.done.set()
    assert update.modal(context, timer) == {"FINISHED"}
    manager.event_timer_remove.assert_called_once()
    assert len(terrain.data.polygons) > 100


def test_an_import_that_is_done_waits_for_the_kernels(scene, add_terrain, preparing, monkeypatch):
    from adaptive_terrain.operators.importing import import_terrain

    terrain = add_terrain()
    terrain.adaptive_terrain.live = False  # so that the import itself updates the mesh
    report = {"raster": [5, 4], "lowest_m": 0, "highest_m": 1, "filled": 0, "source_step_m": 0.5}
    report["warnings"] = []
    done = SimpleNamespace(fraction=1.0, message="Done", done=True, error=None, report=report)
    child = SimpleNamespace(poll=lambda: done, cancel=lambda: None, cancelled=False)
    monkeypatch.setattr(import_process, "ImportJob", lambda settings, folder: child)
    monkeypatch.setattr(import_terrain, "store_folder", lambda obj, settings: terrain.adaptive_terrain.store)
    operator = running(import_terrain.ImportTerrain, terrain)
    assert turn(operator) == {"PASS_THROUGH"}
    assert len(terrain.data.polygons) == 0
    preparing.done.set()
    assert turn(operator) == {"FINISHED"}
    assert len(terrain.data.polygons) > 100


def test_what_was_wrong_without_heights_is_not_said_of_new_ones(scene, add_terrain):
    """A live update says meanwhile that there are none; the next one comes a second after the import."""
    from adaptive_terrain.operators.importing import import_terrain

    terrain = add_terrain()
    store, terrain.adaptive_terrain.store = terrain.adaptive_terrain.store, ""
    with pytest.raises(TerrainError, match="has no height field"):
        session.update_object(terrain)
    importing = SimpleNamespace(before=None, baked="", _show_in_viewports=Mock(), _report_and_update=Mock())
    import_terrain.ImportOperator.finish(importing, bpy.context, terrain, ({}, store))
    assert session.record_of(terrain).status.error == "" and terrain.adaptive_terrain.store == store


def test_the_size_of_the_added_island_is_not_that_of_a_file(scene, add_terrain):
    settings = add_terrain().adaptive_terrain
    settings.use_extent, settings.extent, settings.height_scale = True, (20.0, 20.0), 20.0 / SIDE
    settings.source = "FILE"
    assert (settings.use_extent, settings.height_scale) == (False, 1.0)
    settings.use_extent, settings.height_scale = True, 3.0
    settings.source = "FILE"
    assert (settings.use_extent, settings.height_scale) == (True, 3.0), "what the user has set stays"


def test_only_the_first_terrain_locks_the_interface(scene):
    scene.render.use_lock_interface = False
    bpy.ops.mesh.adaptive_terrain_add(size=30.0)
    assert scene.render.use_lock_interface is True
    scene.render.use_lock_interface = False
    bpy.ops.mesh.adaptive_terrain_add(size=30.0)
    assert scene.render.use_lock_interface is False


def test_the_top_has_three_lines_whatever_there_is_to_say(scene, add_terrain):
    terrain = add_terrain()
    status = session.record_of(terrain).status
    assert [figure for _, figure in summary_lines(status)] == ["-", "-", "-"]
    detail = terrain.adaptive_terrain.viewport
    for name, error_px, error_m in (("Screen error", 4.0, 2.0), ("Vertical error", 0.0, 2.0)):
        detail.error_px, detail.error_m = error_px, error_m
        session.update_object(terrain)
        lines = summary_lines(session.record_of(terrain).status)
        assert [line for line, _ in lines] == ["Triangles", name, "Update"]
        assert lines[0][1] == f"{len(terrain.data.polygons):,}" and lines[1][1].startswith("≤ ")


def test_geomorph_of_either_detail_is_another_request(scene, add_terrain):
    terrain = add_terrain()
    depsgraph, asked = bpy.context.evaluated_depsgraph_get(), set()
    for mode, detail in (("VIEWPORT", terrain.adaptive_terrain.viewport), ("RENDER", terrain.adaptive_terrain.render)):
        detail.error_px = 3.0
        for smooth in (False, True):
            detail.smooth_transitions = smooth
            depsgraph.update()
            request = gather(terrain, depsgraph, mode)
            assert request.criterion.morph == (SMOOTH if smooth else 1.0)
            asked.add((smooth, request.key(), request.digest("")))
    assert len({key for _, key, _ in asked}) == len({digest for _, _, digest in asked}) == 2


@pytest.mark.parametrize("panel", [ViewportPanel, RenderPanel])
def test_a_panel_of_detail_has_a_row_for_each_setting(scene, add_terrain, panel):
    add_terrain()
    calls = draw_mocked(panel).mock_calls
    criteria = [call.kwargs["heading"] for call in calls if "heading" in call.kwargs]
    assert criteria == ["Screen Error", "Edge Length", "Area (px²)", "Vertical Error"]
    rows = [(call.args[1], call.kwargs.get("text")) for call in calls if call[0] == "prop"]
    assert rows[:9] == [
        ("guard_deg", "Guard (°)"),
        ("off_screen_factor", "Off-Screen ×"),
        ("hidden_factor", "Hidden ×"),
        ("shading_floor", "Shading Floor"),
        ("smooth_transitions", "Geomorph"),
        ("meshlet", "Meshlet Level"),
        ("limit_depth", None),
        ("limit_triangles", None),
        ("limit_time", None),
    ]


def test_the_switch_of_a_criterion_is_its_value(scene, add_terrain):
    detail = add_terrain().adaptive_terrain.viewport
    assert detail.ask_error_px and not detail.ask_edge_px
    detail.ask_edge_px = True
    assert detail.edge_px > 0.0
    detail.edge_px = 7.0
    detail.ask_edge_px = True
    assert detail.edge_px == 7.0, "what is on stays as it is"
    detail.ask_edge_px = False
    assert detail.edge_px == 0.0


def test_the_status_bar_says_what_takes_long(scene, preparing, monkeypatch):
    assert status_bar.current_work() == (0.25, "Preparing kernels (first use)")
    preparing.fraction = None
    assert status_bar.current_work() is None
    monkeypatch.setattr(status_bar.live, "seconds_under_way", lambda: 12.4)
    monkeypatch.setattr(status_bar.live, "stage", lambda: "Making the overlay")
    assert status_bar.current_work() == (None, "Making the overlay, 12 s")


def test_an_error_shows_its_fix_on_its_own_line():
    error = TerrainError("The mask is damaged", "a.npy", "float32", "delete the file")
    status = session.Status(error=str(error), failure=error)
    assert error_lines(status) == [
        ("The mask is damaged (a.npy); expected float32.", "ERROR"),
        ("Delete the file.", "FORWARD"),
    ]
    status.error = "Another one."
    assert error_lines(status) == [("Another one.", "ERROR")] and error_lines(session.Status()) == []
