# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects and cameras stay on or above the ground in every frame, alone, in a sequence and in renders.

They are settled before the terrain is refined for them.
"""

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.run import warmup
from adaptive_terrain.operators.export.frame_sources import scene_piece
from adaptive_terrain.operators.ground import keep_ground, world_ground
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.session.pauses import handlers_paused
from ground_scenes import Cast, added, cube, only
from mathutils import Vector

NEAR = 0.03


@pytest.fixture
def drive(askew):
    """Return a cart that drives over the hills in frames 1 to 9 under a rotated and scaled parent."""
    up = added(bpy.data.objects.new("Up", None), (100.0, -40.0, 10.0), rotation_euler=(0.4, 0.2, 0.5))
    up.scale = (2.0, 1.0, 0.5)
    cart = cube("Cart", (0.0, 0.0, 0.0), parent=up)
    for frame, place in ((1, (-60.0, 0.0, 30.0)), (9, (40.0, 30.0, -60.0))):
        cart.location = place
        cart.keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_set(1)
    only(cart)
    return cart


def keep(**settings):
    assert bpy.ops.adaptive_terrain.drop_to_ground(anchor="ORIGIN", keep=True, **settings) == {"FINISHED"}


def test_a_kept_object_follows_its_animation(drive, askew):
    cast, scene, free = Cast(askew), bpy.context.scene, {}
    for frame in (2, 5, 8):
        scene.frame_set(frame)
        free[frame] = drive.matrix_world.copy()
    keep(offset=0.5, align=True)
    for frame in (2, 5, 8):
        scene.frame_set(frame)
        at = drive.matrix_world.translation
        assert (at.xy - free[frame].translation.xy).length < 1e-2, "straight up or down"
        assert at.z == pytest.approx(cast.height(at) + 0.5, abs=NEAR)
        assert abs(free[frame].translation.z - at.z) > 1.0
    scene.frame_set(5, subframe=0.5)
    at = drive.matrix_world.translation
    assert at.z == pytest.approx(cast.height(at) + 0.5, abs=NEAR)


def test_it_turns_with_the_ground(drive, askew):
    drive.parent.scale = (2.0, 2.0, 2.0)  # under one that is scaled unevenly an object cannot turn freely
    cast = Cast(askew)
    keep(align=True)
    for frame in (3, 7):
        bpy.context.scene.frame_set(frame)
        matrix = drive.matrix_world
        assert matrix.to_3x3().col[2].angle(cast.normal(matrix.translation)) < 0.03
        assert matrix.translation.z == pytest.approx(cast.height(matrix.translation), abs=NEAR)


def test_a_frame_alone_is_the_frame_of_a_sequence(drive, tmp_path):
    keep(align=True)
    scene, matrices = bpy.context.scene, []
    for frame in (7, 1, 2, 3, 4, 5, 6, 7, 9, 7):
        scene.frame_set(frame)
        matrices.append((frame, np.array(drive.matrix_world).tobytes()))
    assert len({matrix for frame, matrix in matrices if frame == 7}) == 1
    scene.frame_set(4)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "drive.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "drive.blend"))
    bpy.context.scene.frame_set(7)
    assert np.array(bpy.data.objects["Cart"].matrix_world).tobytes() == matrices[0][1]


def test_keys_are_not_touched_and_letting_go_gives_them_back(drive):
    scene = bpy.context.scene
    scene.frame_set(6)
    free, location = drive.matrix_world.copy(), drive.location.copy()
    keep(offset=2.0, align=True)
    scene.frame_set(6)
    assert drive.location == location and drive.matrix_world != free
    only(drive)
    assert bpy.ops.adaptive_terrain.let_go() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert drive.matrix_world == free and not bpy.ops.adaptive_terrain.let_go.poll()


@pytest.fixture
def flight(askew):
    """Return a scene whose camera flies into the hills, below the ground from frame 4 on."""
    scene, camera = bpy.context.scene, bpy.context.scene.camera
    camera.rotation_euler = (1.3, 0.0, 0.0)
    for frame, place in ((1, (120.0, -300.0, 200.0)), (9, (150.0, 0.0, -40.0))):
        camera.location = place
        camera.keyframe_insert("location", frame=frame)
    only(camera)
    assert bpy.ops.adaptive_terrain.keep_above_ground(clearance=3.0) == {"FINISHED"}
    scene.frame_set(1)
    return scene


def eye_of(terrain) -> Vector:
    """Return the eye for which the terrain was refined."""
    [view] = session.record_of(terrain).status.request.views
    return Vector(np.linalg.inv(view.world_to_camera)[:3, 3])


def test_the_terrain_is_refined_for_the_camera_above_ground(flight, askew):
    cast, lifted = Cast(askew), []
    for frame in (2, 6, 8):
        flight.frame_set(frame)
        eye, own = eye_of(askew), flight.camera.location.z
        assert (eye - flight.camera.matrix_world.translation).length < 1e-3
        assert eye.z == pytest.approx(max(own, cast.height(eye) + 3.0), abs=NEAR)
        lifted.append(eye.z > own)
    assert lifted == [False, False, True] or lifted == [False, True, True]
    alone = askew.data.vertices[0].co.copy(), len(askew.data.polygons)
    flight.frame_set(1)
    flight.frame_set(8)
    assert (askew.data.vertices[0].co, len(askew.data.polygons)) == alone


def test_renders_have_it_too_with_motion_blur(flight, askew, tmp_path):
    cast, seen = Cast(askew), []

    def look(scene, depsgraph):
        if depsgraph.mode == "RENDER":
            camera = scene.camera.evaluated_get(depsgraph)
            at = scene.frame_current + scene.frame_subframe
            seen.append((at, camera.matrix_world.translation.copy(), eye_of(askew)))

    flight.render.engine, flight.cycles.samples, flight.cycles.device = "CYCLES", 1, "CPU"
    flight.cycles.use_denoising, flight.render.use_motion_blur = False, True
    flight.render.resolution_x, flight.render.resolution_y, flight.render.filepath = 32, 18, str(tmp_path / "frame_")
    flight.frame_start = flight.frame_end = 8
    bpy.app.handlers.frame_change_post.append(look)
    try:
        bpy.ops.render.render(animation=True)
    finally:
        bpy.app.handlers.frame_change_post.remove(look)
    assert len({at for at, *_ in seen}) >= 3, "the shutter's ends, too"
    curves = {at: camera for at, camera, _ in seen}
    for at, camera in curves.items():
        assert camera.z == pytest.approx(cast.height(camera) + 3.0, abs=NEAR), at
    assert len({round(camera.y, 3) for camera in curves.values()}) >= 3, "it still flies"
    assert (seen[0][2] - curves[8.0]).length < 1e-3, "the mesh is for the frame's camera"


def test_exports_that_set_frames_in_a_pause_have_it(flight, askew):
    with handlers_paused():
        flight.frame_set(8)
    piece = scene_piece(askew, bpy.context.evaluated_depsgraph_get(), 8)
    eye = np.linalg.inv(np.array(piece.info["views"][0]["world_to_camera"]))[:3, 3]
    assert eye[2] == pytest.approx(Cast(askew).height(eye) + 3.0, abs=NEAR)


def follow(camera):
    data = bpy.data.curves.new("Path", "CURVE")
    data.dimensions, data.use_path = "3D", True
    spline = data.splines.new("POLY")
    spline.points.add(1)
    spline.points[0].co, spline.points[1].co = (0.0, 0.0, -90.0, 1.0), (50.0, 20.0, -80.0, 1.0)
    path = added(bpy.data.objects.new("Path", data), (100.0, -30.0, 20.0), rotation_euler=(0.2, 0.3, 0.9))
    constraint = camera.constraints.new("FOLLOW_PATH")
    constraint.target, constraint.use_curve_follow = path, True
    constraint.use_fixed_location, constraint.offset_factor = True, 0.5
    camera.location = (1.0, 2.0, 3.0)


def track(camera):
    target = added(bpy.data.objects.new("Target", None), (400.0, 90.0, 0.0))
    constraint = camera.constraints.new("TRACK_TO")
    constraint.target, constraint.track_axis, constraint.up_axis = target, "TRACK_NEGATIVE_Z", "UP_Y"
    camera.parent = added(bpy.data.objects.new("Dolly", None), (90.0, 0.0, -70.0), rotation_euler=(0.3, 0.1, 0.5))
    camera.location, camera.scale = (2.0, 3.0, 4.0), (1.0, 1.0, 1.0)


def stretch(camera):
    target = added(bpy.data.objects.new("Target", None), (400.0, 90.0, 0.0))
    camera.constraints.new("STRETCH_TO").target = target
    camera.parent = added(bpy.data.objects.new("Dolly", None), (90.0, 0.0, -70.0), rotation_euler=(0.3, 0.1, 0.5))
    camera.location, camera.scale = (2.0, 3.0, 4.0), (1.0, 1.0, 1.0)


@pytest.mark.parametrize("constrain", [follow, track, stretch])
def test_constraints_that_leave_room_are_reckoned_with(askew, constrain):
    camera = bpy.context.scene.camera
    constrain(camera)
    bpy.context.view_layer.update()
    free = camera.matrix_world.translation.copy()
    only(camera)
    bpy.ops.adaptive_terrain.keep_above_ground(clearance=1.0)
    at = camera.matrix_world.translation
    assert (at.xy - free.xy).length < 1e-3 and at.z == pytest.approx(Cast(askew).height(at) + 1.0, abs=NEAR)
    if constrain is track:
        ahead = camera.matrix_world.to_3x3() @ Vector((0.0, 0.0, -1.0))
        assert ahead.angle(bpy.data.objects["Target"].location - at) < 1e-3, "it looks there from its new place"


def test_a_clearance_that_is_no_number_keeps_nothing(flight):
    bpy.ops.adaptive_terrain.let_go()
    with pytest.raises(RuntimeError, match="clearance is nan"):
        bpy.ops.adaptive_terrain.keep_above_ground(clearance=float("nan"))
    assert not flight.camera.adaptive_terrain_keep.keep


def test_a_constraint_that_holds_an_object_is_reported(askew, capfd):
    rock, target = cube("Rock", (0.0, 0.0, 0.0)), added(bpy.data.objects.new("Target", None), (90.0, 0.0, -700.0))
    rock.constraints.new("COPY_LOCATION").target = target
    only(rock)
    keep()
    assert "a constraint holds it" in keep_ground.note_of(rock) and rock.delta_location.length == 0.0


def test_an_object_that_follows_a_held_one_is_placed(askew):
    rock, target = cube("Rock", (0.0, 0.0, 0.0)), added(bpy.data.objects.new("Target", None), (90.0, 0.0, -700.0))
    rock.constraints.new("COPY_LOCATION").target = target
    rider = cube("Rider", (10.0, 5.0, 0.0), parent=rock)
    for obj in (rider, rock):
        only(obj)
        keep()
    at = rider.matrix_world.translation
    assert at.z == pytest.approx(Cast(askew).height(at), abs=NEAR)
    assert "holds it" in keep_ground.note_of(rock) and not keep_ground.note_of(rider)


def test_a_terrain_that_left_the_scene_is_named(askew):
    rock = cube("Rock", (80.0, -20.0, 0.0))
    only(askew, rock, active=askew)
    keep()
    bpy.context.scene.collection.objects.unlink(askew)
    bpy.context.scene.frame_set(3)
    assert rock.matrix_world.translation.z == 0.0
    assert "its terrain 'Askew' is not in the scene" in keep_ground.note_of(rock)
    bpy.context.scene.collection.objects.link(askew)
    bpy.context.scene.frame_set(4)
    assert not keep_ground.note_of(rock) and rock.matrix_world.translation.z != 0.0


def test_a_kept_child_of_a_kept_object_is_not_lifted_twice(askew):
    cast, car = Cast(askew), cube("Car", (80.0, -20.0, -300.0))
    rider = cube("Rider", (10.0, 5.0, 0.0), parent=car)
    for obj in (rider, car):
        only(obj)
        keep(offset=1.0)
    bpy.context.scene.frame_set(3)
    for obj in (car, rider):
        at = obj.matrix_world.translation
        assert at.z == pytest.approx(cast.height(at) + 1.0, abs=NEAR)


def test_the_live_update_settles_what_has_moved_and_nothing_else(askew, monkeypatch):
    session.update_object(askew)
    rock = cube("Rock", (80.0, -20.0, 0.0))
    only(rock)
    keep()
    settled = []
    whole = keep_ground.settle
    monkeypatch.setattr(keep_ground, "settle", lambda *a, **k: settled.append(1) or whole(*a, **k))
    scene, depsgraph = bpy.context.scene, bpy.context.evaluated_depsgraph_get()
    keep_ground.settle_shown(scene, depsgraph)
    assert not settled, "nothing has changed"
    for change in (lambda: setattr(rock, "location", (150.0, 10.0, 0.0)),
                   lambda: setattr(askew.adaptive_terrain, "vertical_offset", 44.0)):  # fmt: skip
        change()
        bpy.context.view_layer.update()
        keep_ground.settle_shown(scene, depsgraph)
        at = rock.matrix_world.translation
        assert at.z == pytest.approx(Cast(askew).height(at), abs=NEAR)
    assert len(settled) == 2


def test_it_waits_for_kernels_that_are_being_prepared(askew, monkeypatch):
    session.update_object(askew)
    rock = cube("Rock", (80.0, -20.0, 0.0))
    only(rock)
    keep()
    rock.location.x = 150.0
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    monkeypatch.setattr(warmup, "prepare_modules", lambda modules: False)
    assert not keep_ground.settle_shown(bpy.context.scene, depsgraph), "ask again"
    monkeypatch.setattr(warmup, "prepare_modules", lambda modules: True)
    assert keep_ground.settle_shown(bpy.context.scene, depsgraph)
    at = rock.matrix_world.translation
    assert at.z == pytest.approx(Cast(askew).height(at), abs=NEAR)


def test_a_scene_that_keeps_nothing_asks_for_no_ground(askew, monkeypatch):
    cube("Rock", (0.0, 0.0, 0.0))
    monkeypatch.setattr(world_ground, "grounds_of", lambda *a, **k: 1 / 0)
    bpy.context.scene.frame_set(3)
    keep_ground.settle_shown(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    assert len(askew.data.polygons) > 100


def test_what_is_appended_kept_is_found(askew, tmp_path):
    rock = cube("Rock", (80.0, -20.0, 0.0))
    rock.adaptive_terrain_keep.keep = True
    bpy.data.libraries.write(str(tmp_path / "rocks.blend"), {rock})
    bpy.data.objects.remove(rock)
    bpy.context.scene.frame_set(2)
    assert not keep_ground.objects_on_ground(bpy.context.scene)
    with bpy.data.libraries.load(str(tmp_path / "rocks.blend")) as (_, wanted):
        wanted.objects = ["Rock"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    bpy.context.scene.frame_set(3)
    at = wanted.objects[0].matrix_world.translation
    assert at.z == pytest.approx(Cast(askew).height(at), abs=NEAR)


def test_beyond_the_terrain_it_is_where_its_animation_has_it(drive):
    drive.parent.location.x = 9000.0
    bpy.context.scene.frame_set(4)
    free = drive.matrix_world.copy()
    drive.adaptive_terrain_keep.keep = True
    bpy.context.scene.frame_set(4)
    assert drive.matrix_world == free
