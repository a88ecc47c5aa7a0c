# SPDX-License-Identifier: GPL-3.0-or-later
"""The window that a terrain follows if there are several."""

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
