# SPDX-License-Identifier: GPL-3.0-or-later
"""A Blender camera as a View: points fall on the pixels where Blender puts them."""

import math

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE
from adaptive_terrain.operators.bridge.camera import render_resolution, views_from_scene
from adaptive_terrain.operators.bridge.demand.trees import tree_of_new
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector
from rendered_pictures import rendered

POINTS = [(0.0, 0.0, 0.0), (3.0, -2.0, 1.0), (-4.0, 5.0, -2.0), (0.5, 0.25, 2.0)]


@pytest.fixture
def scene():
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    camera.location, camera.rotation_euler = (12.0, -20.0, 9.0), (1.1, 0.1, 0.5)
    scene.render.resolution_x, scene.render.resolution_y = 640, 480
    return scene


def views(scene, **kw):
    return views_from_scene(scene, scene.camera, bpy.context.evaluated_depsgraph_get(), **kw)


def ndc(view, point):
    """x and y of a world point in the frame, 0 .. 1, as world_to_camera_view gives them."""
    clip = view.projection @ view.world_to_camera @ (*point, 1.0)
    return (clip[:2] / clip[3] + 1) / 2


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("size", [(640, 480), (300, 900)])
def test_points_fall_where_blender_puts_them(scene, kind, fit, size):
    data = scene.camera.data
    data.type, data.sensor_fit, data.lens, data.ortho_scale = kind, fit, 35.0, 14.0
    data.shift_x, data.shift_y = 0.2, -0.1
    scene.render.resolution_x, scene.render.resolution_y = size
    [view] = views(scene)
    assert view.kind == (PERSPECTIVE if kind == "PERSP" else ORTHOGRAPHIC)
    assert view.resolution == size
    for point in POINTS:
        expected = world_to_camera_view(scene, scene.camera, Vector(point))[:2]
        np.testing.assert_allclose(ndc(view, point), expected, atol=1e-5)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("aspect", [(1.0, 1.0), (1.0, 2.5), (3.0, 1.0)])
def test_the_frame_is_that_of_calc_matrix_camera(scene, kind, fit, aspect):
    data = scene.camera.data
    data.type, data.sensor_fit, data.sensor_width, data.sensor_height = kind, fit, 30.0, 17.0
    data.shift_x, data.shift_y = -0.3, 0.7
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
    [view] = views(scene)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    expected = scene.camera.evaluated_get(depsgraph).calc_matrix_camera(
        depsgraph, x=640, y=480, scale_x=aspect[0], scale_y=aspect[1]
    )
    np.testing.assert_allclose(view.projection[[0, 1, 3]], np.array(expected)[[0, 1, 3]], rtol=1e-5, atol=1e-6)


def test_pixel_aspect_stretches_the_frame(scene):
    [square] = views(scene)
    scene.render.pixel_aspect_x = 2.0
    [wide] = views(scene)
    ratio = (wide.projection[0, 0] / wide.projection[1, 1]) / (square.projection[0, 0] / square.projection[1, 1])
    assert ratio == pytest.approx(0.5)


def test_resolution_takes_the_percentage_and_is_never_zero(scene):
    scene.render.resolution_percentage = 50
    assert render_resolution(scene) == (320, 240)
    scene.render.resolution_x, scene.render.resolution_percentage = 4, 1
    assert render_resolution(scene) == (1, 4)


def test_a_render_border_changes_no_pixel(scene):
    [whole] = views(scene)
    scene.render.use_border = scene.render.use_crop_to_border = True
    scene.render.border_max_x = 0.25
    [border] = views(scene)
    assert border.key() == whole.key()


def test_camera_scale_has_no_effect(scene):
    [plain] = views(scene)
    scene.camera.scale = (2.0, 0.5, 7.0)
    [scaled] = views(scene)
    np.testing.assert_allclose(scaled.world_to_camera, plain.world_to_camera, atol=1e-5)


def test_a_given_resolution_replaces_the_scenes(scene):
    [view] = views(scene, resolution=(99, 33))
    assert view.resolution == (99, 33)


def test_panorama_has_the_angle_of_a_pixel(scene):
    data = scene.camera.data
    data.type = "PANO"
    scene.render.engine = "CYCLES"
    lens = data if hasattr(data, "panorama_type") else data.cycles
    lens.panorama_type = "EQUIRECTANGULAR"
    scene.render.resolution_x, scene.render.resolution_y = 2000, 500
    [view] = views(scene)
    assert view.kind == PANORAMIC and view.projection is None
    assert view.radians_per_pixel == pytest.approx(2 * math.pi / 2000)
    lens.panorama_type, lens.fisheye_fov = "FISHEYE_EQUIDISTANT", math.pi
    [view] = views(scene)
    assert view.radians_per_pixel == pytest.approx(math.pi / 2000)
    lens.panorama_type = "MIRRORBALL"
    [view] = views(scene)
    assert view.radians_per_pixel <= math.pi / 2000


PANORAMAS = {
    "EQUIANGULAR_CUBEMAP_FACE": {},
    "CENTRAL_CYLINDRICAL": {
        "central_cylindrical_range_u_min": -0.2,
        "central_cylindrical_range_u_max": 0.1,
        "central_cylindrical_range_v_max": 0.5,
        "central_cylindrical_radius": 2.0,
    },
    "FISHEYE_EQUISOLID": {"fisheye_lens": 100.0, "fisheye_fov": 0.6},
    "FISHEYE_LENS_POLYNOMIAL": {"fisheye_fov": 0.8},
}


def directions(scene, folder) -> np.ndarray:
    """float64 [rows, columns, 3]: where Cycles looks through the middle of a pixel; NaN where there is no picture."""
    bpy.ops.mesh.primitive_ico_sphere_add(subdivisions=5, radius=10, location=scene.camera.location)
    material = bpy.data.materials.new("place")
    tree = tree_of_new(material)
    nodes, links = tree.nodes, tree.links
    nodes.clear()
    place, emission = nodes.new("ShaderNodeNewGeometry"), nodes.new("ShaderNodeEmission")
    move = nodes.new("ShaderNodeVectorMath")  # colours are not negative
    move.inputs[1].default_value = [100.0] * 3
    links.new(place.outputs["Position"], move.inputs[0])
    links.new(move.outputs[0], emission.inputs["Color"])
    links.new(emission.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    scene.cycles.filter_width, scene.cycles.pixel_filter_type = 0.01, "BOX"
    places = rendered(folder / "places.exr")[..., :3].astype(np.float64) - 100
    places -= np.array(scene.camera.location)
    length = np.linalg.norm(places, axis=2, keepdims=True)
    return np.where(abs(length - 10) < 0.1, places / length, np.nan)


@pytest.mark.parametrize("fit", ["AUTO", "VERTICAL"])
@pytest.mark.parametrize("aspect", [1.0, 3.0])
@pytest.mark.parametrize("panorama", PANORAMAS)
def test_a_panorama_is_as_fine_as_cycles_draws_it(scene, tmp_path, panorama, aspect, fit):
    """Of a lens that hardly stretches: the least angle between neighbouring pixels, by a render."""
    scene.render.engine = "CYCLES"
    data = scene.camera.data
    data.type, data.sensor_fit = "PANO", fit
    lens = data if hasattr(data, "panorama_type") else data.cycles
    if panorama not in lens.bl_rna.properties["panorama_type"].enum_items:
        pytest.skip(f"Blender {bpy.app.version_string} has no {panorama}")
    lens.panorama_type = panorama
    for name, value in PANORAMAS[panorama].items():
        setattr(lens, name, value)
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 48, 24, 100
    scene.render.pixel_aspect_x = aspect
    [view] = views(scene)
    looks = directions(scene, tmp_path)
    across, up = looks[:-1, 1:] - looks[:-1, :-1], looks[1:, :-1] - looks[:-1, :-1]
    seen = np.isfinite(across + up).all(axis=2)
    assert seen.sum() > 100
    least = np.linalg.svd(np.stack([across[seen], up[seen]], axis=1), compute_uv=False)[:, 1].min()
    assert 0.6 * least < view.radians_per_pixel < 1.06 * least


def test_stereo_eyes_meet_at_the_convergence_distance(scene):
    scene.render.use_multiview = True
    scene.render.views_format = "STEREO_3D"
    stereo = scene.camera.data.stereo
    stereo.interocular_distance, stereo.convergence_distance = 0.5, 8.0
    matrix = Matrix(scene.camera.evaluated_get(bpy.context.evaluated_depsgraph_get()).matrix_world)
    ahead = matrix @ Vector((0.0, 0.0, -8.0))
    for mode in ("OFFAXIS", "TOE"):
        stereo.convergence_mode = mode
        left, right = views(scene)
        np.testing.assert_allclose(ndc(left, ahead), (0.5, 0.5), atol=1e-5)
        np.testing.assert_allclose(ndc(right, ahead), (0.5, 0.5), atol=1e-5)
        eyes = [np.linalg.inv(view.world_to_camera)[:3, 3] for view in (left, right)]
        assert np.linalg.norm(eyes[0] - eyes[1]) == pytest.approx(0.5, rel=1e-4)
    stereo.pivot = "LEFT"
    left, _right = views(scene)
    np.testing.assert_allclose(np.linalg.inv(left.world_to_camera)[:3, 3], matrix.translation, atol=1e-5)


def test_one_camera_a_view_is_found_by_suffix(scene):
    scene.camera.name = "Rig_L"
    other = bpy.data.objects.new("Rig_R", bpy.data.cameras.new("Rig_R"))
    other.location = (1.0, 2.0, 3.0)
    scene.collection.objects.link(other)
    scene.render.use_multiview = True
    scene.render.views_format = "MULTIVIEW"
    eyes = [np.linalg.inv(view.world_to_camera)[:3, 3] for view in views(scene)]
    np.testing.assert_allclose(eyes, [(12, -20, 9), (1, 2, 3)], atol=1e-5)


def test_a_flat_camera_is_refused(scene):
    scene.camera.scale = (1.0, 0.0, 1.0)
    with pytest.raises(TerrainError, match="scale of 0"):
        views(scene)
