# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked meshes look like their terrain: attributes, modifiers, transforms, maps and shaped land."""

import json
import struct
from unittest.mock import Mock

import addon_utils
import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes.catalogue import ATTRIBUTES
from adaptive_terrain.cbt_terrain.height_operators import derived_store
from adaptive_terrain.operators.export.bake_terrain import BakeTerrain, bake_object
from adaptive_terrain.operators.ground.viewshed import NAME as VIEWSHED
from adaptive_terrain.operators.layers.properties import add_default_layers
from adaptive_terrain.operators.maps.images import map_image
from adaptive_terrain.operators.session import session
from blender_meshes import values_of
from demand_trees import Moved, colour, mix, new_material, shows
from land_scenes import add
from modal_runs import running

ERROR_M = 3.0


@pytest.fixture
def add_same(add_terrain):
    """Return a function that adds a terrain whose render has the mesh of its bake: the same error, no camera."""

    def add_one(name="Terrain", reads=()):
        obj = add_terrain(name)
        detail = obj.adaptive_terrain.render
        detail.error_px, detail.error_m = 0.0, ERROR_M
        obj.adaptive_terrain.bake_error_m = ERROR_M
        if reads:
            obj.data.materials.append(reading(name, *reads))
        return obj

    return add_one


def reading(name, *attributes):
    """Return a material that shows a mix of attributes."""

    def mixed(tree):
        socket = colour(tree, attributes[0])
        for other in attributes[1:]:
            socket = mix(tree, 0.5, socket, colour(tree, other)).outputs[2]
        return socket

    return shows(new_material(name), mixed)


def refine(obj, mode="RENDER"):
    session.update_object(obj, mode=mode)
    bpy.context.view_layer.update()


def bake(obj, fitted=False):
    baked, _ = bake_object(obj, bpy.context.evaluated_depsgraph_get(), ERROR_M, fitted)
    bpy.context.view_layer.update()
    return baked


def made(mesh):
    return {name for name in ATTRIBUTES if name in mesh.attributes}


def evaluated_mesh(obj):
    return obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data


def assert_same(mesh, other, *names):
    for name in ("position", *names):
        assert mesh.attributes[name].domain == other.attributes[name].domain
        assert np.array_equal(values_of(mesh, name), values_of(other, name)), name


def test_a_baked_mesh_has_the_values_of_its_terrain(scene, add_same):
    terrain = add_same()
    add_default_layers(terrain.adaptive_terrain)
    assert bpy.ops.adaptive_terrain.terrain_material() == {"FINISHED"}
    terrain.location, terrain.rotation_euler, terrain.scale = (5.0, 6.0, 7.0), (0.1, 0.2, 0.9), (2.0, 3.0, 1.5)
    refine(terrain)
    baked = bake(terrain)
    assert made(baked.data) == made(terrain.data) == {"splat_1"}
    assert_same(baked.data, terrain.data, "splat_1", "UVMap")
    assert np.ptp(values_of(baked.data, "splat_1"), axis=0).max() > 0.5
    assert baked.matrix_world == terrain.matrix_world and not baked.adaptive_terrain.enabled
    assert baked.adaptive_terrain.store == "" and terrain.adaptive_terrain.store


def test_common_vertices_near_the_camera_agree(scene, add_terrain):
    """There the terrain's attributes have the raster's scale, too."""
    terrain = add_terrain()
    terrain.data.materials.append(reading("Rock", "slope", "height"))
    scene.camera.location, scene.camera.rotation_euler = (0.0, 0.0, 150.0), (0.0, 0.0, 0.0)
    terrain.adaptive_terrain.render.error_px = 4.0
    refine(terrain)
    baked = bake(terrain)
    row_of = {point.tobytes(): row for row, point in enumerate(values_of(terrain.data, "position"))}
    rows = [row_of.get(point.tobytes(), -1) for point in values_of(baked.data, "position")]
    there = np.array(rows) >= 0
    assert there.sum() > 100
    for name in ("slope", "height"):
        assert np.array_equal(values_of(baked.data, name)[there], values_of(terrain.data, name)[np.array(rows)[there]])


def test_two_terrains_keep_their_own_demands(scene, add_same):
    first, second = add_same("First", ["slope"]), add_same("Second", ["height", "aspect"])
    refine(first), refine(second)
    baked = bake(first), bake(second)
    assert [made(obj.data) for obj in baked] == [{"slope"}, {"height", "aspect"}]
    assert_same(baked[0].data, first.data, "slope")
    assert_same(baked[1].data, second.data, "height", "aspect")


def test_an_attribute_that_is_switched_off_is_not_baked(scene, add_same):
    terrain = add_same(reads=["slope", "height"])
    terrain.adaptive_terrain.effects.slope.when = "OFF"
    assert made(bake(terrain).data) == {"height"}


def test_pinned_attributes_are_baked(scene, add_same):
    terrain = add_same()
    terrain.adaptive_terrain.effects.wetness.when = "PINNED"
    assert made(bake(terrain).data) == {"wetness"}


def test_geometry_nodes_work_on_the_baked_mesh(scene, add_same):
    """They read an attribute at the scale of geometry, and only renders use them."""
    terrain = add_same()
    moved = Moved(terrain)
    moved.reads("slope")
    moved.modifier.show_viewport = False
    terrain.adaptive_terrain.effects.geometry_metres = 80.0
    refine(terrain)
    baked = bake(terrain)
    assert_same(baked.data, terrain.data, "slope")
    assert [(modifier.name, modifier.node_group) for modifier in baked.modifiers] == [("Nodes", moved.tree)]
    for obj in (terrain, baked):
        obj.modifiers["Nodes"].show_viewport = True
    assert (values_of(evaluated_mesh(baked), "position") - values_of(baked.data, "position")).mean() > 0.1
    assert_same(evaluated_mesh(baked), evaluated_mesh(terrain))


def test_a_viewshed_stays_on_the_baked_mesh(scene, add_same):
    terrain = add_same(reads=[VIEWSHED])
    terrain.select_set(True)
    assert bpy.ops.adaptive_terrain.viewshed() == {"FINISHED"}
    refine(terrain)
    baked = bake(terrain)
    assert_same(evaluated_mesh(baked), evaluated_mesh(terrain), VIEWSHED)
    assert 0.0 < values_of(evaluated_mesh(baked), VIEWSHED).mean() < 1.0


def test_a_sheared_terrain_is_baked_in_its_place(scene, add_same):
    parent = bpy.data.objects.new("Parent", None)
    scene.collection.objects.link(parent)
    parent.scale, parent.rotation_euler = (3.0, 1.0, 0.5), (0.0, 0.3, 0.4)
    terrain = add_same(reads=["slope"])
    terrain.parent, terrain.rotation_euler, terrain.delta_location = parent, (0.0, 0.0, 0.7), (1.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    assert bake(terrain).matrix_world == terrain.matrix_world


def test_slots_of_the_object_keep_their_materials(scene, add_same):
    terrain = add_same()
    terrain.data.materials.append(reading("Of the mesh", "height"))
    terrain.material_slots[0].link = "OBJECT"
    terrain.material_slots[0].material = reading("Of the object", "slope")
    baked = bake(terrain)
    assert baked.active_material.name == "Of the object" and made(baked.data) == {"slope"}


def groups_in(material) -> list[str]:
    """Return the names of a material's node groups without numbers."""
    trees = (node.node_tree for node in material.node_tree.nodes if node.type == "GROUP")
    return sorted(tree.name.split(".")[0] for tree in trees)


def test_the_land_of_a_scene_is_exported_without_glow(scene, add_same, tmp_path):
    """The haze of the air is no light of the ground, for Blender's glTF exporter nor for an image that is baked."""
    terrain = add_same()
    assert bpy.ops.adaptive_terrain.set_up_scene() == {"FINISHED"}
    baked, material = bake(terrain), terrain.active_material
    assert groups_in(material) == ["Terrain Haze", "Terrain Layers"] and terrain.active_material == material
    assert groups_in(baked.active_material) == ["Terrain Layers"] and len(baked.material_slots) == 1
    for obj in scene.objects:
        obj.select_set(obj == baked)
    addon_utils.enable("io_scene_gltf2")
    file = tmp_path / "baked.glb"
    bpy.ops.export_scene.gltf(filepath=str(file), use_selection=True, export_current_frame=True)
    data = file.read_bytes()
    [exported] = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]])["materials"]
    assert "emissiveFactor" not in exported and exported.get("extensions", {}).keys() <= {"KHR_materials_specular"}
    assert exported["pbrMetallicRoughness"] == {"metallicFactor": 0, "roughnessFactor": pytest.approx(0.9)}


def test_a_baked_mesh_keeps_its_layers_when_the_land_changes(scene, add_same):
    """Its material is a copy without haze, also in a slot of the object."""
    terrain = add_same()
    assert bpy.ops.adaptive_terrain.set_up_scene() == {"FINISHED"}
    material = terrain.active_material
    terrain.material_slots[0].link = "OBJECT"
    terrain.material_slots[0].material = material
    baked = bake(terrain)
    assert groups_in(baked.active_material) == ["Terrain Layers"]
    [node] = [node for node in baked.active_material.node_tree.nodes if node.type == "GROUP"]
    names = node.inputs.keys()
    bpy.context.view_layer.objects.active = terrain
    terrain.adaptive_terrain.layers[0].name = "Moss"
    assert bpy.ops.adaptive_terrain.terrain_material() == {"FINISHED"}
    assert terrain.active_material == material and node.inputs.keys() == names and "Moss" not in names


def test_baked_maps_show_on_the_baked_mesh(scene, add_same, tmp_path):
    terrain = add_same()
    maps = terrain.adaptive_terrain.maps
    add_default_layers(terrain.adaptive_terrain)
    maps.folder, maps.chosen = str(tmp_path / "maps"), {"splat_1"}
    assert bpy.ops.adaptive_terrain.bake_maps() == {"FINISHED"}
    assert bpy.ops.adaptive_terrain.terrain_material() == {"FINISHED"}
    refine(terrain)
    baked = bake(terrain)
    assert map_image(terrain, "splat_1").users and made(baked.data) == made(terrain.data)
    assert_same(baked.data, terrain.data, "UVMap")
    assert baked.data.uv_layers.active.name == "UVMap"


@pytest.mark.parametrize("fitted", (False, True))
def test_cut_and_fitted_meshes_have_their_attributes(scene, add_same, fitted):
    terrain = add_same(reads=["slope", "height"])
    cleanup = terrain.adaptive_terrain.cleanup
    cleanup.use_below, cleanup.below = True, 0.0
    baked = bake(terrain, fitted)
    assert made(baked.data) == {"slope", "height"}
    height, z = values_of(baked.data, "height"), values_of(baked.data, "position")[:, 2]
    assert len(z) > 100 and z.min() == 0.0 and np.abs(height - z).max() < 2 * ERROR_M


def test_meshlets_of_the_render_have_attributes(scene, add_same):
    terrain = add_same(reads=["slope"])
    plain = len(bake(terrain).data.polygons)
    terrain.adaptive_terrain.render.meshlet, terrain.adaptive_terrain.viewport.meshlet = 2, 0
    refine(terrain)
    baked = bake(terrain)
    assert len(baked.data.polygons) > plain
    assert_same(baked.data, terrain.data, "slope")


def test_the_active_colour_stays_active(scene, add_same):
    terrain = add_same(reads=["splat_1", "color"])
    refine(terrain)
    colours = terrain.data.color_attributes
    colours.active_color_index = colours.render_color_index = len(colours) - 1
    refine(terrain)
    baked, name = bake(terrain), colours.active_color.name
    assert baked.data.color_attributes.active_color.name == name == baked.data.attributes.default_color_name


def test_a_hidden_terrain_is_baked_with_its_shaped_land(terrain, shaped):
    session.update_object(terrain)
    open_now = bake(terrain)
    terrain.hide_set(True)
    terrain.hide_render = True
    hidden = bake(terrain)
    assert_same(hidden.data, open_now.data)
    bpy.context.view_layer.objects.active = terrain
    terrain.adaptive_terrain.land.entries[0].on = False
    assert not np.array_equal(values_of(bake(terrain).data, "position")[:, 2], values_of(hidden.data, "position")[:, 2])
    assert not hidden.hide_render and hidden.visible_get()


def test_a_click_refuses_land_that_is_not_shaped(terrain):
    add("scree")
    operator = running(BakeTerrain, terrain)
    assert operator.began == {"CANCELLED"}
    kind, message = operator.report.call_args.args
    assert kind == {"ERROR"} and "press Shape Now" in message
    assert not any("baked" in obj.name for obj in bpy.data.objects) and derived_store.counts["stores"] == 0


def test_attributes_are_computed_before_anything_is_added(scene, add_same, monkeypatch):
    terrain = add_same(reads=["slope"])
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.attributes.evaluate.evaluate", Mock(side_effect=MemoryError))
    before = len(bpy.data.objects), len(bpy.data.meshes)
    with pytest.raises(MemoryError):
        bake(terrain)
    assert (len(bpy.data.objects), len(bpy.data.meshes)) == before
