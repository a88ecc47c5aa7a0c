# SPDX-License-Identifier: GPL-3.0-or-later
"""Set Up Scene: its parts, a second click, and everything of the user's that stays."""

import math
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.bridge.camera import view_from_camera
from adaptive_terrain.operators.layers.properties import add_default_layers
from adaptive_terrain.operators.scene import defaults, viewpoint
from adaptive_terrain.operators.scene.built import CAMERA, SKY, SUN, find_built
from adaptive_terrain.operators.scene.daylight import SKY_TYPES
from adaptive_terrain.operators.terrain import sight
from mathutils import Matrix
from rendered_pictures import pixels_of

SET_UP = bpy.ops.adaptive_terrain


def made(scene):
    return sorted(f"{item.type} {item.name}" for item in (find_built(scene, role) for role in (SUN, CAMERA)))


def sky_of(scene):
    return next(node for node in scene.world.node_tree.nodes if node.type == "TEX_SKY")


def test_a_click_replaces_the_default_cube_and_lamp(factory, add_terrain):
    terrain = add_terrain()
    assert SET_UP.set_up_scene() == {"FINISHED"}
    assert sorted(factory.objects.keys()) == ["Camera", "Terrain", "Terrain Sun"]
    assert made(factory) == ["CAMERA Camera", "LIGHT Terrain Sun"], "the start-up file's camera is used"
    assert "Cube" not in bpy.data.meshes and "Light" not in bpy.data.lights
    assert factory.camera.name == "Camera" and factory.render.use_lock_interface
    assert sky_of(factory).sky_type in SKY_TYPES and not sky_of(factory).sun_disc
    assert terrain.active_material.node_tree.nodes
    view = view_from_camera(factory, factory.camera, factory.camera.matrix_world, (160, 90))
    box = sight.box_of(terrain)
    assert sight.is_in_sight(box, view) and not sight.is_cut_off(box, view)
    assert not sight.is_below_ground(terrain, np.array(factory.camera.location))
    assert factory.camera.data.clip_start <= 1.0 and factory.camera.data.clip_end < 10 * sight.diagonal(box)


def test_the_sky_has_its_sun_where_the_lamp_is(factory, add_terrain):
    add_terrain()
    SET_UP.set_up_scene(elevation=math.radians(40.0), turn=math.radians(90.0))
    towards = bpy.data.objects["Terrain Sun"].matrix_world.col[2].xyz
    ahead = -factory.camera.matrix_world.col[2].xyz
    assert math.degrees(math.asin(towards.z)) == pytest.approx(40.0, abs=1e-3)
    assert ahead.x * towards.y - ahead.y * towards.x < -0.7, "it stands to the right of the view"
    sky = sky_of(factory)
    level = math.cos(sky.sun_elevation)
    seen = math.sin(sky.sun_rotation) * level, math.cos(sky.sun_rotation) * level, math.sin(sky.sun_elevation)
    np.testing.assert_allclose(seen, towards, atol=1e-5)


def test_a_second_click_replaces_what_the_first_has_made(factory, add_terrain):
    terrain = add_terrain()
    SET_UP.set_up_scene()
    kinds = "objects", "lights", "cameras", "worlds", "materials", "node_groups", "meshes"
    before = {kind: sorted(getattr(bpy.data, kind).keys()) for kind in kinds}
    terrain.active_material.node_tree.nodes["Group"].inputs["Variation"].default_value = 0.9
    factory.view_settings.look, factory.view_settings.exposure = "None", 0.5
    bpy.data.objects["Terrain Sun"].rotation_euler.x = 0.0
    SET_UP.set_up_scene()
    assert {kind: sorted(getattr(bpy.data, kind).keys()) for kind in kinds} == before
    assert bpy.data.objects["Terrain Sun"].rotation_euler.x != 0.0
    assert terrain.active_material.node_tree.nodes["Group"].inputs["Variation"].default_value == pytest.approx(0.9)
    assert (factory.view_settings.look, factory.view_settings.exposure) == ("None", 0.5)


def test_changed_defaults_are_kept(factory, add_terrain):
    add_terrain()
    factory.objects["Cube"].data.vertices[0].co.x = -1.5
    factory.objects["Light"].data.energy = 900.0
    factory.camera.location.x += 1.0
    SET_UP.set_up_scene()
    assert {"Cube", "Light", "Camera", "Terrain Camera"} <= set(factory.objects.keys())
    assert factory.camera.name == "Terrain Camera"


@pytest.mark.parametrize("change", [("data.type", "ORTHO"), ("data.shift_x", 0.2), ("rotation_euler", (0.3, 0, 0.2))])
def test_a_changed_default_camera_is_kept(factory, add_terrain, change):
    add_terrain()
    camera, (name, value) = factory.camera, change
    owner = camera.data if name.startswith("data.") else camera
    setattr(owner, name.removeprefix("data."), value)
    place = camera.location.copy()
    SET_UP.set_up_scene()
    assert factory.camera.name == "Terrain Camera" and factory.camera.data.type == "PERSP"
    assert camera.location == place


def test_lamps_that_share_the_suns_data_stay(factory, add_terrain):
    add_terrain()
    SET_UP.set_up_scene()
    sun = factory.objects["Terrain Sun"]
    factory.collection.objects.link(sun.copy())
    other = bpy.data.objects.new("Second", sun.data)
    factory.collection.objects.link(other)
    assert SET_UP.set_up_scene() == {"FINISHED"}
    assert "Second" in factory.objects and other.data.energy > 0.0


def test_a_sun_of_two_scenes_stays(factory, add_terrain):
    add_terrain()
    SET_UP.set_up_scene()
    second = bpy.data.scenes.new("Second")
    second.collection.objects.link(factory.objects["Terrain Sun"])
    second.world = factory.world
    assert SET_UP.set_up_scene() == {"FINISHED"}
    assert second.objects.keys() == ["Terrain Sun"] and second.world is not None
    bpy.data.scenes.remove(second)


def copy_of(item, scene):
    """Return a copy with separate data, as Shift D makes it."""
    copy = item.copy()
    copy.data = item.data.copy()
    scene.collection.objects.link(copy)
    return copy


@pytest.mark.parametrize("swapped", [False, True])
def test_copies_of_what_it_has_made_stay(factory, add_terrain, swapped):
    """The user's copies may even have the names of the originals."""
    add_terrain()
    SET_UP.set_up_scene()
    items = [find_built(factory, role) for role in (SUN, CAMERA)]
    copies = [copy_of(item, factory) for item in items]
    world = factory.world.copy()
    for item, copy in zip((*items, find_built(factory, SKY)), (*copies, world), strict=True):
        if swapped:
            item.name, copy.name = "Old", item.name
    factory.world = world
    copies[1].location.x += 5.0
    before = copies[1].location.copy()
    assert SET_UP.set_up_scene() == {"FINISHED"}
    assert set(copies) <= set(factory.objects) and copies[1].location == before
    assert world.name in bpy.data.worlds and factory.world != world and world.use_fake_user
    assert find_built(factory, CAMERA) == items[1] and len([o for o in factory.objects if o.type == "LIGHT"]) == 1


def test_what_the_user_has_deleted_is_made_again(factory, add_terrain):
    add_terrain()
    SET_UP.set_up_scene()
    for role in (SUN, CAMERA):
        item = find_built(factory, role)
        item.users_collection[0].objects.unlink(item)
    assert SET_UP.set_up_scene() == {"FINISHED"}
    assert made(factory) == ["CAMERA Terrain Camera", "LIGHT Terrain Sun"]
    assert factory.camera == find_built(factory, CAMERA) == factory.objects["Terrain Camera"]
    assert [lamp.name for lamp in bpy.data.lights] == ["Terrain Sun"]


@pytest.mark.parametrize("scale", [(0, 0, 0), (1, 1, 0)])
def test_a_terrain_of_scale_zero_gives_one_error(factory, add_terrain, scale):
    terrain = add_terrain()
    terrain.scale = scale
    bpy.context.view_layer.update()
    names = set(factory.objects.keys())
    with pytest.raises(RuntimeError, match="'Terrain' has a scale of 0; expected another scale on each axis"):
        SET_UP.set_up_scene()
    assert set(factory.objects.keys()) == names


@pytest.mark.parametrize("attached", ["parent", "modifier", "animation", "name"])
def test_a_cube_in_use_is_kept(factory, add_terrain, attached):
    add_terrain()
    cube = factory.objects["Cube"]
    if attached == "parent":
        factory.objects["Light"].parent = cube
    elif attached == "modifier":
        cube.modifiers.new("Bevel", "BEVEL")
    elif attached == "animation":
        cube.keyframe_insert("location")
    else:
        cube.name = "House"
    SET_UP.set_up_scene()
    assert cube.name in factory.objects


def test_what_the_user_has_made_stays(scene, add_terrain):
    terrain, world = add_terrain(), bpy.data.worlds.new("Mine")
    scene.world = world
    lamp = bpy.data.objects.new("Evening", bpy.data.lights.new("Evening", "SUN"))
    lamp.rotation_euler, lamp.data.energy = (1.2, 0.0, 0.7), 2.0
    scene.collection.objects.link(lamp)
    material = bpy.data.materials.new("Painted")
    terrain.data.materials.append(material)
    bpy.context.view_layer.update()
    place = [list(row) for row in scene.objects["Camera"].matrix_world]
    SET_UP.set_up_scene()
    assert terrain.active_material == material
    assert "Terrain Sun" not in scene.objects and lamp.data.energy == 2.0
    assert sky_of(scene).sun_elevation == pytest.approx(math.pi / 2 - 1.2, abs=1e-5), "the sky follows the user's sun"
    assert [list(row) for row in scene.objects["Camera"].matrix_world] == place
    assert scene.world != world and world.use_fake_user


def test_without_a_store_nothing_changes(scene, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.store = ""
    with pytest.raises(RuntimeError, match="Import a height map first"):
        SET_UP.set_up_scene()
    terrain.adaptive_terrain.store = "/nowhere"
    names = set(bpy.data.objects.keys())
    with pytest.raises(RuntimeError, match="nowhere"):
        SET_UP.set_up_scene()
    assert set(bpy.data.objects.keys()) == names


@pytest.mark.parametrize(
    ("transform", "elevation"),
    [("AgX", 8.0), pytest.param("AgX", 24.0, marks=pytest.mark.thorough), ("Standard", 60.0)],
)
def test_pictures_are_neither_black_nor_burnt(factory, add_terrain, tmp_path, transform, elevation):
    """Cycles renders it; the sky keeps its colour, and the ground has light and shade."""
    terrain = add_terrain()
    factory.view_settings.view_transform = transform
    SET_UP.set_up_scene(elevation=math.radians(elevation))
    terrain.adaptive_terrain.render.error_px = 4.0
    render = factory.render
    render.engine, factory.cycles.samples, factory.cycles.device = "CYCLES", 4, "CPU"
    factory.cycles.use_denoising = False
    render.resolution_x, render.resolution_y, render.resolution_percentage = 96, 54, 100
    render.filepath, render.image_settings.file_format = str(tmp_path / "a.png"), "PNG"
    bpy.ops.render.render(write_still=True)
    pixels = pixels_of(tmp_path / "a.png")[..., :3]
    assert 0.2 < pixels.mean() < 0.75
    assert (pixels.min(axis=2) > 0.97).mean() < 0.05 and (pixels.max(axis=2) < 0.03).mean() < 0.15
    assert pixels[:18].std() > 0.03, "the ground is not flat"


@pytest.mark.parametrize("changed", [False, True])
def test_default_layers_give_way_to_those_that_suit_the_land(factory, changed):
    bpy.ops.mesh.adaptive_terrain_add(land="DUNES")
    settings = bpy.context.object.adaptive_terrain
    assert [layer.name for layer in settings.layers] == ["Grass", "Scree", "Rock", "Snow"]
    if changed:
        settings.layers[1].slope.low += 0.01
    SET_UP.set_up_scene()
    assert ("Sand" in [layer.name for layer in settings.layers]) != changed


def test_low_land_gets_layers_without_snow(factory, add_terrain):
    """Default layers that the user has changed stay."""
    terrain = add_terrain()
    settings = terrain.adaptive_terrain
    add_default_layers(settings)
    settings.layers["Snow"].color = (1.0, 0.0, 0.0)
    SET_UP.set_up_scene()
    assert settings.layers.keys() == ["Grass", "Scree", "Rock", "Snow"]
    settings.layers.clear()
    add_default_layers(settings)
    for material in bpy.data.materials[:]:
        bpy.data.materials.remove(material)
    terrain.data.materials.clear()
    SET_UP.set_up_scene()
    assert "Snow" not in settings.layers and len(settings.layers) > 3


def test_the_viewport_looks_through_a_new_camera(factory, add_terrain, monkeypatch):
    """It does not enter the view of a user's camera, which stays if the viewport looks through it already."""
    add_terrain()
    entered, eye = [], Matrix.Translation((100.0, -900.0, 400.0)) @ Matrix.Rotation(1.2, 4, "X")
    region_3d = SimpleNamespace(view_perspective="PERSP", view_matrix=eye.inverted())
    area = SimpleNamespace(spaces=SimpleNamespace(active=SimpleNamespace(lens=50.0)))
    monkeypatch.setattr(viewpoint, "viewport_of", lambda context: (None, area, None, region_3d))
    monkeypatch.setattr(viewpoint, "look_through_camera", lambda *viewport: entered.append(viewport[-1]))
    SET_UP.set_up_scene()
    bpy.context.view_layer.update()
    assert entered == [region_3d]
    np.testing.assert_allclose(factory.camera.matrix_world, eye, atol=1e-3)
    mine = bpy.data.objects.new("Mine", bpy.data.cameras.new("Mine"))
    factory.collection.objects.link(mine)
    factory.camera, region_3d.view_perspective = mine, "CAMERA"
    SET_UP.set_up_scene()
    assert factory.camera == mine and mine.location.length == 0.0 and len(entered) == 1


@pytest.mark.parametrize("turned", [False, True])
def test_only_an_unturned_viewport_is_replaced(turned):
    region_3d = SimpleNamespace(view_perspective="PERSP", view_rotation=[0.712376, 0.441062, 0.287358, 0.464123])
    if turned:
        region_3d.view_rotation = [0.7071, 0.4410, 0.2873, 0.4723]
    assert defaults.is_default_view(region_3d) != turned
