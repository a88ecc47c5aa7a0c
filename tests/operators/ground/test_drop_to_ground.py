# SPDX-License-Identifier: GPL-3.0-or-later
"""Drop to Ground, compared with Blender's ray casting on a fine grid, over a tilted terrain."""

import bpy
import numpy as np
import pytest
from ground_scenes import ASKEW, Cast, added, cube, only, place
from mathutils import Matrix, Vector

NEAR = 0.02  # metres: error of the quads used for ray casting


def drop(**settings):
    return bpy.ops.adaptive_terrain.drop_to_ground(**settings)


def world(obj) -> Matrix:
    bpy.context.view_layer.update()
    return obj.matrix_world.copy()


def test_origins_lie_on_the_ground_and_stay_above_their_places(askew):
    cast = Cast(askew)
    rocks = [cube(f"Rock {n}", (x, y, z)) for n, (x, y, z) in enumerate([(90, -60, 400), (150, 10, -300), (40, 5, 0)])]
    only(*rocks)
    assert drop(anchor="ORIGIN", offset=0.5) == {"FINISHED"}
    for rock, (x, y) in zip(rocks, [(90, -60), (150, 10), (40, 5)], strict=True):
        at = world(rock).translation
        assert at.xy == Vector((x, y)) and at.z == pytest.approx(cast.height(at) + 0.5, abs=NEAR)
    before = [world(rock) for rock in rocks]
    drop(anchor="ORIGIN", offset=0.5)
    assert np.allclose([world(rock) for rock in rocks], before, atol=1e-4), "dropped again they stay"


def test_the_lowest_corner_lies_on_the_ground_below_the_middle(askew):
    cast, box = Cast(askew), cube("Box", (100.0, -20.0, 50.0), rotation_euler=(0.4, 0.3, 0.0), scale=(1.0, 3.0, 2.0))
    only(box)
    drop()
    corners = [world(box) @ Vector(corner) for corner in box.bound_box]
    middle = sum((corner.xy for corner in corners), Vector((0.0, 0.0))) / 8
    assert min(corner.z for corner in corners) == pytest.approx(cast.height(middle), abs=NEAR)


@pytest.mark.parametrize("mode", ["XYZ", "QUATERNION", "AXIS_ANGLE"])
def test_it_turns_to_the_normal(askew, mode):
    cast, box = Cast(askew), cube("Box", (70.0, -80.0, 0.0), rotation_mode=mode)
    only(box)
    drop(anchor="ORIGIN", align=True)
    matrix = world(box)
    assert matrix.to_3x3().col[2].angle(cast.normal(matrix.translation)) < 0.03
    assert matrix.translation.z == pytest.approx(cast.height(matrix.translation), abs=NEAR)


def test_parents_that_are_turned_and_scaled_are_reckoned_with(askew):
    cast, up = Cast(askew), added(bpy.data.objects.new("Up", None), (10.0, 20.0, 30.0))
    up.rotation_euler, up.scale = (0.5, 1.0, 0.2), (2.0, 0.5, 3.0)
    rock = cube("Rock", (30.0, -40.0, 5.0), parent=up)
    only(rock)
    before = world(rock)
    drop(anchor="ORIGIN")
    after = world(rock)
    assert after.translation.z == pytest.approx(cast.height(after.translation), abs=NEAR)
    assert (after.translation.xy - before.translation.xy).length < 1e-3
    assert up.location.z == 30.0


def test_children_of_a_dropped_object_are_not_dropped_twice(askew):
    cast, car = Cast(askew), cube("Car", (90.0, 0.0, 300.0))
    wheel = cube("Wheel", (2.0, 0.0, 0.0), parent=car)
    only(wheel, car)
    drop(anchor="ORIGIN")
    assert wheel.location == Vector((2.0, 0.0, 0.0))
    assert world(car).translation.z == pytest.approx(cast.height((90, 0)), abs=NEAR)


def test_a_mesh_on_an_armature_takes_that_along(askew):
    cast, rig = Cast(askew), added(bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig")), (60.0, 0.0, 90.0))
    body = cube("Body", (0.0, 0.0, 3.0), parent=rig)
    only(body)
    drop()
    assert body.location.z == 3.0
    lowest = world(body).translation.z  # the box's lower side is the origin's height
    assert lowest == pytest.approx(cast.height((60, 0)), abs=NEAR) and rig.location.z != 90.0


def test_instances_of_collections_lie_on_their_boxes(askew):
    collection = bpy.data.collections.new("Trees")
    tree = cube("Tree", (5.0, 0.0, 7.0))
    bpy.context.scene.collection.objects.unlink(tree)
    collection.objects.link(tree)
    collection.instance_offset = (5.0, 0.0, 0.0)
    empty = added(bpy.data.objects.new("Instance", None), (100.0, -50.0, 0.0))
    empty.instance_type, empty.instance_collection, empty.scale = "COLLECTION", collection, (1.0, 1.0, 2.0)
    cast = Cast(askew)
    only(empty)
    drop()
    assert world(empty).translation.z + 2 * 7.0 == pytest.approx(cast.height((100, -50)), abs=NEAR)


def curve_object(kind: str, points, location=(0.0, 0.0, 0.0)):
    data = bpy.data.curves.new("Path", "CURVE")
    data.dimensions = "3D"
    spline = data.splines.new(kind)
    if kind == "BEZIER":
        spline.bezier_points.add(len(points) - 1)
        for point, co in zip(spline.bezier_points, points, strict=True):
            point.co, point.handle_left, point.handle_right = co, (co[0] - 5, co[1], co[2]), (co[0] + 5, co[1], co[2])
    else:
        spline.points.add(len(points) - 1)
        for point, co in zip(spline.points, points, strict=True):
            point.co = (*co, 1.0)
    return added(bpy.data.objects.new("Path", data), location)


@pytest.mark.parametrize("kind", ["BEZIER", "POLY", "NURBS"])
def test_each_point_of_a_curve_lies_on_the_ground(askew, kind):
    path = curve_object(kind, [(0.0, 0.0, 5.0), (30.0, -20.0, 80.0), (5000.0, 0.0, 9.0)], (60.0, -30.0, 12.0))
    path.rotation_euler, path.scale = (0.3, 0.0, 1.0), (1.0, 2.0, 1.0)
    only(path)
    before = world(path)
    cast = Cast(askew)
    spline = path.data.splines[0]
    points = spline.bezier_points if kind == "BEZIER" else spline.points
    places = [before @ point.co.to_3d() for point in points]
    assert drop(offset=1.0) == {"FINISHED"}
    assert world(path) == before
    for point, was in list(zip(points, places, strict=True))[:2]:
        now = before @ point.co.to_3d()
        assert now.z == pytest.approx(cast.height(was) + 1.0, abs=NEAR) and (now.xy - was.xy).length < 1e-3
    assert (before @ points[2].co.to_3d() - places[2]).length < 1e-3, "beyond the terrain it stays"
    if kind == "BEZIER":
        across = before.to_3x3() @ (points[0].handle_right - points[0].co)
        assert (across - before.to_3x3() @ Vector((5.0, 0.0, 0.0))).length < 1e-3


def test_the_highest_terrain_counts_unless_one_is_active(askew, add_terrain, hills_store):
    other = place(add_terrain("Above"), hills_store, Matrix.Translation((0.0, 0.0, 200.0)) @ ASKEW)
    low, high = Cast(askew), Cast(askew, other)
    rock = cube("Rock", (100.0, -30.0, 80.0))
    only(rock)
    drop(anchor="ORIGIN")
    assert world(rock).translation.z == pytest.approx(high.height((100, -30)), abs=NEAR)
    only(rock, askew, active=askew)
    drop(anchor="ORIGIN")
    assert world(rock).translation.z == pytest.approx(low.height((100, -30)), abs=NEAR)
    other.hide_render, other.location.z = True, 900.0
    only(rock)
    drop(anchor="ORIGIN")
    assert world(rock).translation.z == pytest.approx(low.height((100, -30)), abs=NEAR)


def refused(capfd, **settings) -> str:
    assert drop(**settings) == {"CANCELLED"}
    return capfd.readouterr().out


def test_an_object_that_cannot_move_reports_why(askew, capfd):
    rock = cube("Rock", (100.0, -30.0, 80.0))
    only(rock)
    rock.lock_location[2] = True
    assert "'Rock' has locked transforms" in refused(capfd)
    rock.lock_location[2] = False
    rock.keyframe_insert("location", frame=1)
    assert "'Rock' is animated" in refused(capfd)
    rock.animation_data_clear()
    rock.location.x = 9000.0
    assert "'Rock' has no ground above or below it" in refused(capfd)
    rock.location.x = 100.0
    target = added(bpy.data.objects.new("Target", None), (90.0, 0.0, 700.0))
    rock.constraints.new("COPY_LOCATION").target = target
    only(rock)
    assert "a constraint holds it" in refused(capfd)
    rock.constraints.clear()
    rock.delta_location.z = 3.0
    assert "already has delta transforms" in refused(capfd, keep=True)
    assert rock.delta_location.z == 3.0 and not rock.adaptive_terrain_keep.keep
    assert drop(anchor="ORIGIN") == {"FINISHED"}, "a drop leaves them alone"
    assert world(rock).translation.z == pytest.approx(Cast(askew).height((100, -30)), abs=NEAR)


def test_one_that_cannot_be_moved_stops_no_other(askew, capfd):
    cast, rock = Cast(askew), cube("Rock", (90.0, -60.0, 300.0))
    flat, lost, held = (cube(name, (120.0, -30.0, 200.0)) for name in ("Flat", "Lost", "Held"))
    flat.scale.x, lost.location.x = 0.0, float("nan")
    only(held)
    drop(anchor="ORIGIN", keep=True)
    held.location.x = 9000.0
    only(flat, lost, held, rock)
    assert drop(anchor="ORIGIN") == {"FINISHED"}
    assert world(rock).translation.z == pytest.approx(cast.height(rock.location), abs=NEAR)
    assert flat.location.z == 200.0 and held.adaptive_terrain_keep.keep, "objects not dropped do not change"
    assert not flat.adaptive_terrain_keep.keep and not rock.adaptive_terrain_keep.keep
    output = capfd.readouterr().out
    assert "The object 'Flat' or its parent has a scale of 0" in output
    assert "'Lost' has a location" in output and "1 of 4" in output


def test_an_object_without_ground_below_its_origin_is_not_kept(askew, capfd):
    rock = cube("Rock", (9000.0, -30.0, 80.0))
    rock.data.transform(Matrix.Translation((-8900.0, 0.0, 0.0)))
    only(rock)
    assert "'Rock' has no ground below its origin" in refused(capfd, keep=True)
    assert not rock.adaptive_terrain_keep.keep and rock.adaptive_terrain_keep.offset == 0.0
    assert drop() == {"FINISHED"}, "without keeping, the ground below its middle is enough"
    lowest = min((world(rock) @ Vector(corner)).z for corner in rock.bound_box)
    assert lowest == pytest.approx(Cast(askew).height((100.0, -30.0)), abs=NEAR)


def test_linked_objects_are_left_alone(askew, tmp_path, capfd):
    rock = cube("Rock", (100.0, -30.0, 80.0))
    bpy.data.libraries.write(str(tmp_path / "rocks.blend"), {rock})
    bpy.data.objects.remove(rock)
    with bpy.data.libraries.load(str(tmp_path / "rocks.blend"), link=True) as (_, wanted):
        wanted.objects = ["Rock"]
    [rock] = wanted.objects
    bpy.context.scene.collection.objects.link(rock)
    only(rock)
    for settings in ({}, {"keep": True}):
        assert "'Rock' is linked from a library: make it local." in refused(capfd, **settings)
    assert rock.location.z == 80.0 and not rock.adaptive_terrain_keep.keep


def test_without_ground_or_objects_the_button_is_grey(scene, add_terrain):
    rock = cube("Rock", (0.0, 0.0, 0.0))
    only(rock)
    assert not bpy.ops.adaptive_terrain.drop_to_ground.poll()
    terrain = add_terrain()
    only(rock)
    assert bpy.ops.adaptive_terrain.drop_to_ground.poll()
    only(terrain)
    assert not bpy.ops.adaptive_terrain.drop_to_ground.poll()
    terrain.adaptive_terrain.store = "/nowhere"
    only(rock)
    with pytest.raises(RuntimeError, match="/nowhere"):
        drop()
