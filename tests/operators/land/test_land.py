# SPDX-License-Identifier: GPL-3.0-or-later
"""Land that stacks shape in Blender: previews, stores, and the cost for a scene."""

from unittest.mock import Mock

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators import derived_store
from adaptive_terrain.cbt_terrain.height_operators.shape_store import run_shape
from adaptive_terrain.operators import handlers, jobs
from adaptive_terrain.operators.land import shape_land, shaped_land
from adaptive_terrain.operators.land import stack as land_stack
from adaptive_terrain.operators.land.panel import NOTE_LINES, shaping_time_text, status_lines
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain.request import gather
from adaptive_terrain.operators.terrain.request_kernels import kernels_for
from adaptive_terrain.operators.text.numbers import time_text
from adaptive_terrain.operators.ui.panel_parts import LINE_LENGTH, wrap_words
from land_scenes import add
from modal_runs import running, to_the_end, turn


def test_an_unwritable_export_fails_before_land_is_shaped(terrain, tmp_path):
    add("scree")
    with pytest.raises(RuntimeError, match="there is no folder"):
        bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "none" / "land.tif"))
    assert derived_store.counts["stores"] == 0


def test_a_hidden_terrain_costs_nothing(terrain):
    """Counted: neither previews nor stores are made of it, whatever asks; once it is shown they are."""
    add("relief")
    for hide in ("hide_viewport", "eye"):
        if hide == "eye":
            terrain.hide_viewport = False
            terrain.hide_set(True)
        else:
            terrain.hide_viewport = True
        terrain.hide_render = True
        bpy.context.view_layer.update()
        session.update_object(terrain)
        handlers.update_all(bpy.context.scene, bpy.context.evaluated_depsgraph_get(), "VIEWPORT")
        assert session.record_of(terrain).status.request.land is None
        with pytest.raises(RuntimeError, match="is hidden in viewports and in renders"):
            bpy.ops.adaptive_terrain.shape()
    assert derived_store.counts == {"previews": 0, "stores": 0}
    terrain.hide_set(False)
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert derived_store.counts == {"previews": 1, "stores": 0}


def test_a_preview_first_and_the_land_when_it_is_shaped(terrain):
    add("scree", scree_angle=0.4)
    state = shaped_land.state_of(terrain)
    assert (state.active, state.wanted) == (True, True)
    session.update_object(terrain)
    state = shaped_land.state_of(terrain)
    assert state.shown == "Preview" and state.step_m == 10.0 and list(state.ms) == [0]
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    state = shaped_land.state_of(terrain)
    assert (state.shown, state.wanted) == ("Shaped", False) and state.tiles == (1, 1)
    assert [name for name, _ in status_lines(state)] == ["Shown", "Tiles", "Time"]
    folder = shaped_land.store_of(terrain)
    request = session.record_of(terrain).status.request
    assert request.store == folder and request.land is None
    assert derived_store.counts == {"previews": 1, "stores": 1}
    bpy.ops.adaptive_terrain.shape()
    assert derived_store.counts == {"previews": 1, "stores": 1}, "what is there is not made again"


def note_where(monkeypatch, terrain, **said) -> str:
    """Return the panel's note for a shaped store whose JSON has these other values."""
    read = shaped_land.stores.read_json

    def other(path):
        found = read(path)
        shaped = found["provenance"].get("shaped")
        for name, value in said.items() if shaped else ():
            within = shaped if name in shaped else shaped["added"][-1]
            assert within[name] != value
            within[name] = value
        return found

    shaped_land._read_provenance.cache_clear()
    with monkeypatch.context() as replaced:
        replaced.setattr(shaped_land.stores, "read_json", other)
        note = shaped_land.state_of(terrain).note
    shaped_land._read_provenance.cache_clear()
    assert len(wrap_words(note, LINE_LENGTH)) <= NOTE_LINES, "nothing of it is cut"
    return note


def test_the_panel_says_that_tiles_are_not_to_be_trusted(terrain, monkeypatch):
    add("scree")
    bpy.ops.adaptive_terrain.shape()
    assert shaped_land.state_of(terrain).note == ""
    expected = "Scree may not fit from tile to tile: harder rock may help, or 4,097 samples a side at most"
    left_out = {"left_out_rms_m": 1.96, "left_out_most_m": 11.9}
    assert note_where(monkeypatch, terrain, doubtful=True) == expected
    assert note_where(monkeypatch, terrain, doubtful=True, **left_out) == expected, "the worse is said"


def test_the_panel_says_that_some_tiles_took_the_whole(terrain, monkeypatch):
    add("scree")
    bpy.ops.adaptive_terrain.shape()
    said = {"left_out_rms_m": 1234.5, "left_out_most_m": 123.45}
    left_out = "Finer levels are left out{}: about 1,234 m, 123 m at most"
    assert note_where(monkeypatch, terrain, **said) == left_out.format("")
    but = ", except Scree, whose tiles would not fit"
    assert note_where(monkeypatch, terrain, **said, tiles=[[]]) == left_out.format(but)


def test_the_land_is_what_the_command_makes(terrain, tmp_path):
    add("scree", depth=60.0)
    bpy.ops.adaptive_terrain.shape()
    stack = land_stack.preset_of(terrain.adaptive_terrain.land)
    run_shape(terrain.adaptive_terrain.store, stack, tmp_path / "other")
    mine, other = open_store(shaped_land.store_of(terrain)), open_store(tmp_path / "other")
    assert mine.key == other.key and np.array_equal(mine.heights(), other.heights())


def test_undo_brings_the_land_before_back_at_once(terrain):
    """The settings alone decide which store is shown."""
    entry = add("scree")
    bpy.ops.adaptive_terrain.shape()
    first = shaped_land.store_of(terrain)
    entry.scree.depth = 3.0
    bpy.ops.adaptive_terrain.shape()
    assert shaped_land.store_of(terrain) != first
    entry.scree.depth = 30.0
    session.update_object(terrain)
    assert shaped_land.store_of(terrain) == first and derived_store.counts["stores"] == 2
    entry.on = False
    session.update_object(terrain)
    assert shaped_land.store_of(terrain) == terrain.adaptive_terrain.store
    assert shaped_land.state_of(terrain) == shaped_land.LandState()


def test_a_render_has_all_of_the_land_and_waits_for_it(terrain):
    add("scree", depth=80.0)
    session.update_object(terrain)
    session.update_object(terrain, mode="RENDER")
    assert derived_store.counts == {"previews": 1, "stores": 1}
    assert shaped_land.state_of(terrain).shown == "Shaped"
    assert session.record_of(terrain).field.raster.digest == open_store(shaped_land.store_of(terrain)).raster.digest


def test_the_list_says_which_effects_were_not_computed_again(terrain):
    add("scree", depth=80.0)
    bpy.ops.adaptive_terrain.shape()
    session.update_object(terrain)
    [first] = shaped_land.state_of(terrain).ms.values()
    assert first > 0.0
    add("relief")
    bpy.ops.adaptive_terrain.shape()
    session.update_object(terrain)
    state = shaped_land.state_of(terrain)
    assert state.ms[0] is None and state.ms[1] > 0.0
    assert [shaping_time_text(state.ms, number) for number in (0, 1, 2)] == ["Reused", time_text(state.ms[1]), "-"]
    assert status_lines(state)[2] == ("Time", time_text(state.ms[1]))


def test_times_are_short():
    assert [time_text(ms) for ms in (None, 0.0, 0.0814, 0.4, 35.2, 4200.0)] == [
        "-",
        "0 ms",
        "< 0.1 ms",
        "0.4 ms",
        "35.2 ms",
        "4.2 s",
    ]


@pytest.mark.parametrize("by", ["ESC", "cross"])
def test_looking_at_frames_can_be_cancelled(terrain, monkeypatch, by):
    """The scene is at its frame again, and nothing was shaped."""
    add("scree")
    scene = bpy.context.scene
    terrain.adaptive_terrain.land.where = "SEEN"
    scene.frame_start, scene.frame_end = 1, 500
    scene.frame_set(450)  # further than a turn gets
    monkeypatch.setattr(jobs, "TURN_S", 0.02)
    operator = running(shape_land.ShapeLand, terrain)
    assert operator.began == {"RUNNING_MODAL"}
    assert turn(operator) == {"PASS_THROUGH"}
    assert scene.frame_current != 450 and jobs.find(jobs.SHAPE, terrain).text == "Shaping: Looking at frames"
    if by == "ESC":
        assert turn(operator, "ESC") == {"RUNNING_MODAL"}
    else:
        assert bpy.ops.adaptive_terrain.cancel_job(kind="SHAPE") == {"FINISHED"}
    assert to_the_end(operator) == {"CANCELLED"}
    assert scene.frame_current == 450 and not jobs.running and derived_store.counts["stores"] == 0


@pytest.mark.parametrize("by", ["file", "undo"])
def test_looking_at_frames_ends_where_the_scene_goes(terrain, tmp_path, monkeypatch, by):
    """Another file is opened, which ends what runs; or Undo puts another scene in its place."""
    add("scree")
    scene = bpy.context.scene
    terrain.adaptive_terrain.land.where = "SEEN"
    scene.frame_start, scene.frame_end = 1, 500
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "land.blend"))
    monkeypatch.setattr(jobs, "TURN_S", 0.02)
    operator = running(shape_land.ShapeLand, terrain)
    assert turn(operator) == {"PASS_THROUGH"}
    assert bpy.context.scene.frame_current != 1 and jobs.running
    if by == "file":
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "land.blend"))
        operator.cancel(operator.context)
        operator.context.window_manager.event_timer_remove.assert_called_once()
    else:
        bpy.ops.ed.undo_push(message="before")
        bpy.ops.ed.undo_push(message="after")
        assert bpy.ops.ed.undo() == {"FINISHED"}
        assert to_the_end(operator) == {"CANCELLED"}
    assert not jobs.running and derived_store.counts["stores"] == 0


def test_shaping_says_why_it_does_not_begin(terrain):
    add("scree", scree_angle=0.4)
    job = jobs.BackgroundJob(jobs.SHAPE, terrain.session_uid, lambda _job: iter(()))
    with pytest.raises(RuntimeError, match="Shaping is under way: wait for it, or cancel it"):
        bpy.ops.adaptive_terrain.shape()
    jobs.running.remove(job)
    bpy.context.view_layer.objects.active = None
    with pytest.raises(RuntimeError, match="Make a terrain the active object"):
        bpy.ops.adaptive_terrain.shape()


def test_shaping_that_fails_unexpectedly_can_begin_again(terrain, monkeypatch):
    add("scree", scree_angle=0.4)
    monkeypatch.setattr(derived_store, "wanted_tiles", Mock(side_effect=OSError("no such device")))
    operator = running(shape_land.ShapeLand, terrain)
    assert operator.began == {"CANCELLED"} and not jobs.running
    [(kind, message)] = [call.args for call in operator.report.call_args_list]
    assert kind == {"ERROR"} and message.startswith("Shaping failed unexpectedly (OSError: no such device)")
    assert session.record_of(terrain).status.error == message
    monkeypatch.undo()
    operator = running(shape_land.ShapeLand, terrain)
    assert operator.began == {"RUNNING_MODAL"} and to_the_end(operator) == {"FINISHED"}


def test_a_preview_waits_for_the_kernels_of_its_effects(terrain):
    add("scree")
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    assert any(module.__name__.endswith("land.thermal") for module in kernels_for(request))
    bpy.ops.adaptive_terrain.shape()
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    assert not any(".land." in module.__name__ for module in kernels_for(request)), "what is shaped needs none"
    terrain.adaptive_terrain.interpolation = "bicubic"
    request = gather(terrain, bpy.context.evaluated_depsgraph_get())
    assert any(".bicubic." in module.__name__ for module in kernels_for(request))
