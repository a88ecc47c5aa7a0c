# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab keeps showing a terrain while another object is active, and a camera without a view is no accuracy."""

from types import SimpleNamespace

import bpy
import pytest
from adaptive_terrain.operators.accuracy.panel import summary_lines
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.ui import panels
from adaptive_terrain.operators.ui.panel_parts import TerrainSubpanel
from adaptive_terrain.operators.ui.status_row import NO_VIEW, draw_status, sight_notice
from drawn_panels import DrawnLayout


def activate(obj):
    bpy.context.view_layer.objects.active = obj


def test_the_tab_keeps_the_only_terrain(scene, add_terrain):
    terrain = add_terrain()
    activate(scene.camera)
    assert session.shown_terrain(bpy.context) == terrain
    assert all(cls.poll(bpy.context) for cls in (TerrainSubpanel, panels.CameraPanel, panels.OutputPanel))
    activate(None)
    assert session.shown_terrain(bpy.context) == terrain


def test_of_several_terrains_the_last_active_is_shown(scene, add_terrain):
    first, second = add_terrain("First"), add_terrain("Second")
    for terrain in (second, first):
        activate(terrain)
        assert session.shown_terrain(bpy.context) == terrain
    activate(scene.camera)
    assert session.shown_terrain(bpy.context) == first
    bpy.data.objects.remove(first)
    assert session.shown_terrain(bpy.context) == second, "the only one that is left"


def test_the_tab_says_that_its_terrain_is_hidden(scene, add_terrain):
    terrain, shown = add_terrain(), []
    for is_hidden in (False, True):
        terrain.hide_set(is_hidden)
        layout = DrawnLayout()
        draw_status(layout, SimpleNamespace(space_data=None, scene=scene), terrain, layout)
        shown.append("Hidden: stays as it is" in layout.texts)
    assert shown == [False, True]


def test_without_a_terrain_the_tab_is_empty(scene):
    assert session.shown_terrain(bpy.context) is None and not TerrainSubpanel.poll(bpy.context)


@pytest.mark.parametrize("height", [-500.0, 400.0])
def test_a_camera_underground_has_no_view(scene, add_terrain, height):
    terrain = add_terrain()
    scene.camera.location = 0.0, 0.0, height
    scene.camera.rotation_euler = 0.0, 0.0, 0.0  # down
    bpy.context.view_layer.update()
    session.update_object(terrain)
    notice = sight_notice(SimpleNamespace(space_data=None, scene=scene), terrain)[0]
    status = session.record_of(terrain).status
    figures = dict(summary_lines(status, notice in NO_VIEW))
    if height < 0:
        assert notice == "Camera underground" and status.bounds.bound_px == 0.0 and "no view" in figures.values()
        assert "updating" in dict(summary_lines(status, False, is_behind=True)).values(), "the camera has just moved"
    else:
        assert notice == "" and status.bounds.bound_px > 0.0 and "no view" not in figures.values()
        assert dict(summary_lines(status, False, is_behind=True)) == figures
