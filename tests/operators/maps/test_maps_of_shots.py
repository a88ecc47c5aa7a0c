# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps as fine as a shot needs: every frame is looked at, beside the window."""

import time
from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import pytest
from adaptive_terrain.operators.effects import bake_maps, map_images, map_request
from map_scenes import bake, keys


def running(obj):
    operator = SimpleNamespace(report=Mock())
    for name in ("invoke", "modal", "cancel", "_look", "_end", "_finish"):
        setattr(operator, name, getattr(bake_maps.BakeMaps, name).__get__(operator))
    operator.context = SimpleNamespace(
        window_manager=Mock(), window=None, object=obj, scene=bpy.context.scene, view_layer=bpy.context.view_layer
    )
    assert operator.invoke(operator.context, None) == {"RUNNING_MODAL"}
    return operator


def turns(operator, event: str = "TIMER"):
    for _ in range(3000):
        ended = operator.modal(operator.context, SimpleNamespace(type=event, value="PRESS"))
        if ended & {"FINISHED", "CANCELLED"}:
            operator.context.window_manager.event_timer_remove.assert_called_once()
            return ended
        event = "TIMER"
        time.sleep(0.01)
    raise AssertionError("baking never ended")


def test_a_shot_is_looked_at_beside_the_window(terrain):
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 5
    scene.frame_set(3)
    terrain.adaptive_terrain.maps.frames = "SHOT"
    operator = running(terrain)
    assert bake_maps.progress() is not None
    assert turns(operator) == {"FINISHED"} and bake_maps.progress() is None
    assert scene.frame_current == 3 and len(keys(terrain)) == 1


def test_a_shot_is_looked_at_from_every_frame(terrain):
    """Also from that which the scene is at."""
    scene = bpy.context.scene
    for frame in range(1, 6):
        scene.camera.location.x = 10.0 * frame
        scene.camera.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 1, 5
    for now in ((3, 0.0), (5, 0.25)):
        scene.frame_set(now[0], subframe=now[1])
        terrain.adaptive_terrain.maps.frames = "SHOT"
        *_, request = map_request.gathered(terrain, scene)
        east = [-float(view.world_to_camera[0, 3]) for view in request.views]
        assert east == pytest.approx([10.0, 20.0, 30.0, 40.0, 50.0])
        assert (scene.frame_current, scene.frame_subframe) == now


def test_the_whole_terrain_needs_no_camera(terrain):
    bpy.context.scene.camera, terrain.adaptive_terrain.maps.frames = None, "WHOLE"
    bake(terrain)
    terrain.adaptive_terrain.maps.frames = "FRAME"
    with pytest.raises(RuntimeError, match="has no camera"):
        bpy.ops.adaptive_terrain.bake_maps()


def test_a_terrain_that_is_removed_while_frames_are_looked_at_ends_the_bake(terrain):
    bpy.context.scene.frame_end = 100_000
    terrain.adaptive_terrain.maps.frames = "SHOT"
    operator = running(terrain)
    operator.modal(operator.context, SimpleNamespace(type="TIMER", value="PRESS"))
    bpy.data.objects.remove(terrain)
    assert turns(operator) == {"CANCELLED"} and bake_maps.progress() is None
    assert bpy.context.scene.frame_current == 1


def test_escape_leaves_the_maps_as_they_were(terrain, monkeypatch):
    bake(terrain)
    before = keys(terrain)
    terrain.adaptive_terrain.maps.chosen = {"detail_normal", "slope", "height"}
    going_on = bake_maps.Job._progress

    def slow(self, fraction):
        time.sleep(0.3)
        going_on(self, fraction)

    monkeypatch.setattr(bake_maps.Job, "_progress", slow)
    operator = running(terrain)
    operator.modal(operator.context, SimpleNamespace(type="TIMER", value=""))
    assert turns(operator, "ESC") == {"CANCELLED"}
    folder = map_images.map_folder(terrain)
    assert keys(terrain) == before and len(list(folder.iterdir())) == 1 + len(before)
