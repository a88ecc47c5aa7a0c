# SPDX-License-Identifier: GPL-3.0-or-later
"""Add Water Surface: an object with depth and speed, made once, and anew after the land has changed."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.scene import session
from adaptive_terrain.operators.scene.water_surface import MARK


@pytest.fixture
def terrain(scene, add_terrain):
    obj = add_terrain()
    session.update_object(obj)
    bpy.context.view_layer.objects.active = obj
    return obj


def waters(obj):
    return [child for child in obj.children if child.get(MARK)]


def heights(mesh):
    array = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", array)
    return array[2::3]


def test_water_is_one_object_with_depth_and_speed(terrain):
    assert bpy.ops.adaptive_terrain.water_surface() == {"FINISHED"}
    (water,) = waters(terrain)
    assert water.name in bpy.context.scene.objects and water.data.materials[0].name == "Terrain Water"
    depth = np.empty(len(water.data.vertices), np.float32)
    water.data.attributes["water_depth"].data.foreach_get("value", depth)
    assert depth.min() == 0.0 and depth.max() > 0.05
    assert water.data.attributes["water_speed"].domain == "POINT"
    assert not water.data.validate()


def test_pressed_again_the_same_object_follows_the_terrain(terrain):
    bpy.ops.adaptive_terrain.water_surface()
    (water,) = waters(terrain)
    before = heights(water.data)
    water.name = "Lake"
    terrain.adaptive_terrain.vertical_scale, terrain.adaptive_terrain.vertical_offset = 2.0, -30.0
    bpy.ops.adaptive_terrain.water_surface()
    assert waters(terrain) == [water]
    assert np.allclose(heights(water.data), 2.0 * before - 30.0, atol=1e-3)


def test_land_without_water_says_so(terrain):
    terrain.adaptive_terrain.store = ""
    with pytest.raises(RuntimeError, match="has no height field"):
        bpy.ops.adaptive_terrain.water_surface()
    assert not waters(terrain)
