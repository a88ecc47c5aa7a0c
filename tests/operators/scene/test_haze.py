# SPDX-License-Identifier: GPL-3.0-or-later
"""Haze in materials: its amount in rendered pixels, and which materials have it."""

import math

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.bridge.demand.trees import tree_of_new
from adaptive_terrain.operators.bridge.nodes import marked_group_node
from adaptive_terrain.operators.importing.imported import imported_of
from adaptive_terrain.operators.scene import haze
from demand_trees import new_object
from mathutils import Matrix, Vector
from rendered_pictures import rendered

SET_UP = bpy.ops.adaptive_terrain.set_up_scene
COLOR = (0.5, 0.6, 0.8)


def node_of(material):
    return marked_group_node(material, haze.MARK)


def hazy() -> list[str]:
    return sorted(material.name for material in bpy.data.materials if node_of(material) is not None)


@pytest.fixture
def black_plane(scene):
    """Return a black plane across the view of a camera, without light of a world, and its hazy material."""
    plane = new_object("Plane", [(-1e5, 0, -1e5), (1e5, 0, -1e5), (1e5, 0, 1e5), (-1e5, 0, 1e5)])
    material = bpy.data.materials.new("Plane")
    shader = tree_of_new(material).nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = 0.0, 0.0, 0.0, 1.0
    shader.inputs["Specular IOR Level"].default_value = 0.0
    plane.data.materials.append(material)
    scene.world = None
    return plane, material


def render(scene, tmp_path, eye, point) -> np.ndarray:
    """Return the linear color that a camera sees in the middle of a picture by Cycles."""
    camera = bpy.data.objects.new("Eye", bpy.data.cameras.new("Eye"))
    camera.data.clip_end, camera.data.lens = 1e6, 5000.0
    forth = (point - eye).normalized()
    camera.matrix_world = Matrix.Translation(eye) @ forth.to_track_quat("-Z", "Y").to_matrix().to_4x4()
    scene.collection.objects.link(camera)
    scene.camera, scene.cycles.device = camera, "CPU"
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.resolution_percentage = 100
    return rendered(tmp_path / "a.exr")[4, 4, :3]


@pytest.mark.parametrize(
    ("eye", "point"),
    [
        ((0, -3e4, 500), (0, 0, 500)),
        ((0, -3e4, 4000), (0, 0, 100)),
        ((0, -4000, 9000), (0, 0, 200)),
        ((0, -3e4, 50), (0, 0, 6e3)),
    ],
)
def test_haze_is_the_light_of_the_air_on_the_line_of_sight(black_plane, scene, tmp_path, eye, point):
    """Compared with a numerical integral of the density."""
    eye, point = Vector(eye), Vector(point)
    base, height, distance = 100.0, 2000.0, 4e4
    haze._apply(black_plane[1], {"Color": (*COLOR, 1.0), "Distance": distance, "Base": base, "Height": height})
    steps = (np.arange(20000) + 0.5) / 20000
    z = eye.z + (point.z - eye.z) * steps
    density = np.exp(-np.maximum(z - base, 0.0) / height).mean()
    expected = 1.0 - math.exp(-density * (point - eye).length / distance)
    np.testing.assert_allclose(render(scene, tmp_path, eye, point), np.array(COLOR) * expected, rtol=0.02, atol=2e-3)


def test_the_terrain_has_haze_by_its_own_size(scene, add_terrain):
    terrain = add_terrain()
    assert SET_UP(haze=0.4) == {"FINISHED"}
    [material] = [slot.material for slot in terrain.material_slots]
    inputs = node_of(material).inputs
    imported = imported_of(terrain.adaptive_terrain)
    side, (low, high) = max(imported.extent_m), imported.heights_m
    assert math.exp(-side / inputs["Distance"].default_value) == pytest.approx(0.6, rel=1e-2)
    assert inputs["Base"].default_value == pytest.approx(low, abs=1e-3 * side)
    assert inputs["Height"].default_value == pytest.approx(max(high - low, 0.05 * side), rel=1e-2)
    assert material.cycles.emission_sampling == "NONE"
    SET_UP(haze=0.7)
    assert hazy() == [material.name] and len([n for n in material.node_tree.nodes if n.type == "GROUP"]) == 2
    assert math.exp(-side / inputs["Distance"].default_value) == pytest.approx(0.3, rel=1e-2)
    tree = material.node_tree
    SET_UP(haze=0.0)
    assert hazy() == []
    assert tree.get_output_node("ALL").inputs["Surface"].links[0].from_node.type == "BSDF_PRINCIPLED"


@pytest.mark.thorough
def test_new_plants_have_the_haze_of_the_terrain(scene, add_terrain):
    add_terrain()
    bpy.ops.adaptive_terrain.starter_add()
    assert hazy() == []
    SET_UP()
    terrain = bpy.context.object.active_material
    for material in list(bpy.data.materials):
        if material != terrain:
            bpy.data.materials.remove(material)
    for collection in list(bpy.data.collections):
        if "adaptive_terrain_starter" in collection:
            bpy.data.collections.remove(collection)
    bpy.ops.adaptive_terrain.starter_add()
    assert set(hazy()) == {terrain.name, "Bark", "Needles", "Leaves", "Grass", "Stone"}
    distance = node_of(terrain).inputs["Distance"].default_value
    assert node_of(bpy.data.materials["Bark"]).inputs["Distance"].default_value == distance


def test_materials_of_the_user_get_no_haze(scene, add_terrain):
    terrain, painted = add_terrain(), bpy.data.materials.new("Painted")
    terrain.data.materials.append(painted)
    tree_of_new(painted)
    SET_UP()
    assert hazy() == [] and terrain.active_material == painted
