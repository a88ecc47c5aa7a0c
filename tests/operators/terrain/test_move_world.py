# SPDX-License-Identifier: GPL-3.0-or-later
"""Move World Here: the same picture, with exact positions; and everything that reads a terrain follows its anchor."""

from pathlib import Path

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.operators.ground import world_ground
from adaptive_terrain.operators.ground.shifting import curves_of
from adaptive_terrain.operators.maps.request import visit_for_request
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain.move_world import set_anchor
from adaptive_terrain.operators.terrain.request import RENDER
from blender_meshes import positions
from demand_trees import new_object
from land_scenes import add, stack_now
from mathutils import Euler, Matrix, Vector
from rasters import store_heights

STEP, COLUMNS, ROWS = 123.4, 8193, 5  # 1,011 km from west to east
FAR = 499_712.0


@pytest.fixture(scope="module")
def country(tmp_path_factory):
    """Return a store of a strip of land 1,011 km long."""
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    heights = 300 * np.sin(x / 3) * np.cos(y / 2) + 40 * np.sin(x * 1.7)
    return str(store_heights(tmp_path_factory.mktemp("stores") / "country", heights, STEP))


def look_far(scene, terrain):
    """Put the camera on a path of 20 frames 500 km from the middle of the terrain's raster."""
    camera = scene.camera
    scene.frame_start, scene.frame_end = 1, 20
    for frame, x in ((1, FAR - 200.0), (20, FAR + 200.0)):
        camera.location = terrain.matrix_world @ Vector((x, -400.0, 900.0))
        camera.keyframe_insert("location", frame=frame)
    scene.frame_set(7)


def ground_points(obj) -> np.ndarray:
    """Return vertices of an updated terrain near the camera, in the world, float64 [n, 3] without float32 steps."""
    session.update_object(obj, mode=RENDER)
    matrix = np.array(obj.matrix_world, np.float64)
    world = positions(obj).astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    camera = np.array(bpy.context.scene.camera.matrix_world.translation)
    return world[np.hypot(*(world - camera)[:, :2].T) < 1500.0]


def errors(points: np.ndarray, obj, store: str, moved: float) -> np.ndarray:
    """Return how far vertices are from the lattice that float64 puts them on, metres along x of the raster."""
    surface = session.record_of(obj).terrain.history.last.result.update.surface
    finest = STEP * 2.0 ** -(int(surface.level.max()) // 2 + 1)
    west = -(COLUMNS - 1) / 2 * STEP
    own = points[:, 0] - moved - west
    return np.abs(own - np.round(own / finest) * finest)


def test_positions_in_the_world_become_exact(scene, add_terrain, country):
    terrain = add_terrain()
    terrain.adaptive_terrain.store, terrain.adaptive_terrain.render.error_px = country, 0.1
    look_far(scene, terrain)
    before = errors(ground_points(terrain), terrain, country, 0.0)
    assert 0.01 < before.max() < 0.0157
    rock = bpy.data.objects.new("Rock", None)
    scene.collection.objects.link(rock)
    rock.parent, rock.location = terrain, (FAR, 30.0, 5.0)
    assert bpy.ops.adaptive_terrain.move_world() == {"FINISHED"}
    assert list(terrain.adaptive_terrain.anchor) == [FAR, 0.0] and list(terrain.location) == [0.0, 0.0, 0.0]
    assert scene.frame_current == 7
    points = ground_points(terrain)
    after = errors(points, terrain, country, -FAR)
    assert len(points) > 30 and after.max() < 1.3e-4, "float32 has steps of 0.12 mm at 1.5 km"
    xs = [curves_of(scene.camera.animation_data, "location")[0].evaluate(frame) for frame in (1, 20)]
    assert xs == pytest.approx([-200.0, 200.0], abs=0.04)
    bpy.context.view_layer.update()
    assert (rock.matrix_world.translation - Vector((0.0, 30.0, 5.0))).length < 0.04
    twice = np.array(terrain.matrix_world)
    bpy.ops.adaptive_terrain.move_world()
    assert np.array_equal(twice, np.array(terrain.matrix_world)), "nothing is left to move"


def test_small_scenes_keep_every_byte(scene, add_terrain):
    terrain = add_terrain()
    update = session.update_object(terrain, mode=RENDER)
    before = update.surface.positions.tobytes(), session.record_of(terrain).status.digest
    bpy.ops.adaptive_terrain.move_world()
    assert list(terrain.adaptive_terrain.anchor) == [0.0, 0.0] and list(terrain.location) == [0.0, 0.0, 0.0]
    update = session.update_object(terrain, mode=RENDER)
    assert before == (update.surface.positions.tobytes(), session.record_of(terrain).status.digest)


@pytest.mark.parametrize("parented", [False, True])
def test_a_turned_and_scaled_terrain_stays_in_the_world(scene, add_terrain, parented):
    """Two terrains, one of them with a parent; frame 9, and the render differs from the viewport."""
    terrain, other = add_terrain("Turned"), add_terrain("Other")
    other.location = (5000.0, 0.0, 0.0)
    scene.frame_set(9)
    matrix = Matrix.LocRotScale(Vector((120.0, -40.0, 30.0)), Euler((0.1, -0.2, 0.7)), Vector((1.5, 0.75, 1.25)))
    if parented:
        up = bpy.data.objects.new("Up", None)
        scene.collection.objects.link(up)
        up.matrix_world = Matrix.LocRotScale(Vector((9.0, 9.0, 9.0)), Euler((0.3, 0.5, 0.2)), Vector((2.0, 1.0, 3.0)))
        terrain.parent = up
    terrain.matrix_basis = matrix
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    places = np.random.default_rng(1).uniform(-300.0, 300.0, (40, 3)) + np.array(terrain.matrix_world.translation)
    found = world_ground.find_below([world_ground.ground_of(terrain, depsgraph)], places).heights
    child = bpy.data.objects.new("Child", None)
    scene.collection.objects.link(child)
    child.parent, child.location = terrain, (1.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    stood, vertices = child.matrix_world.copy(), world_box(terrain)
    set_anchor(terrain, 256.0, -192.0)
    bpy.context.view_layer.update()
    ground = world_ground.ground_of(terrain, bpy.context.evaluated_depsgraph_get())
    assert np.nanmax(np.abs(world_ground.find_below([ground], places).heights - found)) < 1e-3
    assert np.isfinite(found).sum() > 20
    assert max(abs(a - b) for a, b in zip(np.ravel(child.matrix_world), np.ravel(stood), strict=True)) < 1e-3
    assert np.abs(world_box(terrain) - vertices).max() < 1e-2
    assert list(other.adaptive_terrain.anchor) == [0.0, 0.0]


def world_box(obj) -> np.ndarray:
    """Return the corners of a terrain's render mesh in the world."""
    session.update_object(obj, mode=RENDER)
    points = np.array([obj.matrix_world @ vertex.co for vertex in obj.data.vertices])
    return np.stack([points.min(axis=0), points.max(axis=0)])


def vertices_of(obj) -> np.ndarray:
    """Return the vertices of a mesh in the world, float64 [n, 3], in a fixed order."""
    found = np.array([obj.matrix_world @ vertex.co for vertex in obj.data.vertices])
    return found[np.lexsort(found.round(1).T)]


def test_scatters_water_and_colliders_follow_the_anchor(scene, add_terrain):
    terrain = add_terrain()
    bpy.ops.adaptive_terrain.scatter_add()
    scatter = bpy.context.object
    bpy.context.view_layer.objects.active = terrain
    bpy.ops.adaptive_terrain.water_surface()
    bpy.ops.adaptive_terrain.add_collider()
    session.update_object(terrain, mode=RENDER)
    made = [scatter, *(child for child in terrain.children if child != scatter)]
    before = [vertices_of(obj) for obj in made]
    assert len(made) == 3 and min(map(len, before)) > 10
    set_anchor(terrain, 256.0, 128.0)
    bpy.context.view_layer.update()
    session.update_object(terrain, mode=RENDER)
    for _ in range(2):  # as they are, and made again in the terrain's new space
        for obj, points in zip(made, before, strict=True):
            assert len(points) == len(vertices_of(obj)) and np.abs(points - vertices_of(obj)).max() < 2e-2
        bpy.context.view_layer.objects.active = terrain
        bpy.ops.adaptive_terrain.water_surface()
        bpy.ops.adaptive_terrain.add_collider()


def test_shaped_land_decals_and_maps_follow_the_anchor(scene, terrain, tmp_path):
    """The preview of a stack with a mask by an object, a map with a decal, and the mesh that shows both."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    entry = add("relief")
    patch = new_object("Patch", [(0, 0, 5), (400, 0, 9), (400, 320, 0), (0, 320, 0)])
    entry.mask.kind, entry.mask.object = "OBJECT", patch

    def shown():
        session.update_object(terrain)
        mask = np.load(stack_now(terrain, tmp_path).entries[0].mask.image)
        *_, request = visit_for_request(terrain, scene, ["slope"])
        return vertices_of(terrain), mask, request.placement

    before = shown()
    set_anchor(terrain, 128.0, -64.0)
    bpy.context.view_layer.update()
    after = shown()
    assert np.array_equal(before[1], after[1])
    assert len(before[0]) == len(after[0]) and np.abs(before[0] - after[0]).max() < 1e-2
    assert np.abs(before[2] - after[2]).max() < 1e-3, "maps belong to the raster"


def test_an_animated_rotation_keeps_its_origin(scene, add_terrain):
    terrain = add_terrain()
    terrain.keyframe_insert("rotation_euler", frame=1)
    with pytest.raises(Exception, match="animated rotation"):
        set_anchor(terrain, 256.0, 0.0)
    assert list(terrain.adaptive_terrain.anchor) == [0.0, 0.0]


def test_constrained_and_driven_cameras_move_once(scene, add_terrain):
    target = bpy.data.objects.new("Target", None)
    scene.collection.objects.link(target)
    target.location = (400_000.0, 90_000.0, 50.0)
    follower = bpy.data.objects.new("Follower", None)
    scene.collection.objects.link(follower)
    follower.constraints.new("COPY_LOCATION").target = target
    tracker = bpy.data.objects.new("Tracker", None)
    scene.collection.objects.link(tracker)
    tracker.location = (400_100.0, 90_000.0, 50.0)
    tracker.constraints.new("TRACK_TO").target = target
    scene.camera.location = (400_000.0, 90_000.0, 50.0)
    bpy.context.view_layer.update()
    bpy.ops.adaptive_terrain.move_world()
    places = [obj.matrix_world.translation for obj in (target, follower, tracker, scene.camera)]
    by = [round(at / 1024) * 1024 for at in (400_000, 90_000)]
    for place, x in zip(places, (400_000, 400_000, 400_100, 400_000), strict=True):
        assert (place - Vector((x - by[0], 90_000 - by[1], 50.0))).length < 1e-3


def test_stores_of_one_scene_keep_their_files(scene, add_terrain, country):
    """Anchors change no file of a store."""
    terrain = add_terrain()
    terrain.adaptive_terrain.store = country
    files = {path: path.read_bytes() for path in Path(country).rglob("*.json")}
    look_far(scene, terrain)
    bpy.ops.adaptive_terrain.move_world()
    session.update_object(terrain, mode=RENDER)
    assert {path: path.read_bytes() for path in files} == files and open_store(country).lattice.anchor_x == 0.0
