# SPDX-License-Identifier: GPL-3.0-or-later
"""Live updates: the window that a terrain follows if there are several, and meshes that are edited by hand."""

import time
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.session import live, session


def in_window(scene, depsgraph=True):
    layer = scene.view_layers[0]
    layer.update()
    shown = layer if depsgraph else SimpleNamespace(depsgraph=None)
    return SimpleNamespace(scene=scene, view_layer=shown, screen=SimpleNamespace(areas=()))


def show_in_one_window(scene, monkeypatch) -> None:
    windows = [in_window(scene)]
    monkeypatch.setattr(live, "_windows", lambda: windows)


def turns() -> int:
    """Run the timer until it rests, and return the number of updates."""
    updates = 0
    live.mark_dirty()
    for _ in range(100_000):
        before, wait = live._job, live.tick()
        updates += live._job is not None and live._job is not before
        if wait == live.IDLE_S:
            return updates
        assert updates < 10, "it alternates between two cameras"
        time.sleep(0.002)
    raise AssertionError("the live update never ended")


def test_a_terrain_of_two_scenes_follows_the_first_window(scene, add_terrain, monkeypatch):
    """Its one mesh would flicker and keep a core busy if it were refined for both cameras in turn."""
    terrain = add_terrain()
    other = bpy.data.scenes.new("Other")
    other.collection.objects.link(terrain)
    other.camera = scene.camera.copy()
    other.camera.location.y = -300.0
    other.collection.objects.link(other.camera)
    first, second = in_window(scene), in_window(other)
    for windows, eye in (
        ([first, second], -900.0),
        ([second, first], -300.0),
        ([in_window(other, False), first], -900.0),
    ):
        monkeypatch.setattr(live, "_windows", lambda windows=windows: windows)
        assert turns() == 1
        [view] = session.record_of(terrain).status.request.views
        assert np.linalg.inv(view.world_to_camera)[1, 3] == pytest.approx(eye)


def test_a_mesh_edited_by_hand_is_written_again(scene, add_terrain, monkeypatch):
    """Edits keep the numbers of vertices and faces, and the camera stays."""
    terrain = add_terrain()
    show_in_one_window(scene, monkeypatch)
    turns()
    heights = [vertex.co.z for vertex in terrain.data.vertices]
    bpy.context.view_layer.objects.active = terrain
    for live_update in (True, False):
        terrain.adaptive_terrain.live = live_update
        bpy.ops.object.mode_set(mode="EDIT")
        turns()
        bpy.ops.object.mode_set(mode="OBJECT")
        terrain.data.vertices[3].co.z += 400.0
        if not live_update:  # then a render writes it
            session.update_object(terrain)
        turns()
        assert [vertex.co.z for vertex in terrain.data.vertices] == heights


def test_a_mesh_with_an_applied_modifier_is_written_again(scene, add_terrain, monkeypatch):
    """And one that was replaced by another mesh."""
    terrain = add_terrain()
    show_in_one_window(scene, monkeypatch)
    turns()
    triangles = len(terrain.data.polygons)
    bpy.context.view_layer.objects.active = terrain
    terrain.modifiers.new("Fewer", "DECIMATE").ratio = 0.3
    bpy.ops.object.modifier_apply(modifier="Fewer")
    assert len(terrain.data.polygons) < triangles
    assert turns() == 1 and len(terrain.data.polygons) == triangles
    terrain.data = bpy.data.meshes.new("Empty")
    assert turns() == 1 and len(terrain.data.polygons) == triangles and turns() == 0


def test_an_update_that_ends_in_edit_mode_runs_again(scene, add_terrain, monkeypatch):
    terrain = add_terrain()
    show_in_one_window(scene, monkeypatch)
    turns()
    bpy.context.view_layer.objects.active = terrain
    triangles = len(terrain.data.polygons)
    terrain.adaptive_terrain.viewport.error_px *= 4.0
    scene.view_layers[0].update()
    live.mark_dirty()
    live.tick()
    assert live._job is not None, "an update is under way"
    bpy.ops.object.mode_set(mode="EDIT")
    turns()
    bpy.ops.object.mode_set(mode="OBJECT")
    turns()
    assert len(terrain.data.polygons) == session.record_of(terrain).status.triangles < triangles
