# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps in Blender: baked for a camera, found again as images, and shading as the full mesh does."""

import json

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import sizing, tiling
from adaptive_terrain.cbt_terrain.attributes.folder import JSON_NAME, read_index
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.operators.bridge.demand.trees import tree_of_new
from adaptive_terrain.operators.bridge.writer import write_mesh
from adaptive_terrain.operators.cli.command_line import main
from adaptive_terrain.operators.maps import images as map_images
from adaptive_terrain.operators.maps import request as map_request
from adaptive_terrain.operators.session import session
from map_scenes import bake, keys
from rendered_pictures import rendered


@pytest.fixture
def small_tiles(monkeypatch):
    monkeypatch.setattr(tiling, "SINGLE_CELLS", 32)
    monkeypatch.setattr(tiling, "TILE_CELLS", 60)


def wear(obj, name: str | None = "detail_normal") -> None:
    """Give the object a diffuse material with a baked normal.

    Blender versions differ in the surface of an object without material.
    """
    material = bpy.data.materials.new("worn")
    tree = tree_of_new(material)
    tree.nodes.clear()
    diffuse, out = tree.nodes.new("ShaderNodeBsdfDiffuse"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(diffuse.outputs[0], out.inputs["Surface"])
    obj.data.materials.clear()
    obj.data.materials.append(material)
    if name is None:
        return
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image, texture.extension = map_images.map_image(obj, name), "EXTEND"
    tree.links.new(map_images.map_vector(tree, obj), texture.inputs["Vector"])
    bump = tree.nodes.new("ShaderNodeNormalMap")
    bump.space = "OBJECT"
    tree.links.new(texture.outputs["Color"], bump.inputs["Color"])
    tree.links.new(bump.outputs["Normal"], diffuse.inputs["Normal"])


def light_and_camera(size: float) -> None:
    scene = bpy.context.scene
    sun = bpy.data.lights.new("sun", "SUN")
    sun.use_shadow, sun.angle, sun.energy = False, 0.0, 3.0
    lamp = bpy.data.objects.new("sun", sun)
    lamp.rotation_euler = 0.7, 0.3, 0.0
    camera = bpy.data.objects.new("above", bpy.data.cameras.new("above"))
    camera.data.type, camera.data.ortho_scale, camera.data.clip_end = "ORTHO", size, 1e6
    camera.location = 0, 0, 1e5
    for obj in (lamp, camera):
        scene.collection.objects.link(obj)
    scene.camera = camera
    scene.render.resolution_x = scene.render.resolution_y = 96
    scene.cycles.max_bounces = 0


@pytest.mark.parametrize("tiled", [pytest.param(False, marks=pytest.mark.thorough), True])
def test_a_normal_map_shades_a_coarse_mesh_like_the_full_one(terrain, tmp_path, request, tiled):
    if tiled:
        request.getfixturevalue("small_tiles")
    obj = terrain
    obj.adaptive_terrain.maps.frames = "WHOLE"
    obj.rotation_euler, obj.scale = (0, 0, 0.4), (1.5, 1.5, 1.0)
    field = session.open_field(bpy.path.abspath(obj.adaptive_terrain.store))
    west, south, east, _ = field.lattice.rectangle()
    bake(obj)
    obj.adaptive_terrain.enabled = False  # a render would write its own mesh
    image = map_images.map_image(obj, "detail_normal")
    assert (image.source == "TILED") == tiled and map_images.map_image(obj, "detail_normal") == image
    light_and_camera(0.9 * (east - west))
    relief = field.max_height - field.min_height
    pictures = {}
    for name, error in (("full", relief * 1e-3), ("coarse", relief * 0.05), ("mapped", relief * 0.05)):
        wear(obj, "detail_normal" if name == "mapped" else None)
        write_mesh(obj.data, Terrain(field).update(Criterion(error_px=0.0, error_m=error)).surface)
        pictures[name] = rendered(tmp_path / f"{name}.exr", 16)[..., 0]
    off = {name: float(np.sqrt(((pictures[name] - pictures["full"]) ** 2).mean())) for name in ("coarse", "mapped")}
    assert pictures["full"].mean() > 0.1
    # What is left: the store's finest waves are shorter than two samples, and a spline draws them otherwise.
    assert off["mapped"] < 0.5 * off["coarse"], off


def test_only_what_a_nearer_camera_needs_is_baked_again(terrain, small_tiles, monkeypatch):
    monkeypatch.setattr(sizing, "MIN_SIDE", 8)
    camera = bpy.context.scene.camera
    camera.location *= 20.0
    bake(terrain)
    before = keys(terrain)
    camera.rotation_euler.z += 2.0
    bake(terrain)
    assert keys(terrain) == before
    camera.location *= 0.6
    bake(terrain)
    changed = {file for file, key in keys(terrain).items() if before[file] != key}
    assert changed


def test_an_undo_leaves_the_maps_to_their_terrain(terrain):
    bake(terrain)
    maps, folder = terrain.adaptive_terrain.maps, map_images.map_folder(terrain)
    times = {file: file.stat().st_mtime_ns for file in folder.glob("*.png")}
    maps.mark = ""  # as an Undo to before the bake leaves it
    assert map_images.index_of(terrain) is None
    bake(terrain)
    assert map_images.map_folder(terrain) == folder and map_images.index_of(terrain) is not None
    assert times and times == {file: file.stat().st_mtime_ns for file in folder.glob("*.png")}, "nothing is made again"


def test_a_terrain_of_another_name_keeps_its_maps(terrain):
    bake(terrain)
    folder, image = map_images.map_folder(terrain), map_images.map_image(terrain, "detail_normal")
    terrain.name = "Valley"
    assert map_images.map_folder(terrain) == folder and map_images.map_image(terrain, "detail_normal") == image
    wear(terrain)
    assert map_request.maps_shown_by_materials(terrain) == {"detail_normal"}, "a farm's job takes them along"


def test_a_material_with_maps_of_other_heights_is_noted(terrain):
    assert map_images.outdated_note(terrain) == ""
    bake(terrain)
    wear(terrain)
    assert map_images.outdated_note(terrain) == ""
    index = map_images.map_folder(terrain) / JSON_NAME
    content = json.loads(index.read_text())
    index.write_text(json.dumps(content | {"height_field": "of other heights"}))
    assert map_images.outdated_note(terrain) == map_images.OUTDATED
    index.write_text(json.dumps(content))
    terrain.adaptive_terrain.maps.folder += "_moved"  # as another folder of stores
    assert map_images.outdated_note(terrain) == map_images.OUTDATED
    wear(terrain, None)
    assert map_images.outdated_note(terrain) == ""


def test_maps_of_several_terrains_are_apart(terrain, add_terrain):
    other = add_terrain()
    for obj in (terrain, other):
        obj.adaptive_terrain.maps.folder = ""
        bpy.context.view_layer.objects.active = obj
        bake(obj)
    other.adaptive_terrain.vertical_scale = 3.0
    bake(other)
    assert map_images.map_folder(terrain) != map_images.map_folder(other)
    assert keys(terrain) != keys(other)
    assert map_images.map_image(terrain, "detail_normal") != map_images.map_image(other, "detail_normal")
    assert map_images.map_image(terrain, "slope") is None


def test_terrains_of_one_name_in_two_files_use_two_folders(terrain, add_terrain, tmp_path):
    bake(terrain)
    first, folder = map_images.map_folder(terrain), terrain.adaptive_terrain.maps.folder
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "first.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    other = add_terrain()
    other.adaptive_terrain.maps.folder = folder
    assert map_images.map_image(other, "detail_normal") is None
    bake(other)
    assert map_images.map_folder(other) != first and map_images.map_folder(other).parent == first.parent
    copy = other.copy()
    copy.name = "TERRAIN"
    bpy.context.scene.collection.objects.link(copy)
    bpy.context.view_layer.objects.active = copy
    bake(copy)
    assert str(map_images.map_folder(copy)).casefold() != str(map_images.map_folder(other)).casefold()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "first.blend"))
    again = bpy.data.objects["Terrain"]
    assert map_images.map_folder(again) == first and map_images.map_image(again, "detail_normal") is not None


def turned_empty(terrain, name: str, data: bool) -> tuple:
    """Add an image on a turned, scaled, tilted empty over a terrain like it; return the empty and the pixels."""
    image = bpy.data.images.new(name, 24, 16, alpha=True, is_data=data)
    shown = np.random.default_rng(len(name)).integers(64, 192, (2, 3, 4)).repeat(8, 0).repeat(8, 1) / 255
    image.pixels.foreach_set(shown.astype(np.float32).ravel())
    empty = bpy.data.objects.new(name, None)
    empty.empty_display_type, empty.data, empty.empty_display_size = "IMAGE", image, 3.0
    empty.location, empty.rotation_euler, empty.scale = (60, -80, 500), (0.3, 0.2, 0.9), (200.0, 150.0, 7.0)
    empty.empty_image_offset = -0.4, -0.7
    empty.parent = terrain
    bpy.context.scene.collection.objects.link(empty)
    return empty, shown


def under(terrain, empty, side: int) -> tuple[np.ndarray, ...]:
    """Row and column of an empty's image of 16 x 24 pixels above each texel of a map of the whole terrain, south first;
    and where it is inside."""
    west, south, east, north = session.open_field(terrain.adaptive_terrain.store).lattice.rectangle()
    flat = (terrain.matrix_world.inverted() @ empty.matrix_world).to_3x3()
    centre = (terrain.matrix_world.inverted() @ empty.matrix_world).translation
    flat[0][2], flat[1][2], flat[2] = 0.0, 0.0, (0.0, 0.0, 1.0)
    back = np.array(flat.inverted())
    y, x = (np.mgrid[0:side, 0:side] + 0.5) / side
    x, y = west + x * (east - west) - centre.x, south + y * (north - south) - centre.y
    u = (back[0, 0] * x + back[0, 1] * y) / 3.0 + 0.4  # 3: the empty's size, that of its longer side
    v = (back[1, 0] * x + back[1, 1] * y) / 2.0 + 0.7
    row, column = np.clip(v * 16, 0, 15).astype(int), np.clip(u * 24, 0, 23).astype(int)
    # A pixel in from where pixels differ: between their centres they mix.
    calm = [(abs(place * count / 8 - np.round(place * count / 8)) > 0.2) for place, count in ((v, 16), (u, 24))]
    inside = (u > 0.02) & (u < 0.98) & (v > 0.02) & (v < 0.98) & calm[0] & calm[1]
    outside = (u < -0.02) | (u > 1.02) | (v < -0.02) | (v > 1.02)
    return row, column, inside, outside


def test_images_on_empties_are_in_the_colours_and_the_normals(terrain):
    terrain.rotation_euler, terrain.scale = (0, 0, 0.4), (1.5, 1.5, 1.0)
    settings = terrain.adaptive_terrain.maps
    settings.frames, settings.chosen = "WHOLE", {"color", "detail_normal"}
    names = "color", "detail_normal"
    bake(terrain)
    plain = {name: pixels_of(map_images.map_image(terrain, name)) for name in names}
    before = keys(terrain)
    shown = {"color": turned_empty(terrain, "Stain", False), "detail_normal": turned_empty(terrain, "Ripples", True)}
    bake(terrain)
    bpy.context.view_layer.update()
    assert all(before[file] != key for file, key in keys(terrain).items())
    for name, (empty, image) in shown.items():
        found = pixels_of(map_images.map_image(terrain, name))
        row, column, inside, outside = under(terrain, empty, len(found))
        assert inside.sum() > 500 and np.array_equal(found[outside], plain[name][outside])
        rgb, alpha = image[row, column, :3][inside], image[row, column, 3:][inside]
        if name == "color":
            wanted = curve(alpha * line(rgb) + (1 - alpha) * line(plain[name][inside]))
        else:
            axes = np.array((terrain.matrix_world.inverted() @ empty.matrix_world).to_3x3())[:2, :2]
            axes /= np.sqrt((axes * axes).sum(0))
            ground, tilt = plain[name][inside] * 2 - 1, rgb * 2 - 1
            slopes = -tilt[:, :2] / np.maximum(tilt[:, 2:], 0.05) * alpha
            wanted = ground / ground[:, 2:]
            wanted[:, 0] -= slopes[:, 0] * axes[0, 0] + slopes[:, 1] * axes[0, 1]
            wanted[:, 1] -= slopes[:, 0] * axes[1, 0] + slopes[:, 1] * axes[1, 1]
            wanted = 0.5 + 0.5 * wanted / np.sqrt((wanted * wanted).sum(1))[:, None]
        assert abs(found[inside] - wanted).max() < 3 / 255
    before = keys(terrain)
    bake(terrain)
    assert keys(terrain) == before
    shown["color"][0].location.x += 10
    bake(terrain)
    assert {file for file, key in keys(terrain).items() if before[file] != key} == {"color.png"}
    assert bpy.ops.adaptive_terrain.terrain_material() == {"FINISHED"}
    [group] = [node.node_tree for node in terrain.data.materials[0].node_tree.nodes if node.type == "GROUP"]
    images = {node.image for node in group.nodes if node.type == "TEX_IMAGE"}
    assert images == {map_images.map_image(terrain, name) for name in names}
    assert not [node for node in group.nodes if node.type == "ATTRIBUTE"]
    shown["color"][0].rotation_euler = np.pi / 2, 0, 0
    with pytest.raises(RuntimeError, match="'Stain' stands upright"):
        bpy.ops.adaptive_terrain.bake_maps()


def pixels_of(image) -> np.ndarray:
    return np.array(image.pixels[:]).reshape(*image.size, -1)[..., :3]


def line(srgb: np.ndarray) -> np.ndarray:
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def curve(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)


def test_numbers_and_their_units_reach_blender(terrain):
    terrain.adaptive_terrain.maps.frames = "WHOLE"
    terrain.adaptive_terrain.maps.chosen = {"slope", "height"}
    bake(terrain)
    field = session.open_field(bpy.path.abspath(terrain.adaptive_terrain.store))
    for name, low, high in (("slope", 0.0, np.pi / 2), ("height", field.min_height, field.max_height)):
        image, entry = map_images.map_image(terrain, name), map_images.index_of(terrain)["maps"][name]
        coding = entry["coding"]
        pixels = np.array(image.pixels[:]).reshape(-1, image.channels)[:, 0]
        numbers = coding["zero"] + pixels * (coding["one"] - coding["zero"])
        assert image.colorspace_settings.name == "Non-Color"
        assert low <= numbers.min() < numbers.max() <= high
    assert entry["unit"] == "m" and numbers.max() - numbers.min() > 0.8 * (high - low)


def test_what_the_materials_read_is_baked(terrain):
    settings = terrain.adaptive_terrain.maps
    bake(terrain)
    settings.which = "READ"
    with pytest.raises(RuntimeError, match="No material"):
        bpy.ops.adaptive_terrain.bake_maps()
    wear(terrain)
    assert map_request.chosen_maps(terrain, bpy.context.evaluated_depsgraph_get()) == {"detail_normal"}
    tree = terrain.data.materials[0].node_tree
    slope = tree.nodes.new("ShaderNodeAttribute")
    slope.attribute_name = "slope"
    tree.links.new(slope.outputs["Fac"], tree.nodes["Diffuse BSDF"].inputs["Roughness"])
    assert map_request.chosen_maps(terrain, bpy.context.evaluated_depsgraph_get()) == {"detail_normal", "slope"}


def test_a_folder_beside_a_file_that_is_not_saved_is_refused(terrain):
    terrain.adaptive_terrain.maps.folder = "//maps"
    with pytest.raises(RuntimeError, match="never saved"):
        bpy.ops.adaptive_terrain.bake_maps()


def test_a_bake_leaves_the_state_of_the_last_update(terrain, tmp_path):
    """The panel calls a terrain with an error "not up to date", which a bake that fails or succeeds does not change."""
    status = session.record_of(terrain).status
    terrain.adaptive_terrain.maps.folder = "//maps"
    for error in ("", "The disk is full."):
        status.error = error
        with pytest.raises(RuntimeError, match="never saved"):
            bpy.ops.adaptive_terrain.bake_maps()
        assert status.error == error
    terrain.adaptive_terrain.maps.folder = str(tmp_path / "maps")
    bake(terrain)
    assert status.error == "The disk is full."


def test_a_material_is_made_without_maps_that_are_gone(terrain):
    bake(terrain)
    folder = map_images.map_folder(terrain)
    (folder / "detail_normal.png").unlink()
    assert bpy.ops.adaptive_terrain.terrain_material() == {"FINISHED"} and not bpy.data.images
    (folder / "maps.json").write_text("{}")
    with pytest.raises(RuntimeError, match=r"^Error: The maps .*maps.json are damaged"):
        bpy.ops.adaptive_terrain.terrain_material()


def test_the_command_bakes_a_scene_and_a_store(terrain, tmp_path, capsys):
    blend = tmp_path / "scene.blend"
    store = bpy.path.abspath(terrain.adaptive_terrain.store)
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    name = terrain.name
    wanted = ["--maps", "slope,detail_normal", "--budget", "40"]
    assert main(["maps", "--scene", str(blend), "--out", str(tmp_path / "a"), "--frames", "1", *wanted]) == 0
    assert set(read_index(tmp_path / "a" / name)["maps"]) == {"slope", "detail_normal"}
    assert main(["maps", "--store", store, "--out", str(tmp_path / "b"), "--format", "exr"]) == 0
    assert read_index(tmp_path / "b")["maps"]["detail_normal"]["format"] == "exr"
    assert main(["maps", "--store", store, "--out", str(tmp_path / "b"), "--maps", "rocks"]) == 1
    assert "There is no map 'rocks'" in capsys.readouterr().err
    for nothing in ("", " , "):
        assert main(["maps", "--store", store, "--out", str(tmp_path / "c"), "--maps", nothing]) == 2
        assert "--maps names no map; expected names" in capsys.readouterr().err and not (tmp_path / "c").exists()
    assert main(["maps", "--store", store, "--out", str(tmp_path / "b"), "--frames", "1-3"]) == 2
