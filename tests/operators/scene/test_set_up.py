# SPDX-License-Identifier: GPL-3.0-or-later
"""Set Up Scene: its parts, a second click, and everything of the user's that stays."""

import math
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.query.largest_part import PartSamples
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.operators.bridge.camera import view_from_camera
from adaptive_terrain.operators.importing.imported import imported_of
from adaptive_terrain.operators.land import shaped_land
from adaptive_terrain.operators.layers.properties import add_default_layers
from adaptive_terrain.operators.scene import defaults, viewpoint
from adaptive_terrain.operators.scene.built import CAMERA, SKY, SUN, find_built
from adaptive_terrain.operators.scene.daylight import SKY_TYPES
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain import sight
from land_scenes import add
from mathutils import Matrix
from mosaic_files import EAST, NORTH, sheet
from rasterio import Affine
from rasters import write_raster
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


def test_the_view_across_shows_water_and_hides_the_border():
    """A lake lies in a bowl of mountains with an opening in the south."""
    x = np.linspace(-5000.0, 5000.0, 129)
    east_m, north_m = np.meshgrid(x, x)
    rim = np.minimum(np.hypot(east_m, np.maximum(north_m, 0.0)) / 5000.0, 1.0) ** 3
    z = np.where(np.hypot(east_m - 800.0, north_m) < 1200.0, 90.0, 100.0 + 1500.0 * rim)
    part = PartSamples(x, x, z, np.ones(z.shape, bool))
    (east, north, height), azimuth = viewpoint._best_view(part, 90.0)
    ahead = np.array([math.sin(azimuth), math.cos(azimuth)])

    to_lake = np.array([800.0 - east, -north])
    assert ahead @ to_lake / np.linalg.norm(to_lake) > math.cos(math.radians(30.0))
    assert ahead[1] > -0.5, "it does not look out of the open side"
    assert 90.0 < height < 1200.0
    moved, turned = viewpoint._best_view(part._replace(x=x + 16384.0, y=x - 8192.0), 90.0)  # with the anchor elsewhere
    assert moved == (east + 16384.0, north - 8192.0, height) and turned == azimuth


def test_the_highest_of_a_range_is_well_inside_the_view():
    """A range along one side of a plain rises in the frame's middle, and does not lean to a corner."""
    x = np.linspace(-12_000.0, 12_000.0, 129)
    east_m, north_m = np.meshgrid(x, x)
    range_m = 1800.0 * np.exp(-(((east_m + 5000.0) / 3500.0) ** 2))
    z = 400.0 - 0.02 * east_m + range_m * (0.75 + 0.25 * np.sin(north_m / 1300.0) * np.cos(east_m / 1700.0))
    eye, azimuth = viewpoint._best_view(PartSamples(x, x, z, np.ones(z.shape, bool)), float(np.quantile(z, 0.05)))
    degrees = np.arange(-32, 33)  # across the frame
    skyline = []
    for angle in azimuth + np.radians(degrees):
        away = np.arange(300.0, 24_000.0, 100.0)
        at = np.stack([eye[1] + math.cos(angle) * away, eye[0] + math.sin(angle) * away], axis=1)
        away, at = away[(abs(at) <= 12_000.0).all(axis=1)], at[(abs(at) <= 12_000.0).all(axis=1)]
        row, column = np.rint((at + 12_000.0) / 187.5).astype(int).T
        skyline.append(((z[row, column] - eye[2]) / away).max())
    top = math.tan(viewpoint.PITCH + math.atan(viewpoint.SENSOR_MM / 2 / viewpoint.LENS_MM * 9 / 16))
    assert abs(degrees[np.argmax(skyline)]) <= 18 and 0.08 < max(skyline) < 0.9 * top
    assert abs(skyline[0] - skyline[-1]) < 0.06 and min(skyline) > 0.0, "the border is hidden by the range"


@pytest.mark.parametrize("gap", ["island", "valley", "lake"])
def test_the_view_across_stands_on_ground(factory, add_terrain, tmp_path, gap):
    """It does with a small island in a large hole, a narrow valley along a diagonal, and a large hole in the middle."""
    heights = 40.0 * np.sin(np.mgrid[0:401, 0:401][1] / 9.0) + 50.0
    row, column = np.mgrid[0:401, 0:401]
    is_ground = {
        "island": (abs(row - 330) < 30) & (abs(column - 60) < 40),
        "valley": abs(row - column - 20) < 12,
        "lake": np.hypot(row - 200, column - 200) > 120,
    }[gap]
    raster = np.where(is_ground, heights, np.nan).astype(np.float32)
    write_raster(
        tmp_path / "land.tif", raster[::-1], transform=Affine(10.0, 0.0, 0.0, 0.0, -10.0, 4010.0), nodata=np.nan
    )
    run_import(ImportSettings(str(tmp_path / "land.tif"), holes=True), tmp_path / "store")
    terrain = add_terrain()
    terrain.adaptive_terrain.store = str(tmp_path / "store")
    to_world, distance, _ = viewpoint.view_across(terrain, bpy.context.evaluated_depsgraph_get())
    eye, ahead = np.array(to_world.translation), -np.array(to_world.col[2].xyz)
    along = eye[:2] + np.linspace(0.0, 300.0, 31)[:, None] * ahead[:2]  # metres from the eye
    at = np.rint(along / 10.0 + 200.0).astype(int)
    inside = (at >= 0).all(axis=1) & (at <= 400).all(axis=1)
    seen = is_ground[at[inside, 1], at[inside, 0]]
    assert seen[0] and seen.mean() * inside.mean() > 0.8
    assert 0.0 < eye[2] - heights[at[0, 1], at[0, 0]] < 150.0
    assert distance < 1000.0 if gap == "island" else distance > 2000.0


@pytest.mark.parametrize("quick", [0, 2000])
def test_the_view_across_stands_on_a_file_of_a_mosaic(factory, add_terrain, tmp_path, quick):
    """The gap beside the diagonal of its files is filled. A quick import has every 16th sample."""
    for k in range(9):
        one = sheet("EPSG:32632", EAST + 500.0 * k, NORTH - 500.0 * k, 10.0, 10.0, 50, 50)
        one.write(tmp_path / "files" / f"{k}.tif")
    run_mosaic_import(ImportSettings(str(tmp_path / "files"), quick=quick), tmp_path / "store")
    terrain = add_terrain()
    terrain.adaptive_terrain.store = str(tmp_path / "store")
    to_world, *_ = viewpoint.view_across(terrain, bpy.context.evaluated_depsgraph_get())
    eye, ahead = np.array(to_world.translation), -np.array(to_world.col[2].xyz)
    for metres in (0.0, 150.0):
        # The files' diagonal goes from the north-west to the south-east; it is 500 m wide along both axes.
        assert abs(eye[0] + eye[1] + metres * (ahead[0] + ahead[1])) < 500.0
    assert imported_of(terrain.adaptive_terrain).raster == ((30, 30) if quick else (450, 450))


def test_the_view_across_is_over_the_shaped_land(terrain, capfd, monkeypatch):
    source, note, fields = terrain.adaptive_terrain.store, "The view was composed for the unshaped land", []
    ground_of = viewpoint._ground_of
    monkeypatch.setattr(viewpoint, "_ground_of", lambda field, *more: fields.append(field) or ground_of(field, *more))

    def set_up() -> str:
        """Return the report of Set Up Scene."""
        capfd.readouterr()
        assert SET_UP.set_up_scene(view="ACROSS") == {"FINISHED"}
        return capfd.readouterr().out

    assert note not in set_up(), "there is no stack"
    add("scree", scree_angle=0.4)
    session.clear()
    assert note in set_up(), "it was never updated"
    session.update_object(terrain)
    assert note in set_up(), "a preview is shown"
    assert bpy.ops.adaptive_terrain.shape() == {"FINISHED"}
    shaped = shaped_land.store_of(terrain)
    session.clear()
    assert shaped_land.store_of(terrain) == source != shaped, "no update has shown the shaped land"
    assert note not in set_up()
    assert [str(field.path) for field in fields] == [source, source, source, shaped]
    terrain.adaptive_terrain.land.entries[0].on = False
    assert note not in set_up() and str(fields[-1].path) == source


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
