# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel says, and the one-click island."""

import bpy
import pytest
from adaptive_terrain.operators import session
from adaptive_terrain.operators.panels import statistics_lines, wrapped


def test_every_figure_has_its_unit(scene, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.viewport.edge_px = 40.0
    session.update_object(terrain)
    lines = dict(statistics_lines(session.record_of(terrain).status))
    assert lines["Screen error"].endswith(" px") and lines["Vertical error"].endswith(" m")
    assert lines["Longest edge"].endswith(" px") and lines["Total"].endswith(" ms")
    assert lines["Triangles"] == f"{len(terrain.data.polygons):,}"


def test_long_messages_are_cut_between_words():
    text = "one two three four five six seven"
    lines = wrapped(text, 10)
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


def test_lock_interface_button(scene):
    scene.render.use_lock_interface = False
    bpy.ops.adaptive_terrain.lock_interface()
    assert scene.render.use_lock_interface is True
