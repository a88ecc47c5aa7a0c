# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain with finer tiles in Blender: its mesh, its attributes, and its messages."""

import bpy
import numpy as np
import pytest
import rasterio
from adaptive_terrain.cbt_terrain.attributes.folder import read_index
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import build
from adaptive_terrain.cbt_terrain.field.finer_build import with_finer_tiles
from adaptive_terrain.cbt_terrain.field.store import Draft
from adaptive_terrain.operators.bridge.demand.trees import tree_of_new
from adaptive_terrain.operators.maps import images as map_images
from adaptive_terrain.operators.session import session
from blender_meshes import positions, values_of
from fields import reference_heights, rough
from finer_fields import dense_field
from matplotlib.image import imread
from rendered_pictures import rendered


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """Return a store of 64 x 64 cells of 32 m, with waves at 2 m in its middle."""
    path = tmp_path_factory.mktemp("stores") / "city"
    draft = Draft(path)
    samples = draft.allocate("samples", (65, 65), np.float32)
    samples[:] = rough(65, 65, 3, relief=60.0).heights()
    plain = build(samples, 32.0, 32.0, missing=0, allocate=draft.allocate)

    def waves(box):
        x, y = np.arange(box.x0, box.x1 + 1), np.arange(box.y0, box.y1 + 1)[:, None]
        return (30.0 + 5.0 * np.sin(x / 9.0) * np.cos(y / 7.0)).astype(np.float32)

    draft.publish(with_finer_tiles(plain, 4, [(2, 2)], waves, allocate=draft.allocate), "city", {})
    return str(path)


def test_a_mesh_in_blender_has_the_finer_heights(scene, add_terrain, city):
    obj = add_terrain()
    obj.adaptive_terrain.store = city
    obj.location, obj.scale, obj.rotation_euler = (300.0, -50.0, 20.0), (2.0, 2.0, 1.5), (0.0, 0.0, 0.7)
    scene.camera.location = (500.0, 300.0, 220.0)
    bpy.context.view_layer.update()
    session.update_object(obj)
    record = session.record_of(obj)
    assert record.field.raster.finer is not None
    vertices = positions(obj).astype(np.float64)
    expected = reference_heights(dense_field(record.field), vertices[:, :2])
    assert np.abs(vertices[:, 2] - expected).max() < 1e-3
    in_tile = np.abs(vertices[:, :2] - 256.0).max(axis=1) < 250.0  # the known tile, from the raster's middle
    assert in_tile.sum() > 500


def test_a_material_and_a_map_show_the_finer_slope(scene, add_terrain, city, tmp_path):
    """The waves have 57 m and 44 m, so samples of 32 m lose them."""
    obj = add_terrain()
    obj.adaptive_terrain.store = city
    scene.camera.location = (200.0, 100.0, 120.0)
    scene.camera.rotation_euler = (0.9, 0.0, -0.4)
    material = bpy.data.materials.new("Rock")
    tree = tree_of_new(material)
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = "slope"
    tree.links.new(node.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    obj.data.materials.append(material)
    bpy.context.view_layer.update()
    session.update_object(obj)
    vertices, slopes = positions(obj), values_of(obj.data, "slope")
    near = (np.abs(vertices[:, :2] - 256.0) < 100.0).all(axis=1)  # of the middle of the known tile
    assert near.sum() > 300
    assert np.abs(slopes - slope_of_waves(*vertices[:, :2].T))[near].max() < 0.02

    obj.adaptive_terrain.maps.folder, obj.adaptive_terrain.maps.which = str(tmp_path), "READ"
    bpy.context.view_layer.objects.active = obj
    assert bpy.ops.adaptive_terrain.bake_maps() == {"FINISHED"}
    entry = read_index(map_images.map_folder(obj))["maps"]["slope"]
    assert len(entry["tiles"]) == 1 and entry["tiles"][0]["texel_m"] <= 2.0
    pixels = imread(map_images.map_folder(obj) / entry["tiles"][0]["file"]).astype(np.float64)
    x = (np.arange(len(pixels)) + 0.5) / len(pixels) * 2048 - 1024
    expected = slope_of_waves(x, -x[:, None])
    middle = (np.abs(x - 256.0) < 100.0) & (np.abs(-x[:, None] - 256.0) < 100.0)
    found = entry["coding"]["zero"] + (entry["coding"]["one"] - entry["coding"]["zero"]) * pixels
    assert np.abs(found - expected)[middle].max() < 0.02


def slope_of_waves(x, y):
    """Return the slope of the city's waves at x, y metres."""
    a, b = (x + 1024.0) / 18.0, (y + 1024.0) / 14.0
    return np.arctan(np.hypot(5 / 18 * np.cos(a) * np.cos(b), 5 / 14 * np.sin(a) * np.sin(b)))


def test_a_bicubic_mesh_in_blender_has_the_finer_heights(scene, add_terrain, city):
    obj = add_terrain()
    obj.adaptive_terrain.store, obj.adaptive_terrain.interpolation = city, "bicubic"
    scene.camera.location = (500.0, 300.0, 220.0)
    bpy.context.view_layer.update()
    session.update_object(obj)
    field = session.record_of(obj).field
    assert field.interpolation == "bicubic" and field.finer.off > 0
    vertices = positions(obj).astype(np.float64)
    assert np.abs(vertices[:, 2] - reference_heights(field, vertices[:, :2])).max() < 1e-3
    assert (np.abs(vertices[:, :2] - 256.0).max(axis=1) < 250.0).sum() > 500


def add_position_material(obj):
    """Give an object a material that shows the position of its surface in the world as a color."""
    material = bpy.data.materials.new("Position")
    tree = tree_of_new(material)
    geometry, emission = tree.nodes.new("ShaderNodeNewGeometry"), tree.nodes.new("ShaderNodeEmission")
    output = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(geometry.outputs["Position"], emission.inputs["Color"])
    tree.links.new(emission.outputs["Emission"], output.inputs["Surface"])
    obj.data.materials.append(material)


def rendered_positions(scene, path):
    """Return the positions that `add_position_material` shows in a picture by Cycles, float64 [n, 3]."""
    scene.world = None
    found = rendered(path).reshape(-1, 4)[:, :3].astype(np.float64)
    return found[(found != 0.0).any(axis=1)]


def test_a_render_shows_the_bicubic_surface_within_its_bound(scene, add_terrain, city, tmp_path):
    obj, place = add_terrain(), np.array([2000.0, 2000.0, 500.0])  # so that all colors are above 0
    obj.adaptive_terrain.store, obj.adaptive_terrain.interpolation = city, "bicubic"
    obj.location = place
    obj.adaptive_terrain.render.error_px, obj.adaptive_terrain.render.smooth_transitions = 0.25, False
    scene.camera.location, scene.camera.rotation_euler = (1700.0, 1600.0, 750.0), (1.15, 0.0, -0.7)
    scene.render.resolution_x, scene.render.resolution_y = 320, 180
    add_position_material(obj)
    positions = rendered_positions(scene, tmp_path / "a.exr") - place
    assert len(positions) > 25_000
    field = session.record_of(obj).field
    eye = np.array(scene.camera.location) - place
    off = np.abs(positions[:, 2] - reference_heights(field, positions[:, :2]))
    pixel = scene.camera.data.sensor_width / scene.camera.data.lens / scene.render.resolution_x
    distance = np.linalg.norm(positions - eye, axis=1)
    across = np.linalg.norm(positions[:, :2] - eye[:2], axis=1) / distance  # of an error, how much is seen
    assert (off * across / (distance * pixel)).max() < 0.25 * 1.1
    from_middle = np.abs(positions[:, :2] - 256.0).max(axis=1)  # of the known tile
    outside = from_middle > 260.0
    flat = reference_heights(interpolated(field, "bilinear"), positions[outside, :2])
    assert (from_middle < 250.0).sum() > 1250 and np.abs(positions[outside, 2] - flat).max() > 2.0 * off[outside].max()


def read_pixels(path):
    with rasterio.open(path) as file:
        return file.read(1)


@pytest.mark.parametrize("interpolation", [pytest.param("bilinear", marks=pytest.mark.thorough), "bicubic"])
def test_exported_heights_are_those_of_the_finer_tiles(scene, add_terrain, city, tmp_path, interpolation):
    """A scale, a vertical scale, an anchor and an interpolation are of the object; files have the store's heights."""
    obj = add_terrain()
    obj.adaptive_terrain.store = city
    obj.location, obj.scale = (300.0, -50.0, 20.0), (2.0, 2.0, 1.5)
    obj.adaptive_terrain.vertical_scale = 3.0
    obj.adaptive_terrain.anchor = (256.0, 200.0)
    obj.adaptive_terrain.interpolation = interpolation
    bpy.context.view_layer.objects.active = obj
    expected = dense_field(session.open_field(city)).heights()[::-1]
    assert bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "a.tif"), step=2.0) == {"FINISHED"}
    assert bpy.ops.adaptive_terrain.export_heights(filepath=str(tmp_path / "b.tif")) == {"FINISHED"}
    assert bpy.ops.adaptive_terrain.export_tiles(filepath=str(tmp_path / "c.r32"), step=2.0) == {"FINISHED"}
    fine, coarse = read_pixels(tmp_path / "a.tif"), read_pixels(tmp_path / "b.tif")
    assert (fine == expected).all() and (coarse == expected[::16, ::16]).all()
    assert (np.fromfile(tmp_path / "c_x0_y0.r32", "<f4").reshape(1025, 1025) == expected).all()
