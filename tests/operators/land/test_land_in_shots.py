# SPDX-License-Identifier: GPL-3.0-or-later
"""Land that is made fine where the shot looks, frozen triangles, and water on it."""

import shutil

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.height_operators import derived_store, land_folder
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.session import session
from blender_meshes import positions
from land_scenes import add


def test_water_lies_on_the_land_that_the_stack_makes(terrain):
    """The land is shaped first, and not cut against a preview."""
    add("water", sea=-10.0)
    session.update_object(terrain)
    assert bpy.ops.adaptive_terrain.water_surface() == {"FINISHED"}
    assert derived_store.counts["stores"] == 1
    [water] = terrain.children
    assert (np.abs(positions(water)[:, 2] + 10.0) < 1e-3).mean() > 0.5, "the sea of the stack"


def look_at(scene, east: float, north: float) -> None:
    """Straight down from 400 m on a square of some 300 m."""
    camera = scene.camera
    camera.location, camera.rotation_euler = (east, north, 460.0), (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()


def test_only_what_the_shot_sees_is_fine(scene, terrain, wide_store, tmp_path):
    """Another frame adds its tiles to those of the first."""
    shutil.copytree(wide_store, tmp_path / "wide")
    terrain.adaptive_terrain.store = str(tmp_path / "wide")
    terrain.adaptive_terrain.land.where = "SEEN"
    add("relief", wave=64.0, plains=0.2)
    scene.frame_start = scene.frame_end = scene.frame_current
    look_at(scene, -4000.0, -3000.0)
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    built, there_are = shaped_land.state_of(terrain).tiles
    assert 0 < built < there_are and shaped_land.state_of(terrain).wanted, "another shot may look elsewhere"
    folder = shaped_land.store_of(terrain)
    change = open_store(folder).heights() - open_store(wide_store).heights()
    fine = [np.abs(np.diff(part, 2)).mean() for part in (change[100:200, 150:250], change[800:900, 1200:1300])]
    assert fine[0] > 3.0 * fine[1], "fine waves where the camera looks only"
    session.update_object(terrain, mode="RENDER")
    assert derived_store.counts["stores"] == 1, "the render finds its tiles"
    look_at(scene, 4000.0, 3000.0)
    session.update_object(terrain, mode="RENDER")
    assert derived_store.counts["stores"] == 2 and shaped_land.state_of(terrain).tiles[0] > built
    look_at(scene, -4000.0, -3000.0)
    session.update_object(terrain, mode="RENDER")
    assert derived_store.counts["stores"] == 2
    again = open_store(folder).heights() - open_store(wide_store).heights()
    assert np.array_equal(again[50:250, 60:300], change[50:250, 60:300])


def test_a_frozen_terrain_takes_the_shaped_heights(terrain, wide_store):
    """Also one whose raster is larger than a preview: that one is not shown on it."""
    terrain.adaptive_terrain.store = str(wide_store)
    session.update_object(terrain)
    assert bpy.ops.adaptive_terrain.freeze() == {"FINISHED"}
    before = len(terrain.data.polygons)
    add("relief", wave=64.0)
    session.update_object(terrain)
    assert shaped_land.state_of(terrain).shown == "Source" and len(terrain.data.polygons) == before
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    assert shaped_land.state_of(terrain).shown == "Shaped" and len(terrain.data.polygons) == before
    shutil.rmtree(land_folder.folder_beside(str(wide_store)))


@pytest.mark.thorough
def test_a_shot_gets_the_whole_land_where_that_costs_less(scene, terrain, wide_store, tmp_path):
    """Tiles with margins would cost several times as much; Everywhere finds the same store."""
    shutil.copytree(wide_store, tmp_path / "wide")
    settings = terrain.adaptive_terrain
    settings.store, settings.land.where = str(tmp_path / "wide"), "SEEN"
    add("rivers")
    scene.frame_start, scene.frame_end = 1, 3
    frame = scene.frame_current
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    state = shaped_land.state_of(terrain)
    assert state.tiles[0] == state.tiles[1] and not state.wanted and scene.frame_current == frame
    session.update_object(terrain, mode="RENDER")
    settings.land.where = "WHOLE"
    session.update_object(terrain, mode="RENDER")
    assert derived_store.counts["stores"] == 1
