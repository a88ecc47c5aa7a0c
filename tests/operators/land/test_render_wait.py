# SPDX-License-Identifier: GPL-3.0-or-later
"""A render that waits for land shows its progress."""

import shutil
from types import SimpleNamespace

import bpy
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.height_operators import derived_store
from adaptive_terrain.operators import handlers, jobs
from adaptive_terrain.operators.land import panel, render_wait, resting_land, shape_land, shaped_land
from adaptive_terrain.operators.session import session, stale_renders
from adaptive_terrain.operators.ui import status_bar
from land_scenes import add
from modal_runs import hold, running, to_the_end


def test_a_render_shows_the_land_that_it_waits_for(terrain, monkeypatch, capsys):
    add("rivers")
    session.update_object(terrain)
    seen, noted = [], render_wait.print_line

    def look(line):
        noted(line)
        wait = shaped_land.render_wait_of(terrain)
        seen.append((wait.fraction, status_bar.current_work(), shaped_land.state_of(terrain).shown))

    monkeypatch.setattr(render_wait, "print_line", look)
    monkeypatch.setattr(render_wait, "PRINTED_S", 0.0)
    session.update_object(terrain, mode="RENDER")
    assert seen and all(work[0] == fraction for fraction, work, _ in seen)
    assert "Shaping land, " in capsys.readouterr().out
    assert render_wait.waiting is None and shaped_land.state_of(terrain).shown == "Shaped"


def test_the_text_has_the_time_that_is_left(monkeypatch):
    wait = render_wait.LandWait("folder", 100.0, fraction=0.25, message="Rivers, 2,049 x 2,049")
    monkeypatch.setattr(render_wait.time, "monotonic", lambda: 110.0)
    assert wait.text == "Shaping land, 25%, about 30 s left (Rivers, 2,049 x 2,049)"
    wait.estimate = 20.0
    assert wait.brief == "25%, about 15 s left", "coarse levels are slower than the rest"
    wait.fraction, wait.estimate = 0.0, float("inf")
    assert wait.text == "Shaping land, 0% (Rivers, 2,049 x 2,049)"


def test_a_failed_wait_is_forgotten(terrain, monkeypatch):
    add("rivers")

    def fail(*arguments, **_options):
        arguments[4](0.5, "Rivers")
        assert render_wait.waiting.fraction == 0.5
        raise ValueError("disk")

    monkeypatch.setattr(derived_store, "shape_store", fail)
    with pytest.raises(ValueError, match="disk"):
        session.update_object(terrain, mode="RENDER")
    assert render_wait.waiting is None


def test_esc_ends_the_wait_with_one_message(terrain, monkeypatch, capsys):
    """Blender itself ends the render at Esc: nothing is stale."""
    add("rivers")

    def shape(*arguments, **_options):
        tell = arguments[4]
        tell(0.5, "Rivers")
        esc = SimpleNamespace(type="ESC", value="PRESS")
        assert render_wait.CancelWaiting.modal(None, None, esc) == {"PASS_THROUGH"}
        tell(0.6, "Rivers")
        pytest.fail("the shaping went on")

    monkeypatch.setattr(derived_store, "shape_store", shape)
    for _ in range(2):  # terrains of one render
        with pytest.raises(TerrainError) as caught:
            session.update_object(terrain, mode="RENDER")
        assert caught.value.code == render_wait.CANCELLED and render_wait.waiting is None
        stale_renders.handle_stale_frame(bpy.context.scene, 1, [caught.value])
        shape = monkeypatch.setattr(derived_store, "shape_store", lambda *some, **_options: some[4](0.1, "Rivers"))
    assert capsys.readouterr().out.count("The render was cancelled while land was shaped: render again") == 2
    assert len(set(stale_renders._messages)) == 1 and not stale_renders._shown_stale
    handlers.on_render_end(bpy.context.scene)
    assert not stale_renders._messages and not render_wait._is_cancelled


def test_f12_shapes_first_what_a_render_would_wait_for(terrain):
    add("scree")
    assert bpy.ops.adaptive_terrain.shape_and_render.poll() and shape_land.next_unshaped(bpy.context) == terrain
    terrain.hide_render = True
    assert not bpy.ops.adaptive_terrain.shape_and_render.poll()
    terrain.hide_render = False
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    assert not bpy.ops.adaptive_terrain.shape_and_render.poll(), "Blender's own F12 gets the key"


def test_f12_shapes_first_the_tiles_that_a_shot_lacks(scene, terrain, wide_store, tmp_path, monkeypatch):
    """The render then finds them; where none is missing, it begins at once."""
    shutil.copytree(wide_store, tmp_path / "wide")
    terrain.adaptive_terrain.store, terrain.adaptive_terrain.land.where = str(tmp_path / "wide"), "SEEN"
    add("relief", wave=64.0, plains=0.2)
    later = []
    monkeypatch.setattr(bpy.app.timers, "register", lambda function, **_options: later.append(function))
    stores = []
    for east in (-4000.0, -4000.0, 4000.0):
        scene.camera.location, scene.camera.rotation_euler = (east, 0.75 * east, 460.0), (0.0, 0.0, 0.0)
        bpy.context.view_layer.update()
        event = hold(monkeypatch, derived_store, "wanted_tiles")
        operator = running(shape_land.ShapeAndRender, terrain, animation=False, done="")
        assert jobs.find(jobs.SHAPE, terrain).message == resting_land.CHOOSING
        event.set()
        assert to_the_end(operator) == {"FINISHED"}
        stores.append(derived_store.counts["stores"])
        session.update_object(terrain, mode="RENDER")
        assert derived_store.counts["stores"] == stores[-1]
    assert stores == [1, 1, 2] and len(later) == 3
    assert shape_land.next_unshaped(bpy.context, [terrain.name]) is None, "the render comes next"


def test_the_button_tells_the_seconds(terrain):
    add("scree")
    session.update_object(terrain)
    seconds = shaped_land.seconds_to_shape(terrain)
    assert 0.0 < seconds < 100.0 and panel._shape_button_text(terrain).startswith("Shape Now (about ")
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    assert shaped_land.seconds_to_shape(terrain) is None


def test_the_reason_for_the_source_is_true(terrain):
    add("scree")
    assert shaped_land.state_of(terrain).note == "Not shown yet: press Update or Shape Now"
    terrain.adaptive_terrain.live = False
    assert shaped_land.state_of(terrain).note == "Not shown: Live Update is off"
    terrain.hide_viewport = True
    bpy.context.view_layer.update()
    assert shaped_land.state_of(terrain).note == "Not shown: hidden"
