# SPDX-License-Identifier: GPL-3.0-or-later
"""Visibility of a terrain's box from a camera, and the necessary clip range."""

import math
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.view.view import ORTHOGRAPHIC, View
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain import frame_terrain, sight
from adaptive_terrain.operators.ui.status_row import draw_status, sight_notice
from blender_meshes import positions
from drawn_panels import DrawnLayout

BOX = np.array([(x, y, z) for x in (-10.0, 10.0) for y in (-10.0, 10.0) for z in (0.0, 2.0)])


def test_only_a_box_before_the_camera_is_seen():
    there = View.look((0, -60, 20), (0, 0, 0), clip=(0.1, 200.0))
    assert sight.is_in_sight(BOX, there) and sight.shows_all(BOX, there) and not sight.is_cut_off(BOX, there)
    away = View.look((0, -60, 20), (0, -120, 40), clip=(0.1, 200.0))
    beside = View.look((0, -60, 20), (200, -60, 20), clip=(0.1, 200.0))
    assert not sight.is_in_sight(BOX, away) and not sight.is_in_sight(BOX, beside)
    close = View.look((0, -12, 3), (0, 0, 0), clip=(0.1, 200.0))
    assert sight.is_in_sight(BOX, close) and not sight.shows_all(BOX, close), "its corners are out of the frame"
    speck = View.look((0, -6000, 20), (0, 0, 0), clip=(0.1, 1e5))
    assert sight.is_in_sight(BOX, speck) and not sight.shows_all(BOX, speck)


def test_a_clip_range_cuts_what_lies_beyond_its_end():
    for kind in ("PERSPECTIVE", ORTHOGRAPHIC):
        view = View.look((0, -60, 0), (0, 0, 0), kind=kind, ortho_width=50.0, clip=(0.1, 65.0))
        assert sight.is_cut_off(BOX, view) and not sight.shows_all(BOX, view)
        assert sight.depths(BOX, view).max() == pytest.approx(70.0)
    assert not sight.is_cut_off(BOX, View.look((0, -60, 0), (0, 0, 0), clip=(0.1, 70.01)))


def test_a_clip_range_grows_with_precision_and_never_shrinks():
    assert sight.clip_that_shows(BOX, 70.0, (0.01, 1000.0)) == (0.01, 1000.0), "it has room"
    start, end = sight.clip_that_shows(BOX * 1600, 40_000.0, (0.01, 1000.0))
    assert (start, end) == (pytest.approx(1.0), 100_000.0)
    start, end = sight.clip_that_shows(BOX * 15_000, 400_000.0, (0.01, 1000.0))
    assert end >= 800_000.0 and end / start <= 1.0001e5
    assert sight.clip_that_shows(BOX / 1000, 0.05, (0.01, 1000.0))[0] < 0.001, "a model of some millimetres"


def test_round_numbers():
    assert [sight.round_up(v) for v in (1.0, 1.1, 2.1, 5.5, 92_000.0, 0.03)] == pytest.approx(
        [1.0, 2.0, 5.0, 10.0, 100_000.0, 0.05]
    )


def test_the_box_is_that_of_the_mesh(scene, add_terrain):
    """The box of a rotated, stretched, mirrored and moved terrain contains all vertices and fits within the relief."""
    terrain = add_terrain()
    terrain.location, terrain.rotation_euler, terrain.scale = (500.0, -200.0, 30.0), (0.3, 0.2, 0.7), (2.0, -1.0, 3.0)
    settings = terrain.adaptive_terrain
    settings.vertical_scale, settings.vertical_offset = -2.0, 100.0
    settings.viewport.off_screen_factor = 1.0
    bpy.context.view_layer.update()
    session.update_object(terrain)
    box = sight.box_of(terrain, bpy.context.evaluated_depsgraph_get())
    points = positions(terrain)
    points = np.column_stack([points, np.ones(len(points))]) @ np.array(terrain.matrix_world)[:3].T
    assert (points.min(axis=0) >= box.min(axis=0) - 0.01).all() and (points.max(axis=0) <= box.max(axis=0) + 0.01).all()
    assert np.ptp(points, axis=0) == pytest.approx(np.ptp(box, axis=0), rel=0.25)


def test_the_cameras_clip_grows_and_its_place_stays(scene, add_terrain):
    terrain, camera = add_terrain(), scene.camera
    camera.data.clip_start, camera.data.clip_end = 0.1, 100.0
    bpy.context.view_layer.update()
    place = np.array(camera.matrix_world)
    assert sight_notice(bpy.context, terrain)[0] == "Camera cuts it off"
    assert bpy.ops.adaptive_terrain.frame() == {"FINISHED"}
    assert camera.data.clip_end == 5000.0 and camera.data.clip_start == pytest.approx(0.1)
    assert (np.array(camera.matrix_world) == place).all()
    assert sight_notice(bpy.context, terrain) == ("", "", "")
    camera.data.clip_end = 7000.0
    bpy.ops.adaptive_terrain.frame()
    assert camera.data.clip_end == 7000.0, "what a user has set is never lowered"


def test_a_chosen_camera_counts_not_the_scenes(scene, add_terrain):
    terrain = add_terrain()
    chosen = scene.camera.copy()
    chosen.data = scene.camera.data.copy()
    scene.collection.objects.link(chosen)
    terrain.adaptive_terrain.camera_source, terrain.adaptive_terrain.camera = "CHOSEN", chosen
    chosen.data.clip_end = scene.camera.data.clip_end = 100.0
    bpy.ops.adaptive_terrain.frame()
    assert (chosen.data.clip_end, scene.camera.data.clip_end) == (5000.0, 100.0)


def test_a_camera_that_sees_nothing_gives_a_notice(scene, add_terrain):
    terrain, camera = add_terrain(), scene.camera
    camera.rotation_euler.z = 3.1
    bpy.context.view_layer.update()
    assert sight_notice(bpy.context, terrain)[0] == "Camera sees nothing"
    camera.location, camera.rotation_euler.z = (0.0, 0.0, -60.0), 0.0
    bpy.context.view_layer.update()
    assert sight_notice(bpy.context, terrain)[0] == "Camera underground"
    scene.camera = None
    assert sight_notice(bpy.context, terrain) == ("", "", "")


def test_a_camera_in_the_box_may_see_no_ground(scene, add_terrain):
    """A camera at the border, higher than the ground there and lower than the summit, looks outwards."""
    terrain, camera = add_terrain(), scene.camera
    session.update_object(terrain)
    highest = positions(terrain)[:, 2].max()
    corner = np.array(terrain.bound_box).max(axis=0)
    camera.location = corner[0] - 1.0, 0.0, 0.9 * highest
    camera.rotation_euler = math.pi / 2, 0.0, -math.pi / 2
    for turn, notice in ((-math.pi / 2, "Camera sees nothing"), (math.pi / 2, "")):
        camera.rotation_euler.z = turn
        bpy.context.view_layer.update()
        assert sight.is_in_sight(sight.box_of(terrain), sight.view_of_camera(scene, camera))
        assert sight_notice(bpy.context, terrain)[0] == "", "the last update was for another view"
        session.update_object(terrain)
        assert sight_notice(bpy.context, terrain)[0] == notice


def test_flat_ground_is_in_sight(scene, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.vertical_scale = 1e-30
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert sight_notice(bpy.context, terrain)[0] == ""


def test_a_remedy_that_moves_no_camera_comes_first(scene, add_terrain):
    terrain, camera = add_terrain(), scene.camera

    def row() -> list[str]:
        bpy.context.view_layer.update()
        layout = DrawnLayout()
        draw_status(layout, SimpleNamespace(space_data=None, scene=scene), terrain, layout)
        return layout.texts

    camera.rotation_euler.z = 3.1
    assert row() == ["Camera sees nothing", "<camera_source=VIEW>", "To View"]
    camera.keyframe_insert("location")
    assert row() == ["Camera sees nothing", "<camera_source=VIEW>"], "To View would move a keyframed camera"
    camera.animation_data_clear()
    terrain.adaptive_terrain.camera_source, terrain.adaptive_terrain.camera = "CHOSEN", camera.copy()
    assert row() == ["Camera sees nothing", "<camera_source=VIEW>"], "To View would move the scene's camera"
    terrain.adaptive_terrain.camera_source = "VIEW"
    assert row() == ["Camera sees nothing", "To View"], "only a note"


def test_without_a_height_map_there_is_nothing_to_frame(scene, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.store = ""
    assert not bpy.ops.adaptive_terrain.frame.poll()
    terrain.adaptive_terrain.store = "/nowhere/store"
    with pytest.raises(RuntimeError, match="There is no terrain store"):
        bpy.ops.adaptive_terrain.frame()
    terrain.adaptive_terrain.store = "/nowhere/store"
    assert frame_terrain.shown_viewports(bpy.context.window_manager, scene) == [], "none is drawn in the background"
