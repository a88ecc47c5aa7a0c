# SPDX-License-Identifier: GPL-3.0-or-later
"""Updates from properties to mesh; a failure keeps the last good mesh and shows a message."""

import threading
import time
from types import SimpleNamespace
from unittest.mock import Mock

import bpy
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.accuracy.panel import statistics_lines
from adaptive_terrain.operators.export.bake_terrain import BakeTerrain
from adaptive_terrain.operators.export.frame_sources import scene_piece
from adaptive_terrain.operators.session import session
from blender_meshes import positions
from demand_trees import new_object


def mesh_bytes(obj):
    return positions(obj).tobytes()


def test_an_update_writes_a_mesh_that_keeps_its_bound(scene, add_terrain):
    terrain = add_terrain()
    update = session.update_object(terrain)
    assert len(terrain.data.polygons) == update.triangles > 500
    assert 0.5 < update.bound_px <= 1.0
    assert terrain.data.validate(verbose=True) is False
    status = session.record_of(terrain).status
    assert (status.mode, status.leaves, status.triangles) == ("VIEWPORT", update.leaves, update.triangles)
    assert status.ms and status.error == ""


def test_render_and_viewport_have_settings_of_their_own(scene, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.viewport.error_px = 8.0
    viewport = session.update_object(terrain)
    assert session.update_object(terrain, mode="RENDER").triangles > 2 * viewport.triangles
    assert session.update_object(terrain).triangles == viewport.triangles == len(terrain.data.polygons)


def test_another_interpolation_is_another_mesh(scene, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.viewport.error_px = 0.5
    flat = session.update_object(terrain).triangles, mesh_bytes(terrain)
    terrain.adaptive_terrain.interpolation = "bicubic"
    smooth = session.update_object(terrain)
    digest = session.record_of(terrain).status.digest
    assert smooth.triangles > flat[0] and smooth.bound_px <= 0.5
    assert session.update_object(terrain).changed is False, "its errors are computed once"
    terrain.adaptive_terrain.interpolation = "bilinear"
    session.update_object(terrain)
    assert mesh_bytes(terrain) == flat[1] and session.record_of(terrain).status.digest != digest


def test_an_unknown_interpolation_is_named(scene, add_terrain):
    terrain = add_terrain("Hills")
    terrain.adaptive_terrain["interpolation"] = 9
    with pytest.raises(TerrainError, match="'Hills' has an unknown interpolation: choose one on its panel"):
        session.update_object(terrain)


def test_a_criterion_in_metres_needs_no_camera(scene, add_terrain):
    terrain = add_terrain()
    scene.camera = None
    terrain.adaptive_terrain.viewport.error_px = 0.0
    terrain.adaptive_terrain.viewport.error_m = 2.0
    update = session.update_object(terrain)
    assert update.bound_m <= 2.0 and update.bound_px is None


def test_settings_that_are_animated_are_the_evaluated_ones(scene, add_terrain):
    terrain = add_terrain()
    settings = terrain.adaptive_terrain.viewport
    for frame, error in ((1, 1.0), (11, 20.0)):
        settings.error_px = error
        settings.keyframe_insert("error_px", frame=frame)
    scene.frame_set(1)
    fine = session.update_object(terrain).triangles
    scene.frame_set(11)
    assert session.update_object(terrain).triangles < fine / 3


def test_a_mesh_changed_by_hand_is_written_again(scene, add_terrain):
    terrain = add_terrain()
    session.update_object(terrain)
    before = mesh_bytes(terrain)
    terrain.data.clear_geometry()
    session.update_object(terrain)
    assert mesh_bytes(terrain) == before


def test_an_update_of_the_same_view_leaves_the_mesh_alone(scene, add_terrain):
    """A vertex that the session does not compare keeps the position that a script sets."""
    terrain = add_terrain()
    session.update_object(terrain)
    terrain.data.vertices[1].co.z = 12345.0
    assert session.update_object(terrain).changed is False
    assert terrain.data.vertices[1].co.z == 12345.0


def test_a_failure_keeps_the_mesh_and_leaves_a_message(scene, add_terrain):
    terrain = add_terrain()
    session.update_object(terrain)
    before = mesh_bytes(terrain)
    terrain.adaptive_terrain.store = "/nowhere/at/all"
    with pytest.raises(TerrainError, match="no terrain store"):
        session.update_object(terrain)
    assert mesh_bytes(terrain) == before
    assert "/nowhere/at/all" in session.record_of(terrain).status.error


def test_an_unexpected_failure_is_told_too(scene, add_terrain, monkeypatch):
    terrain = add_terrain()
    session.update_object(terrain)
    before = mesh_bytes(terrain)
    terrain.adaptive_terrain.viewport.error_px = 4.0
    monkeypatch.setattr(session, "solve", lambda record, request: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        session.update_object(terrain)
    assert mesh_bytes(terrain) == before
    assert "ZeroDivisionError" in session.record_of(terrain).status.error


def test_a_linked_duplicate_gets_a_mesh_of_its_own(scene, add_terrain):
    terrain = add_terrain()
    other = terrain.copy()
    scene.collection.objects.link(other)
    other.location.y = 5000.0
    session.update_object(terrain)
    session.update_object(other)
    assert other.data != terrain.data
    assert len(other.data.polygons) < len(terrain.data.polygons)


@pytest.mark.parametrize("first", ["linked", "own"])
def test_a_terrain_is_found_beside_a_linked_one_of_its_name(scene, add_terrain, tmp_path, first):
    """Otherwise neither the viewport nor a render would refine it."""
    terrain, path = add_terrain("Hills"), str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {terrain})
    with bpy.data.libraries.load(path, link=True) as (_there, here):
        here.objects = ["Hills"]
    [linked] = here.objects
    if first == "linked":
        scene.collection.objects.unlink(terrain)
    scene.collection.objects.link(linked)
    if first == "linked":
        scene.collection.objects.link(terrain)
    assert linked.name == terrain.name and {linked, terrain} <= set(scene.objects)
    assert session.terrains_of(scene) == [terrain]
    assert session.terrains_of(bpy.data.scenes.new("Other")) == []


def test_an_ordinary_object_keeps_the_mesh_that_it_shares(scene, add_terrain):
    terrain = add_terrain()
    shared = terrain.data
    other = bpy.data.objects.new("Other", shared)
    scene.collection.objects.link(other)
    session.update_object(terrain)
    assert other.data == shared != terrain.data
    assert len(shared.polygons) == 0 < len(terrain.data.polygons)


def test_a_clean_up_that_is_no_number_is_refused(scene, add_terrain):
    terrain = add_terrain()
    session.update_object(terrain)
    before, cleanup = mesh_bytes(terrain), terrain.adaptive_terrain.cleanup
    cleanup.use_below, cleanup.below = True, float("nan")
    with pytest.raises(TerrainError, match="nan as the height of Delete Below"):
        session.update_object(terrain)
    cleanup.use_below = False
    cleanup.boundary = new_object("Torn", [(float("nan"), 0, 0), (9, 0, 0), (0, 9, 0)])
    with pytest.raises(TerrainError, match="boundary 'Torn' has a vertex or a matrix that is not finite"):
        session.update_object(terrain)
    cleanup.boundary = bpy.data.objects.new("Void", None)
    with pytest.raises(TerrainError, match="boundary 'Void' is of type EMPTY"):
        session.update_object(terrain)
    cleanup.boundary = terrain
    with pytest.raises(TerrainError, match="is its own boundary: choose another object"):
        session.update_object(terrain)
    assert mesh_bytes(terrain) == before


def test_clean_up_follows_the_settings(scene, add_terrain):
    terrain = add_terrain()
    session.update_object(terrain)
    whole = len(terrain.data.polygons)
    terrain.adaptive_terrain.cleanup.use_below = True
    terrain.adaptive_terrain.cleanup.below = 10.0
    session.update_object(terrain)
    assert 0 < len(terrain.data.polygons) < whole
    assert terrain.data.validate(verbose=True) is False
    status = session.record_of(terrain).status
    assert (status.triangles, status.triangles_left) == (whole, len(terrain.data.polygons))
    assert dict(statistics_lines(status))["Left by clean-up"] == f"{status.triangles_left:,}"
    piece = scene_piece(terrain, bpy.context.evaluated_depsgraph_get(), 1)
    assert piece.info["triangles"] == len(piece.surface.triangles) == len(terrain.data.polygons)
    assert piece.info["vertices"] == len(piece.surface.positions)
    terrain.adaptive_terrain.cleanup.use_below = False
    session.update_object(terrain)
    assert len(terrain.data.polygons) == whole


def test_bake_makes_an_ordinary_object(scene, add_terrain):
    terrain = add_terrain()
    terrain.location = (7.0, 8.0, 9.0)
    rock = bpy.data.materials.new("Rock")
    terrain.data.materials.append(rock)
    terrain.adaptive_terrain.bake_error_m = 3.0
    session.update_object(terrain)
    before = mesh_bytes(terrain)
    assert bpy.ops.adaptive_terrain.bake() == {"FINISHED"}
    [baked] = [obj for obj in scene.objects if obj.type == "MESH" and obj != terrain]
    assert not baked.adaptive_terrain.enabled
    assert baked.matrix_world.translation[:] == (7.0, 8.0, 9.0)
    assert [material.name for material in baked.data.materials] == ["Rock"]
    assert len(baked.data.polygons) > 100
    assert mesh_bytes(terrain) == before


def test_a_bake_is_shown_instead_of_its_terrain(scene, add_terrain):
    """Both surfaces in one place flicker."""
    terrain = add_terrain()
    bpy.ops.adaptive_terrain.bake()
    baked = bpy.context.view_layer.objects.active
    assert baked.name == f"{terrain.name} baked" and bpy.context.selected_objects == [baked]
    assert (terrain.visible_get(), terrain.hide_render) == (False, True)
    assert (baked.visible_get(), baked.hide_render) == (True, False)
    bpy.context.view_layer.objects.active = terrain
    terrain.adaptive_terrain.bake_error_m *= 2
    assert bpy.ops.adaptive_terrain.bake() == {"FINISHED"}, "a hidden terrain is baked again"
    assert 0 < len(bpy.context.object.data.polygons) < len(baked.data.polygons)


def test_a_bake_says_what_held_it_back(scene, add_terrain):
    terrain, operator = add_terrain(), SimpleNamespace(report=Mock())
    settings = terrain.adaptive_terrain
    settings.bake_error_m, settings.render.limit_triangles, settings.render.max_triangles = 0.5, True, 500
    settings.cleanup.use_below, settings.cleanup.below = True, 0.0
    assert BakeTerrain.execute(operator, bpy.context) == {"FINISHED"}
    [baked] = [obj for obj in scene.objects if obj.type == "MESH" and obj != terrain]
    kind, message = operator.report.call_args.args
    where = f"{baked.name}, in the place of {terrain.name}, which is hidden now: "
    assert kind == {"WARNING"} and message.startswith(f"{where}{len(baked.data.polygons):,} triangles, at most ")
    assert message.endswith("held back by the triangle limit")
    assert min(vertex.co.z for vertex in baked.data.vertices) == 0.0


def test_a_fitted_bake_has_fewer_triangles(scene, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.bake_error_m = 3.0
    counts = []
    for terrain.adaptive_terrain.bake_fit in (False, True):
        assert bpy.ops.adaptive_terrain.bake() == {"FINISHED"}
        [baked] = [obj for obj in scene.objects if obj.type == "MESH" and obj != terrain]
        counts.append(len(baked.data.polygons))
        bpy.data.objects.remove(baked)
        bpy.context.view_layer.objects.active = terrain
    assert 100 < counts[1] < 0.9 * counts[0]


def test_the_update_operator_reports(scene, add_terrain):
    terrain = add_terrain()
    assert bpy.ops.adaptive_terrain.update() == {"FINISHED"}
    assert len(terrain.data.polygons) > 100
    scene.camera = None
    with pytest.raises(RuntimeError, match="has no camera"):
        bpy.ops.adaptive_terrain.update()


def test_a_render_waits_for_kernels_that_are_being_prepared(scene, add_terrain, preparing):
    terrain = add_terrain()
    start = time.perf_counter()
    threading.Timer(0.3, preparing.done.set).start()
    session.update_object(terrain, mode="RENDER")
    assert time.perf_counter() - start >= 0.3
    assert len(terrain.data.polygons) > 100


def test_without_a_window_kernels_are_loaded_on_demand(empty):
    import adaptive_terrain
    from adaptive_terrain.cbt_terrain.run import warmup

    adaptive_terrain.unregister()
    adaptive_terrain.register()
    assert bpy.app.background and not warmup.preparing() and warmup.progress() is None


def test_an_error_of_the_criterion_names_the_terrain(scene, add_terrain):
    terrain = add_terrain("Hills")
    terrain.adaptive_terrain.viewport.error_px = 0.0
    with pytest.raises(TerrainError, match="'Hills' cannot be refined. Every criterion is 0: ask for"):
        session.update_object(terrain)
