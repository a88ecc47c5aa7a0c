# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 23 to 25, 27 to 29 and 31 to 34: cameras and transforms of Blender."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from adaptive_terrain.cbt_terrain.errors import TerrainError  # noqa: E402
from adaptive_terrain.operators.session import session  # noqa: E402
from adaptive_terrain.operators.terrain.request import VIEWPORT, gather  # noqa: E402
from blender_meshes import assert_blender_invariants, corner_normals, positions  # noqa: E402
from fields import scattered, screen_error  # noqa: E402


@pytest.fixture
def terrain(scene, add_terrain):
    """Return an updated terrain whose triangle limit keeps the tests short."""
    terrain = add_terrain()
    detail = terrain.adaptive_terrain.viewport
    detail.limit_triangles, detail.max_triangles = True, 50_000
    session.update_object(terrain)
    return terrain


def assert_refused_and_kept(terrain, message):
    before = positions(terrain).tobytes()
    with pytest.raises(TerrainError, match=message):
        session.update_object(terrain)
    assert positions(terrain).tobytes() == before
    assert session.record_of(terrain).status.error


def assert_good(terrain, update):
    assert len(terrain.data.polygons) == update.triangles >= 2
    assert_blender_invariants(terrain)


def test_case_23_orthographic_camera_and_scale_of_0(scene, terrain):
    """An orthographic camera keeps 1 px; ortho_scale 0 is refused with a message, and the mesh stays."""
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 800.0
    update = session.update_object(terrain)
    assert_good(terrain, update)
    assert update.bound_px <= 1.0 + 1e-9
    scene.camera.data.ortho_scale = 0.0
    assert_refused_and_kept(terrain, "orthographic scale of 0")


def test_case_24_field_of_view_near_180_and_near_0(scene, terrain):
    """A lens of 1 mm on a sensor of 1 km and one of 5 m on 1 um give valid meshes."""
    camera = scene.camera.data
    camera.sensor_width, camera.lens = 1e6, 1.0
    assert_good(terrain, session.update_object(terrain))
    camera.sensor_width, camera.lens = 1e-3, 5000.0
    assert_good(terrain, session.update_object(terrain))


@pytest.mark.parametrize("kind", ["PANO", "CUSTOM"])
def test_case_25_panoramic_camera(scene, terrain, kind):
    """Panoramic and custom cameras of Cycles keep 1 px, or report how far the limit relaxed it."""
    scene.render.engine = "CYCLES"
    if kind not in scene.camera.data.bl_rna.properties["type"].enum_items:
        pytest.skip(f"Blender {bpy.app.version_string} has no {kind} cameras")
    scene.camera.data.type = kind
    update = session.update_object(terrain)
    assert_good(terrain, update)
    assert update.bound_px <= max(1.0, update.relaxed) + 1e-9


def test_case_27_clip_start_beyond_clip_end_culls_nothing(scene, terrain):
    """A clip_start beyond or equal to clip_end refines the whole terrain."""
    scene.camera.data.clip_start, scene.camera.data.clip_end = 1e5, 0.1
    update = session.update_object(terrain)
    assert_good(terrain, update)
    assert update.triangles > 10_000
    scene.camera.data.clip_start = scene.camera.data.clip_end = 10.0
    assert session.update_object(terrain).triangles == update.triangles


def test_case_28_nan_in_the_cameras_matrix(scene, terrain):
    """NaN in the camera's location or shift shows a message in the panel, and the mesh stays."""
    scene.camera.location.x = math.nan
    assert_refused_and_kept(terrain, "'Camera'.*not finite")
    scene.camera.location.x = 0.0
    scene.camera.data.shift_x = math.nan
    assert_refused_and_kept(terrain, "a shift of nan")


def test_case_28_nan_in_the_terrains_matrix(scene, terrain):
    """NaN in the terrain's location shows a message in the panel, and the mesh stays."""
    terrain.location.x = math.nan
    assert_refused_and_kept(terrain, "'Terrain'.*not finite")


def test_case_29_far_away(scene, terrain):
    """A camera 1e30 m away gives a valid mesh or one message."""
    scene.camera.location = (1e30, 0.0, 0.0)
    try:
        assert_good(terrain, session.update_object(terrain))
    except TerrainError as error:
        assert "far away" in str(error)


def test_case_29_shifted_and_stretched(scene, terrain):
    """A lens shift of 1e6, a pixel aspect of 1 : 100 and a render border give valid meshes."""
    scene.camera.data.shift_x = 1e6
    assert_good(terrain, session.update_object(terrain))
    scene.camera.data.shift_x = 0.0
    scene.render.pixel_aspect_y = 100.0
    assert_good(terrain, session.update_object(terrain))
    scene.render.pixel_aspect_y = 1.0
    scene.render.use_border, scene.render.border_max_x = True, 0.1
    assert_good(terrain, session.update_object(terrain))


def test_case_29_resolution_of_1_percent(scene, terrain):
    """At 1 % of the resolution the mesh has less than a tenth of the triangles."""
    whole = session.update_object(terrain).triangles
    scene.render.resolution_percentage = 1
    update = session.update_object(terrain)
    assert_good(terrain, update)
    assert update.triangles < whole / 10


def test_case_31_stereo_refines_for_both_eyes(scene, terrain):
    """The bound of a stereo camera with eyes 400 m apart holds for each eye."""
    one = session.update_object(terrain)
    level = one.surface.level.max()
    scene.render.use_multiview = True
    scene.render.views_format = "STEREO_3D"
    scene.camera.data.stereo.interocular_distance = 400.0
    both = session.update_object(terrain)
    assert_good(terrain, both)
    assert both.bound_px <= max(1.0, both.relaxed) + 1e-9 and both.surface.level.max() >= level
    [left, right] = gather(terrain, bpy.context.evaluated_depsgraph_get(), VIEWPORT).views
    eyes = [np.linalg.inv(view.world_to_camera)[:3, 3] for view in (left, right)]
    assert np.linalg.norm(eyes[0] - eyes[1]) == pytest.approx(400.0)
    field = session.record_of(terrain).field
    for view in (left, right):
        measured = screen_error(view, field, both.surface, scattered(field, 2000))
        assert measured <= both.bound_px + 1e-2


def test_case_32_no_camera_in_the_scene(scene, terrain):
    """A scene without a camera, or with none chosen, shows a message with the remedy, and the mesh stays."""
    scene.camera = None
    assert_refused_and_kept(terrain, "'Scene' has no camera.*add a camera")
    terrain.adaptive_terrain.camera_source = "CHOSEN"
    assert_refused_and_kept(terrain, "No camera is chosen")


@pytest.mark.parametrize("kind", ["EMPTY", "LIGHT", "MESH"])
def test_case_32_the_scenes_camera_is_none(scene, terrain, kind):
    """An empty, a light or a mesh as the scene's camera gives a message with its name, and the mesh stays."""
    data = {"LIGHT": bpy.data.lights.new("Sun", "SUN"), "MESH": bpy.data.meshes.new("Cube")}.get(kind)
    scene.camera = bpy.data.objects.new("Eye", data)
    scene.collection.objects.link(scene.camera)
    assert_refused_and_kept(terrain, f"'Eye'.*is not a camera but of type {kind}")
    scene.render.use_multiview = True
    assert_refused_and_kept(terrain, "is not a camera")


@pytest.mark.parametrize("scale", [(-1, 1, 1), (1, 1, -1), (3.0, 0.25, 2.0), (-2.0, -0.5, 1.0)])
def test_case_33_normals_of_a_mirrored_terrain_point_up(scene, terrain, scale):
    """The corner normals of mirrored and stretched objects point up and outward in world space."""
    terrain.scale = scale
    update = session.update_object(terrain)
    assert_good(terrain, update)
    assert update.bound_px <= max(1.0, update.relaxed) + 1e-9
    evaluated = terrain.evaluated_get(bpy.context.evaluated_depsgraph_get())
    to_world = np.linalg.inv(np.array(evaluated.matrix_world)[:3, :3]).T
    up = (corner_normals(evaluated.to_mesh()) @ to_world.T)[:, 2] * np.sign(scale[2])
    evaluated.to_mesh_clear()
    assert up.min() > 0, "a negative height scale turns the ground over"


def test_case_33_sheared_terrain_and_sheared_camera(scene, terrain):
    """A terrain and a camera under sheared parents give valid meshes that keep their bound."""
    for name in ("terrain", "camera"):
        parent = bpy.data.objects.new(f"Shear {name}", None)
        scene.collection.objects.link(parent)
        parent.scale, parent.rotation_euler = (1.0, 3.0, 1.0), (0.0, 0.0, 0.4)
        child = terrain if name == "terrain" else scene.camera
        child.parent = parent
        if name == "terrain":
            child.rotation_euler = (0.0, 0.0, 0.9)
        update = session.update_object(terrain)
        assert_good(terrain, update)
        assert update.bound_px <= max(1.0, update.relaxed) + 1e-9


@pytest.mark.parametrize("scale", [(0, 1, 1), (1, 1, 0), (0, 0, 0)])
def test_case_34_zero_scale_does_nothing(scene, terrain, scale):
    """A terrain with scale 0 shows a message and keeps its mesh; the next update clears the message."""
    terrain.scale = scale
    assert_refused_and_kept(terrain, "scale")
    terrain.scale = (1, 1, 1)
    assert session.update_object(terrain).triangles > 100
    assert session.record_of(terrain).status.error == ""


def test_case_34_zero_scale_of_the_camera(scene, terrain):
    """A camera with scale 0 gives a message with its name, and the mesh stays."""
    scene.camera.scale = (0, 0, 0)
    assert_refused_and_kept(terrain, "'Camera' has a scale of 0")
