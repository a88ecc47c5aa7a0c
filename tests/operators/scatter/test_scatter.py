# SPDX-License-Identifier: GPL-3.0-or-later
"""Scatters in Blender: objects whose points follow their terrain, and cost nothing while they are hidden."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.scatter.points import scatter_points
from adaptive_terrain.operators.scatter import request as scatters
from adaptive_terrain.operators.scatter.operators import new_scatter
from adaptive_terrain.operators.scatter.properties import scatter_of
from adaptive_terrain.operators.session import live, session
from blender_meshes import positions, values_of
from demand_trees import new_object


def moved(places, matrix):
    matrix = np.array(matrix)
    return places @ matrix[:3, :3].T + matrix[:3, 3]


def record_of(terrain, scatter):
    return session.record_of(terrain).scatters[scatter.session_uid]


@pytest.mark.parametrize("camera", ["shifted", "small", "orthographic", "in a scaled rig"])
def test_unusual_cameras_see_points_that_keep_their_places(scene, terrain, scatter, camera):
    """None loses all its points, and what two cameras see has the same number at the same place."""

    def points() -> dict[int, tuple]:
        bpy.context.view_layer.update()
        session.update_object(terrain)
        return dict(zip(values_of(scatter.data, "id").tolist(), map(tuple, positions(scatter)), strict=True))

    usual, shown = points(), scene.camera
    count = len(usual)
    if camera == "shifted":
        shown.data.shift_y = 0.2
    elif camera == "small":  # as FBX brings cameras
        shown.scale = (0.01, 0.01, 0.01)
    elif camera == "orthographic":
        shown.data.type, shown.data.ortho_scale = "ORTHO", 400.0
    else:
        rig = bpy.data.objects.new("rig", None)
        scene.collection.objects.link(rig)
        rig.scale, shown.parent, shown.location = (100.0, 100.0, 100.0), rig, shown.location / 100.0
    found = points()
    both = usual.keys() & found.keys()
    assert len(both) > 20 and all(usual[number] == found[number] for number in both)
    assert camera not in ("small", "in a scaled rig") or abs(len(found) - count) <= 0.02 * count


def instances(obj):
    """Return the name of the instanced object and the world matrix of each instance."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = []
    for item in depsgraph.object_instances:  # which are gone at the next step
        if item.is_instance and item.parent and item.parent.original == obj:
            found.append((item.object.name, np.array(item.matrix_world)))
    return found


def test_the_operator_adds_points_with_attributes_and_cones(scene, terrain):
    """As many instances as points, at their places, in a terrain that is turned and scaled by parts."""
    terrain.location, terrain.rotation_euler, terrain.scale = (30, 20, 5), (0.1, 0.2, 0.5), (1.2, 0.9, 1.4)
    bpy.context.view_layer.objects.active = terrain
    assert bpy.ops.adaptive_terrain.scatter_add() == {"FINISHED"}
    (obj,) = terrain.children
    settings, in_world = obj.adaptive_scatter, 6.0 * (1.2 * 0.9) ** 0.5
    assert settings.enabled and settings.spacing == pytest.approx(6.0)
    assert settings.full_until == pytest.approx(200 * in_world) and settings.margin_m == pytest.approx(2 * in_world)
    assert len(obj.data.vertices) > 500
    assert np.abs(np.linalg.norm(values_of(obj.data, "rotation"), axis=1) - 1).max() < 1e-6
    sizes, ids = values_of(obj.data, "size"), values_of(obj.data, "id")
    assert 0 <= sizes.min() and sizes.max() <= 1.2 and len(np.unique(ids)) == len(ids)
    assert values_of(obj.data, "normal")[:, 2].min() > 0
    found = instances(obj)
    assert len(found) == len(obj.data.vertices)
    places = np.array([matrix[:3, 3] for _, matrix in found])
    world = np.array(obj.matrix_world)
    assert np.abs(places - (positions(obj) @ world[:3, :3].T + world[:3, 3])).max() < 1e-2


def test_instances_are_picked_by_variant(terrain, scatter):
    collection = bpy.data.collections.new("Trees")
    for name in ("Fir", "Oak", "Pine"):
        collection.objects.link(bpy.data.objects.new(name, bpy.data.meshes.new(name)))
    scatter.adaptive_scatter.collection = collection
    session.update_object(terrain)
    names = [name for name, _ in instances(scatter)]
    expected = np.array(["Fir", "Oak", "Pine"])[values_of(scatter.data, "variant") % 3]
    assert len(names) > 300 and names == expected.tolist()


def test_points_follow_the_camera_in_viewport_and_render(scene, terrain, scatter):
    """A frame change moves the camera; a render of another frame has that frame's points at the render's size."""
    scene.camera.keyframe_insert("location", frame=1)
    scene.camera.location.y = -400.0
    scene.camera.keyframe_insert("location", frame=9)
    kept = {}
    for frame in (1, 9, 1):
        scene.frame_set(frame)
        kept.setdefault(frame, []).append(positions(scatter).tobytes())
    assert kept[1][0] == kept[1][1] != kept[9][0]
    request = session.record_of(terrain).status.request
    heights = session.field_of(request)
    alone = scatter_points(heights, request.scatters.items[0].scatter, request.views)
    assert alone.positions.tobytes() == kept[1][0]


def test_a_hidden_scatter_costs_nothing(scene, terrain, scatter, monkeypatch):
    """No points are made, no views gathered, no kernels requested; shown again it has its points."""
    made = []
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.scatter.points.place_points", lambda *_: made.append(1))
    for hide in (lambda: scatter.hide_set(True), lambda: setattr(scatter, "hide_viewport", True)):
        scatter.hide_set(False)
        scatter.hide_viewport = False
        hide()
        bpy.context.view_layer.update()
        scene.camera.location.x += 50.0
        bpy.context.view_layer.update()
        session.update_object(terrain)
        assert session.record_of(terrain).status.request.scatters.items == ()
    monkeypatch.undo()
    assert made == [] and session.record_of(terrain).scatters == {}
    scatter.hide_viewport = False
    scatter.hide_set(False)
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert record_of(terrain, scatter).runs == 1 and len(scatter.data.vertices) > 300


def test_a_render_has_points_that_the_viewport_hides(scene, terrain, scatter):
    """Of its own camera, in a picture of other proportions; where it hides them none are made."""
    scene.render.engine, scene.cycles.samples = "CYCLES", 1
    scene.render.resolution_x, scene.render.resolution_y = 16, 48
    scatter.hide_viewport = True
    seen = []
    bpy.app.handlers.render_post.append(lambda *_: seen.append(len(scatter.data.vertices)))
    bpy.ops.render.render()
    status = session.record_of(terrain).status
    assert seen[0] > 100 and status.mode == "VIEWPORT" and status.request.scatters.items == ()
    scatter.hide_render = True
    runs = record_of(terrain, scatter).runs
    bpy.ops.render.render()
    assert record_of(terrain, scatter).runs == runs == 1


def test_a_viewport_refuses_more_points_than_a_render(scene, terrain, scatter, monkeypatch):
    monkeypatch.setattr(scatters, "MAX_IN_VIEWPORT", 100)
    with pytest.raises(
        TerrainError, match=r"has [\d,]+ points in view; expected at most 100, the maximum of a viewport"
    ):
        session.update_object(terrain)
    assert len(scatter.data.vertices) == 0
    session.update_object(terrain, mode="RENDER")
    assert len(scatter.data.vertices) > 100
    monkeypatch.setattr(scatters, "physical_memory", lambda: 4 * scatters.POINT_BYTES * 60 // 3)
    for mode in "VIEWPORT", "RENDER":
        scatter.adaptive_scatter.seed += 1
        with pytest.raises(TerrainError, match="expected at most 60, the maximum of this machine's memory"):
            session.update_object(terrain, mode=mode)


def test_a_renamed_layer_keeps_its_scatters_and_masks(terrain, scatter):
    layers = terrain.adaptive_terrain.layers
    for name in "Rock", "Snow":
        layers.add().name = name
    layers["Snow"].mask = scatter.adaptive_scatter.layer = "Rock"
    layers["Rock"].name = "Basalt"
    assert layers["Snow"].mask == scatter.adaptive_scatter.layer == "Basalt"
    layers.add().name = "Basalt"
    layers[0].name = "Stone"
    assert layers["Snow"].mask == scatter.adaptive_scatter.layer == "Basalt", "there is one of that name still"


def test_unchanged_points_are_not_made_or_written_again(terrain, scatter, monkeypatch):
    session.update_object(terrain)
    monkeypatch.setattr("adaptive_terrain.operators.bridge.point_writer.write_points", None)
    session.update_object(terrain)
    assert record_of(terrain, scatter).runs == 1


def test_several_scatters_of_a_terrain_have_points_of_their_own(terrain, scatter):
    other = new_scatter(terrain, 25.0)
    session.update_object(terrain)
    assert other.adaptive_scatter.seed == 1
    assert 0 < len(other.data.vertices) < len(scatter.data.vertices)
    bpy.data.objects.remove(other)
    session.update_object(terrain)
    assert set(session.record_of(terrain).scatters) == {scatter.session_uid}


def test_roots_may_touch_the_mesh(terrain, scatter):
    """On the mesh of 20 pixels of error points are where its triangles are, found by a ray, and elsewhere not."""
    terrain.adaptive_terrain.viewport.error_px = 20.0
    off = {}
    for roots in ("SURFACE", "MESH"):
        scatter.adaptive_scatter.roots = roots
        bpy.context.view_layer.update()
        session.update_object(terrain)
        found = []
        for x, y, z in positions(scatter)[::20].tolist():
            hit, place, _, _ = terrain.ray_cast((x, y, 1000.0), (0, 0, -1))
            if hit:
                found.append(abs(place.z - z))
        off[roots] = max(found)
    assert off["MESH"] < 1e-3 < 0.5 < off["SURFACE"]


def test_no_point_is_where_the_ground_is_cut_away(terrain, scatter):
    cleanup = terrain.adaptive_terrain.cleanup
    cleanup.use_below, cleanup.below = True, 3.0
    session.update_object(terrain)
    assert len(scatter.data.vertices) > 100 and positions(scatter)[:, 2].min() >= 3.0


@pytest.mark.parametrize("rises", [False, True], ids=["convex", "with a bay"])
def test_no_point_is_outside_of_the_boundary(terrain, scatter, rises):
    """A polygon that is turned, of a terrain that is turned too: points are those of before that the polygon holds. A
    boundary that moves takes them along; without one they are all there again. Each has the mesh below or above."""
    session.update_object(terrain)
    whole = values_of(scatter.data, "id").tolist()
    corners = [(-300.0, -200.0), (250.0, -250.0), (280.0, 200.0), (0.0, 60.0 if rises else 300.0), (-250.0, 220.0)]
    boundary = new_object("Plan", [(*corner, 0.0) for corner in corners])
    terrain.location.x, terrain.rotation_euler.z, boundary.rotation_euler.z = 20.0, 0.4, 0.9
    cleanup, seen = terrain.adaptive_terrain.cleanup, {}
    terrain.adaptive_terrain.viewport.error_px = 0.5
    for boundary.location.y in (0.0, 40.0):
        bpy.context.view_layer.update()
        cleanup.boundary = None
        session.update_object(terrain)
        x, y, _ = moved(positions(scatter), boundary.matrix_world.inverted() @ terrain.matrix_world).T
        inside = np.zeros(len(x), bool)  # by how many edges a ray to the east crosses
        for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
            inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) * (bx - ax) / (by - ay))
        expected = values_of(scatter.data, "id")[inside]
        cleanup.boundary = boundary
        session.update_object(terrain)
        seen[boundary.location.y] = values_of(scatter.data, "id").tolist()
        assert seen[boundary.location.y] == expected.tolist() and 100 < len(expected) < 0.8 * len(inside)
        hit = [terrain.ray_cast((*place[:2], 1000.0), (0, 0, -1))[0] for place in positions(scatter)[::9].tolist()]
        assert np.mean(hit) > (0.98 if rises else 0.999)
    assert seen[0.0] != seen[40.0]
    terrain.location.x = terrain.rotation_euler.z = 0.0
    cleanup.boundary = None
    bpy.context.view_layer.update()
    session.update_object(terrain)
    assert values_of(scatter.data, "id").tolist() == whole


def test_the_least_spacing_of_the_panel_is_one(scatter):
    settings = scatter.adaptive_scatter
    settings.spacing = 0.0
    assert scatter_of(settings, None).spacing == pytest.approx(1e-3)


def test_a_scatter_that_cannot_be_is_named(terrain, scatter):
    session.update_object(terrain)
    before = positions(scatter).tobytes()
    scatter.adaptive_scatter.layer = "Moss"
    bpy.context.view_layer.update()
    with pytest.raises(TerrainError, match="The scatter 'Terrain Scatter' cannot be made. .* layer 'Moss'"):
        session.update_object(terrain)
    scatter.adaptive_scatter.layer, scatter.adaptive_scatter.spacing = "", 0.001
    bpy.context.view_layer.update()
    with pytest.raises(TerrainError, match="'Terrain Scatter' cannot be made. The scatter has more than"):
        session.update_object(terrain)
    assert positions(scatter).tobytes() == before


def test_layers_and_rules_of_the_panel_decide_where(terrain, scatter):
    session.update_object(terrain)
    everywhere = len(scatter.data.vertices)
    layers = terrain.adaptive_terrain.layers
    layers.add().name = "Grass"
    rock = layers.add()
    rock.name, rock.slope.use, rock.slope.low = "Rock", True, 0.3
    counts = []
    for layer in ("Grass", "Rock"):
        scatter.adaptive_scatter.layer = layer
        bpy.context.view_layer.update()
        session.update_object(terrain)
        counts.append(len(scatter.data.vertices))
    assert sum(counts) == pytest.approx(everywhere, rel=0.1) and min(counts) > 0.1 * everywhere
    scatter.adaptive_scatter.layer = ""
    where = scatter.adaptive_scatter.where
    where.ragged, where.height.use, where.height.low, where.height.edge = 0.0, True, 10.0, 2.0
    bpy.context.view_layer.update()
    session.update_object(terrain)
    # Rules read a smooth surface, which is a little off that of the samples.
    assert np.quantile(positions(scatter)[:, 2], 0.01) > 9.0 and 0 < len(scatter.data.vertices) < everywhere


def test_live_updates_write_points_too(terrain, scatter):
    """The worker makes them; writing waits for the main thread."""
    request = session.gather(terrain, bpy.context.evaluated_depsgraph_get())
    record = session.record_of(terrain)
    update, _, _ = live._solve_on_worker(record, request)
    assert len(scatter.data.vertices) == 0
    session.show(terrain, record, request, update, session.VIEWPORT)
    assert len(scatter.data.vertices) > 300
    assert set(record_of(terrain, scatter).ms) == {"points", "mesh"}


def test_what_the_terrain_hides_may_be_culled(scene, terrain, scatter):
    """From low behind rising ground; not with roots on the mesh, nor where ground is cut away; off and on again."""
    scene.camera.location, scene.camera.rotation_euler = (0.0, -300.0, 20.0), (1.57, 0.0, 0.0)
    settings, cleanup, found = scatter.adaptive_scatter, terrain.adaptive_terrain.cleanup, {}
    assert not settings.cull_hidden

    def ids():
        bpy.context.view_layer.update()
        session.update_object(terrain)
        return values_of(scatter.data, "id").tolist()

    whole = ids()
    settings.cull_hidden = True
    found = ids()
    assert 0 < len(found) < 0.9 * len(whole) and set(found) < set(whole)
    terrain.adaptive_terrain.viewport.error_px = 60.0  # which hides less
    assert len(ids()) > len(found)
    cleanup.use_below, cleanup.below = True, -1e6
    assert ids() == whole
    cleanup.use_below, settings.roots = False, "MESH"
    assert ids() == whole
