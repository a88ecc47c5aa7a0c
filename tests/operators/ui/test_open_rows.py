# SPDX-License-Identifier: GPL-3.0-or-later
"""A beginner sees at most twelve rows, and both editors show the same ones."""

import bpy
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.ui import panels
from drawn_panels import draw, open_rows, panels_in
from land_scenes import add

MAX_ROWS = 12
SIDEBAR, PROPERTIES = "VIEW_3D", "PROPERTIES"


def new_terrain():
    """Add a terrain without heights, whose source is a file."""
    obj = bpy.data.objects.new("New", bpy.data.meshes.new("New"))
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    obj.adaptive_terrain.enabled, obj.adaptive_terrain.source = True, "FILE"
    return obj


def test_without_a_terrain_there_are_two_buttons(scene, preparing):
    assert open_rows(SIDEBAR) == 3, "and the preparation of the kernels while it lasts"
    preparing.fraction = None
    preparing.done.set()
    assert draw(panels.TerrainPanel).texts == ["Add Adaptive Terrain", "mesh.adaptive_terrain_from_file"]
    assert open_rows(SIDEBAR) == 2 and open_rows(PROPERTIES) == 0


@pytest.mark.parametrize("space", [SIDEBAR, PROPERTIES])
def test_a_new_terrain_has_at_most_twelve_rows(scene, space):
    new_terrain()
    assert open_rows(space) <= MAX_ROWS and "<source_path>" in draw(panels.TerrainPanel).texts


def test_a_new_terrain_shows_what_to_do_and_no_error(scene):
    terrain = new_terrain()
    with pytest.raises(TerrainError, match="has no height field"):
        session.update_object(terrain)
    assert "No height map yet: press Import" in draw(panels.TerrainPanel).texts
    session.record_of(terrain).status.error = "The archive holds 4 height maps"  # of an import that failed since then
    assert "Not up to date: read why" in draw(panels.TerrainPanel).texts
    session.record_of(terrain).status.failure = TerrainError("The disk is full")
    assert "Not up to date: read why" in draw(panels.TerrainPanel).texts


@pytest.mark.parametrize("space", [SIDEBAR, PROPERTIES])
def test_an_imported_terrain_has_at_most_twelve_rows(scene, add_terrain, space):
    terrain = add_terrain()
    before = open_rows(space)
    assert 5 < before <= MAX_ROWS
    session.update_object(terrain)
    session.record_of(terrain).status.error = "The disk is full."
    assert open_rows(space) == before, "nothing moves"


@pytest.mark.parametrize("space", [SIDEBAR, PROPERTIES])
def test_shaped_land_with_water_has_at_most_twelve_rows(scene, terrain, space):
    add("water", sea=-10.0)
    session.update_object(terrain)
    assert "Add Water" in draw(panels.TerrainPanel).texts
    assert bpy.ops.adaptive_terrain.water_surface() == {"FINISHED"}
    assert "Update Water" in draw(panels.TerrainPanel).texts
    assert 5 < open_rows(space) <= MAX_ROWS


def test_both_editors_draw_the_same_rows(scene, terrain):
    add("water", sea=-10.0)
    session.update_object(terrain)
    sidebar, properties = panels_in(SIDEBAR), panels_in(PROPERTIES)
    assert len(sidebar) == len(properties) > 15
    for one, other in zip(sidebar, properties, strict=True):
        drawn = draw(one).texts, draw(other).texts
        assert one.bl_label == other.bl_label and drawn[0] == drawn[1], one.bl_label
        assert getattr(other, "bl_parent_id", "").removesuffix("_properties") == getattr(one, "bl_parent_id", "")


def test_the_properties_editor_shows_only_the_active_terrain(scene, add_terrain):
    add_terrain()
    bpy.context.view_layer.objects.active = scene.camera
    shown = [cls for cls in panels_in(PROPERTIES) if not hasattr(cls, "bl_parent_id")]
    assert shown == [] and open_rows(SIDEBAR) > 5
