# SPDX-License-Identifier: GPL-3.0-or-later
"""The views that decide where a terrain is fine: a placed camera, or the viewports until there is one."""

from types import SimpleNamespace

import bpy
import pytest
from adaptive_terrain.operators.terrain import camera_source
from adaptive_terrain.operators.terrain.camera_source import follows_viewport, is_placed
from adaptive_terrain.operators.ui import panels
from adaptive_terrain.operators.ui.status_row import has_view, sight_notice
from drawn_panels import draw


@pytest.fixture
def in_window(monkeypatch):
    """Let the choice of views see a window."""
    monkeypatch.setattr(camera_source, "bpy", SimpleNamespace(app=SimpleNamespace(background=False)))


def test_the_start_up_files_camera_is_not_placed(factory, add_terrain):
    terrain = add_terrain()
    assert not is_placed(None, terrain) and not is_placed(factory.camera, terrain)
    factory.camera.location.z += 500.0
    bpy.context.view_layer.update()
    assert is_placed(factory.camera, terrain)


@pytest.mark.parametrize("anchor, x, expected", [(0.0, 0.0, False), (0.0, 1500.0, True), (600.0, 500.0, True)])
def test_a_camera_below_the_whole_land_is_not_placed(scene, add_terrain, anchor, x, expected):
    terrain = add_terrain()
    terrain.adaptive_terrain.anchor = anchor, 0.0
    for z, above in ((-500.0, False), (400.0, True)):
        scene.camera.location = x, 0.0, z
        bpy.context.view_layer.update()
        assert is_placed(scene.camera, terrain) == (expected or above)


def test_viewports_decide_until_a_camera_is_placed(factory, add_terrain, in_window):
    terrain = add_terrain()
    assert follows_viewport(terrain, factory) and has_view(bpy.context, terrain)
    terrain.adaptive_terrain.camera_source, terrain.adaptive_terrain.camera = "CHOSEN", factory.camera
    assert not follows_viewport(terrain, factory), "a user has chosen it"
    terrain.adaptive_terrain.camera_source = "SCENE"
    assert bpy.ops.adaptive_terrain.set_up_scene() == {"FINISHED"}
    assert not follows_viewport(terrain, factory)


def test_in_the_background_the_camera_always_counts(factory, add_terrain):
    terrain = add_terrain()
    assert not follows_viewport(terrain, factory)
    factory.camera = None
    assert not follows_viewport(terrain, factory)
    terrain.adaptive_terrain.camera_source = "VIEW"
    assert follows_viewport(terrain, factory)


def test_the_panel_says_that_viewports_decide(factory, add_terrain, in_window):
    add_terrain()
    note = "Follows viewports: no camera placed"
    assert note in draw(panels.CameraPanel).texts
    factory.camera.location.z += 500.0
    bpy.context.view_layer.update()
    assert note not in draw(panels.CameraPanel).texts


def test_a_camera_underground_is_no_error_before_it_is_placed(factory, add_terrain, in_window):
    terrain = add_terrain()
    factory.camera.location.z = -500.0
    bpy.context.view_layer.update()
    assert sight_notice(bpy.context, terrain)[0] == "Camera underground" and has_view(bpy.context, terrain)
