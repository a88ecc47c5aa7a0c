# SPDX-License-Identifier: GPL-3.0-or-later
"""Pick, Profile, Viewshed and Add Collider, compared with Blender's ray casting and brute force."""

import csv
import xml.etree.ElementTree as ET

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.ground import add_collider
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.text import profile_plot
from ground_scenes import ASKEW, COLUMNS, ROWS, STEP, Cast, added, cube, hills, only, place
from mathutils import Matrix, Vector

NEAR = 0.03


@pytest.mark.parametrize("ray", [((500, -900, 300), (-0.4, 0.9, -0.28)), ((100, -50, -900), (0.01, 0.02, 5.0))])
def test_a_ray_puts_the_cursor_where_blender_hits(askew, ray):
    scene, hit = bpy.context.scene, Cast(askew).ray(*map(Vector, ray))
    assert bpy.ops.adaptive_terrain.pick_ground(origin=ray[0], direction=ray[1]) == {"FINISHED"}
    assert (scene.cursor.location - hit[0]).length < 3 * NEAR
    rock = cube("Rock", (0.0, 0.0, 0.0))
    rock.parent = added(bpy.data.objects.new("Up", None), (9.0, 9.0, 9.0), rotation_euler=(1.0, 0.5, 0.2))
    only(rock)
    bpy.ops.adaptive_terrain.pick_ground(moves="OBJECT", origin=ray[0], direction=ray[1])
    bpy.context.view_layer.update()
    assert (rock.matrix_world.translation - scene.cursor.location).length < 1e-3


def test_rays_that_hit_nothing_say_so(askew):
    for direction in ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (float("nan"), 0.0, 1.0)):
        with pytest.raises(RuntimeError, match="no ground under the mouse|leads nowhere"):
            bpy.ops.adaptive_terrain.pick_ground(origin=(0.0, 0.0, 900.0), direction=direction)


def curve(points, cyclic=False, **settings):
    data = bpy.data.curves.new("Road", "CURVE")
    data.dimensions = "3D"
    for name, value in settings.items():
        setattr(data, name, value)
    for line in points:
        spline = data.splines.new("POLY")
        spline.points.add(len(line) - 1)
        spline.use_cyclic_u = cyclic
        for point, co in zip(spline.points, line, strict=True):
            point.co = (*co, 1.0)
    obj = added(bpy.data.objects.new("Road", data), (90.0, -60.0, 500.0))
    obj.rotation_euler.z = 0.3
    only(obj)
    return obj


@pytest.fixture
def turned(scene, add_terrain, hills_store):
    """Return a terrain that is moved, rotated about Z and scaled, so that its vertical is the world's."""
    matrix = Matrix.LocRotScale(Vector((120.0, -40.0, 30.0)), Matrix.Rotation(0.7, 3, "Z"), Vector((1.5, 0.75, 1.25)))
    return place(add_terrain("Turned"), hills_store, matrix)


def test_a_profile_lies_on_the_ground_and_is_written(turned, tmp_path):
    cast = Cast(turned)
    curve([[(0.0, 0.0, 0.0), (60.0, 30.0, 50.0), (60.0, -40.0, 0.0)]], bevel_depth=2.0, extrude=1.0)
    assert bpy.ops.adaptive_terrain.profile(filepath=str(tmp_path / "road.csv")) == {"FINISHED"}
    road = bpy.data.objects["Road Profile"]
    bpy.context.view_layer.update()
    points = [road.matrix_world @ point.co.to_3d() for point in road.data.splines[0].points]
    assert len(points) > 8 and len(road.data.splines) == 1
    assert max(abs(point.z - cast.height(point)) for point in points) < NEAR
    rows = list(csv.DictReader((tmp_path / "road.csv").open()))
    assert len(rows) == len(points)
    lengths = [0.0, *np.cumsum([(b.xy - a.xy).length for a, b in zip(points, points[1:], strict=False)])]
    for row, point, length in zip(rows, points, lengths, strict=True):
        assert float(row["height_m"]) == pytest.approx(point.z, abs=1e-3)
        assert float(row["distance_m"]) == pytest.approx(length, abs=1e-2)
    own = [Matrix.Rotation(0.3, 3, "Z") @ Vector(p) + Vector((90.0, -60.0, 0.0)) for p in ((0, 0, 0), (60, -40, 0))]
    assert (points[0].xy - own[0].xy).length < 1e-3 and (points[-1].xy - own[1].xy).length < 1e-3
    picture = ET.parse(tmp_path / "road.svg").getroot()
    assert "Road: height over distance" in picture.attrib["aria-label"]


def test_several_splines_and_ends_beyond_the_terrain(turned, tmp_path):
    road = curve([[(-9000.0, 0.0, 0.0), (0.0, 0.0, 0.0)], [(0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (0.0, 9.0, 0.0)]], True)
    assert bpy.ops.adaptive_terrain.profile(spacing=5.0, filepath=str(tmp_path / "road")) == {"FINISHED"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["road_1.csv", "road_1.svg", "road_2.csv", "road_2.svg"]
    first = list(csv.DictReader((tmp_path / "road_1.csv").open()))
    known = [bool(row["height_m"]) for row in first]
    assert not known[0] and any(known)
    second = list(csv.DictReader((tmp_path / "road_2.csv").open()))
    assert [second[0][n] for n in ("x_m", "y_m")] == [second[-1][n] for n in ("x_m", "y_m")], "a cyclic one comes back"
    road.location.x = 90000.0
    only(road)
    with pytest.raises(RuntimeError, match="no terrain above or below the curve 'Road'"):
        bpy.ops.adaptive_terrain.profile()


def test_a_profile_that_cannot_be_written_leaves_nothing(turned, tmp_path):
    road = curve([[(0.0, 0.0, 0.0), (60.0, 30.0, 50.0)]])
    before = len(bpy.data.objects), len(bpy.data.curves)
    for path, message in (("//", "has no name"), (str(tmp_path / "none" / "road.csv"), "cannot be written")):
        only(road)
        with pytest.raises(RuntimeError, match=message):
            bpy.ops.adaptive_terrain.profile(filepath=path)
    assert (len(bpy.data.objects), len(bpy.data.curves)) == before


def test_a_profile_picture_breaks_at_missing_ground():
    along, heights = np.arange(6.0) * 100, np.array([10.0, 20.0, np.nan, np.nan, 30.0, 25.0])
    drawn = ET.fromstring(profile_plot.draw(along, heights, "A < B"))
    lines = [line.attrib["points"].split() for line in drawn.iter() if "stroke:" in str(line.attrib) or
             (line.tag.endswith("polyline") and "teal" in line.attrib["stroke"])]  # fmt: skip
    assert [len(line) for line in lines] == [2, 2]
    texts = [text.text for text in drawn.iter() if text.tag.endswith("text")]
    assert "500 m" in texts and "A < B" in texts
    assert "No ground" in profile_plot.draw(along, np.full(6, np.nan), "B")


def sees(eye: np.ndarray, own: np.ndarray, heights: np.ndarray, lift: float) -> np.ndarray:
    """Test visibility by brute force at 398 points of each line of sight; return bool [rows, columns].

    `own`: positions of the samples, [rows, columns, 3].
    """
    t = np.linspace(0.0, 1.0, 400)[1:-1, None, None]
    target = own + [0.0, 0.0, lift]
    line = [eye[n] * t + target[None, ..., n] * (1 - t) for n in range(3)]
    i, j = line[0] / STEP + (COLUMNS - 1) / 2, line[1] / STEP + (ROWS - 1) / 2
    x, y = np.clip(i.astype(int), 0, COLUMNS - 2), np.clip(j.astype(int), 0, ROWS - 2)
    u, v = i - x, j - y
    low = heights[y, x] * (1 - u) + heights[y, x + 1] * u
    ground = low * (1 - v) + (heights[y + 1, x] * (1 - u) + heights[y + 1, x + 1] * u) * v
    outside = (i < 0) | (j < 0) | (i > COLUMNS - 1) | (j > ROWS - 1)
    return (outside | (line[2] >= ground)).all(0)


def test_a_viewshed_is_an_image_and_an_attribute(askew):
    settings, watcher = askew.adaptive_terrain, cube("Watcher", (0.0, 0.0, 0.0))
    settings.viewport.error_px, settings.viewport.error_m = 0.0, 0.05
    session.update_object(askew)
    watcher.location = askew.matrix_world @ Vector((150.0, -60.0, 30.0))
    only(watcher)
    assert bpy.ops.adaptive_terrain.viewshed(target_height=1.0) == {"FINISHED"}
    image = bpy.data.images["Askew viewshed"]
    assert tuple(image.size) == (COLUMNS, ROWS) and image.packed_file
    pixels = np.array(image.pixels[:]).reshape(ROWS, COLUMNS, 4)[..., 0] > 0.5
    heights = hills(COLUMNS, ROWS) * 1.5 + 10.0
    y, x = np.mgrid[0:ROWS, 0:COLUMNS] * STEP
    own = np.stack([x - x.max() / 2, y - y.max() / 2, heights], -1)
    expected = sees(np.array((150.0, -60.0, 30.0)), own, heights, 1.0)
    assert 0.1 < expected.mean() < 0.9 and (pixels == expected).mean() > 0.995
    mesh = askew.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    seen = np.array([v.value for v in mesh.attributes["viewshed"].data])
    at = np.array([v.co for v in mesh.vertices])[:, :2] / STEP + [(COLUMNS - 1) / 2, (ROWS - 1) / 2]
    on = np.abs(at - at.round()).max(1) < 1e-3
    rows, columns = at[on].round().astype(int)[:, 1], at[on].round().astype(int)[:, 0]
    assert on.sum() > 300 and np.abs(seen[on] - pixels[rows, columns]).max() < 0.02
    only(askew)
    bpy.ops.adaptive_terrain.viewshed(radius=100.0)
    assert len(askew.modifiers) == 1 and len(bpy.data.images) == 1
    assert np.array(image.pixels[:]).reshape(-1, 4)[:, 0].mean() < 0.1, "the camera is far away"


def test_a_long_name_has_one_viewshed_and_its_copy_another(askew):
    """Blender cuts names, so a mark identifies a terrain's image and node group."""
    askew.name = "\u00e9" * 31
    only(askew)
    for _ in range(2):
        assert bpy.ops.adaptive_terrain.viewshed(radius=100.0) == {"FINISHED"}
    assert len(bpy.data.images) == len(bpy.data.node_groups) == 1
    copy = askew.copy()
    copy.data = askew.data.copy()
    bpy.context.collection.objects.link(copy)
    only(copy)
    assert bpy.ops.adaptive_terrain.viewshed(radius=100.0) == {"FINISHED"}
    assert len(bpy.data.images) == 2 and copy.modifiers[0].node_group != askew.modifiers[0].node_group


def test_a_collider_holds_its_bound_and_is_made_again(askew):
    askew.adaptive_terrain.collider_error_m = 2.0
    only(askew)
    assert bpy.ops.adaptive_terrain.add_collider() == {"FINISHED"}
    collider = add_collider.collider_of(askew)
    assert collider.hide_render and collider.parent == askew and collider.rigid_body is None
    bound = collider[add_collider.MARK]
    coarse = len(collider.data.polygons)
    assert 0.2 < bound <= 2.0 * (1 + 1e-6) and coarse < 2 * COLUMNS * ROWS
    off = worst(askew, collider)
    assert 0.2 < off <= bound + NEAR
    askew.adaptive_terrain.collider_error_m, askew.adaptive_terrain.vertical_scale = 0.5, 2.0
    assert bpy.ops.adaptive_terrain.add_collider(rigid_body=True) == {"FINISHED"}
    assert add_collider.collider_of(askew) == collider and len(askew.children) == 1
    assert len(collider.data.polygons) > coarse and worst(askew, collider) <= collider[add_collider.MARK] + NEAR
    assert (collider.rigid_body.type, collider.rigid_body.collision_shape) == ("PASSIVE", "MESH")
    assert bpy.context.view_layer.objects.active == askew


def worst(terrain, collider) -> float:
    """Return the largest distance in metres of the world, along the terrain's Z, between the collider and the hills."""
    bpy.context.view_layer.update()
    settings, height = terrain.adaptive_terrain, hills()
    metres, off = ASKEW.to_3x3().col[2].length, []
    for row in range(1, ROWS - 1, 2):
        for column in range(1, COLUMNS - 1, 2):
            x, y = (column - (COLUMNS - 1) / 2) * STEP, (row - (ROWS - 1) / 2) * STEP
            hit, point, *_ = collider.ray_cast((x, y, 900.0), (0.0, 0.0, -1.0))
            assert hit
            own = height[row, column] * settings.vertical_scale + settings.vertical_offset
            off.append(abs(point.z - own) * metres)
    return max(off)


def test_a_ball_comes_to_rest_on_the_collider(turned):
    scene = bpy.context.scene
    only(turned)
    turned.adaptive_terrain.collider_error_m = 0.2
    bpy.ops.adaptive_terrain.add_collider(rigid_body=True)
    bpy.ops.mesh.primitive_ico_sphere_add(radius=1.0, location=(100.0, -20.0, Cast(turned).height((100, -20)) + 4.0))
    ball = bpy.context.object
    bpy.ops.rigidbody.object_add(type="ACTIVE")
    ball.rigid_body.collision_shape = "SPHERE"
    for frame in range(1, 30):
        scene.frame_set(frame)
    at = ball.matrix_world.translation
    assert 0.3 < at.z - Cast(turned).height(at) < 2.0, "it lies or rolls, and has not fallen through"
