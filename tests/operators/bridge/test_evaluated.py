# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that a setting names, hidden from Blender's evaluation: where they are, or an error, never another place."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.bridge.evaluated import evaluated_or_still
from adaptive_terrain.operators.land import masks as land_masks
from adaptive_terrain.operators.layers.decals import decal_parameters
from adaptive_terrain.operators.session import session
from adaptive_terrain.operators.terrain import request

HIDDEN = ("hide_viewport", "excluded")


@pytest.fixture
def patch(scene):
    """Add a square of 200 m north-east of the middle, in a separate collection."""
    mesh = bpy.data.meshes.new("Patch")
    mesh.from_pydata([(-100, -100, 5), (100, -100, 5), (100, 100, 5), (-100, 100, 5)], [], [(0, 1, 2, 3)])
    patch = bpy.data.objects.new("Patch", mesh)
    helpers = bpy.data.collections.new("Helpers")
    helpers.objects.link(patch)
    scene.collection.children.link(helpers)
    patch.location, patch.rotation_euler = (300.0, 150.0, 0.0), (0.0, 0.0, 0.4)
    return patch


def depsgraph():
    return bpy.context.evaluated_depsgraph_get()


def hide(obj, how: str, is_hidden: bool = True) -> None:
    if how == "hide_viewport":
        obj.hide_viewport = is_hidden
    else:
        bpy.context.view_layer.layer_collection.children["Helpers"].exclude = is_hidden


@pytest.mark.parametrize("how", HIDDEN)
def test_what_is_hidden_is_at_its_place_also_after_loading(patch, tmp_path, how):
    """After loading, Blender has no place of it at all; moved by a script, an old one; a parent may be shown."""
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.location, parent.scale = (20.0, 0.0, 0.0), (1.0, 0.5, 1.0)
    patch.parent = parent
    expected = np.array(evaluated_or_still(depsgraph(), patch, "mask")[1])
    assert expected[:3, 3] == pytest.approx((320.0, 75.0, 0.0))
    hide(patch, how)
    assert np.array(evaluated_or_still(depsgraph(), patch, "mask")[1]) == pytest.approx(expected, abs=1e-5)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "hidden.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "hidden.blend"))
    found, matrix = evaluated_or_still(depsgraph(), bpy.data.objects["Patch"], "mask")
    assert np.array(matrix) == pytest.approx(expected, abs=1e-5) and len(found.data.vertices) == 4


@pytest.mark.parametrize("how", HIDDEN)
def test_masks_and_boundaries_do_not_care_who_sees_them(patch, terrain, tmp_path, how):
    def taken():
        evaluated = terrain.evaluated_get(depsgraph())
        boundary = request.cleanup_from(settings, evaluated, depsgraph()).boundary
        return boundary, np.load(land_masks.write_shadow_mask(patch, evaluated, (1280.0, 640.0), depsgraph(), tmp_path))

    settings = terrain.adaptive_terrain.cleanup
    settings.boundary = patch
    depsgraph()
    hide(patch, how)
    patch.location.x -= 50.0
    boundary, mask = taken()
    hide(patch, how, False)
    shown, shadow = taken()
    assert boundary == pytest.approx(shown, abs=1e-3) and abs(mask - shadow).mean() < 1e-4
    assert shown[..., 0].mean() == pytest.approx(250.0)


@pytest.mark.parametrize("how", HIDDEN)
def test_a_decal_that_is_not_evaluated_lies_where_it_was_put(scene, terrain, how):
    """Moved by a script while Blender does not evaluate it, it is not taken from its old place."""
    decal = bpy.data.objects.new("Decal", None)
    decal.empty_display_type, decal.empty_display_size, decal.parent = "IMAGE", 40.0, terrain
    decal.data = bpy.data.images.new("Sign", 8, 4)
    helpers = bpy.data.collections.new("Helpers")
    helpers.objects.link(decal)
    scene.collection.children.link(helpers)
    depsgraph()
    hide(decal, how)
    decal.location = (300.0, 150.0, 9.0)
    placement = np.array(terrain.evaluated_get(depsgraph()).matrix_world)
    [given] = decal_parameters(terrain, placement, depsgraph(), tilts=False)["decals"]
    assert given.corner == pytest.approx((280.0, 140.0)), "half of 40 x 20 m from its middle"
    decal.hide_render = True
    assert decal_parameters(terrain, placement, depsgraph(), tilts=False) == {}
    decal.hide_render = False
    key(decal)
    with pytest.raises(session.TerrainError, match="decal 'Decal' is hidden in viewports.*show it, or apply them"):
        decal_parameters(terrain, placement, depsgraph(), tilts=False)


def key(obj):
    obj.keyframe_insert("location", frame=1)


def with_modifier(obj):
    obj.modifiers.new("Array", "ARRAY")


def with_constraint(obj):
    obj.constraints.new("COPY_LOCATION")


def with_shape(obj):
    obj.shape_key_add(name="Basis")


def with_moving_parent(obj):
    obj.parent = bpy.data.objects.new("Parent", None)
    key(obj.parent)


@pytest.mark.parametrize("changed", [key, with_modifier, with_constraint, with_shape, with_moving_parent])
def test_what_is_hidden_and_may_have_changed_is_told_of(patch, terrain, changed):
    changed(patch)
    terrain.adaptive_terrain.cleanup.boundary = patch
    session.update_object(terrain)
    hide(patch, "excluded")
    with pytest.raises(session.TerrainError, match="boundary 'Patch' is hidden in viewports.*show it, or apply them"):
        session.update_object(terrain)


def test_a_render_does_not_take_the_place_of_another_frame(scene, patch, terrain, tmp_path):
    """What is hidden in renders is there as the viewport's frame has left it."""
    seen = []

    def look(scene, graph):
        if graph.mode == "RENDER":
            try:
                seen.append(evaluated_or_still(graph, patch, "mask")[1].translation.x)
            except session.TerrainError as error:
                seen.append(str(error))

    scene.render.engine, scene.cycles.samples, scene.frame_start, scene.frame_end = "CYCLES", 1, 7, 7
    scene.render.resolution_x = scene.render.resolution_y = 8
    scene.render.filepath = str(tmp_path / "frame_")
    bpy.data.objects.remove(terrain)
    bpy.app.handlers.frame_change_post.append(look)
    try:
        patch.hide_render = True
        bpy.ops.render.render(animation=True)
        for frame, x in ((1, 0.0), (11, 100.0)):
            patch.location.x = x
            patch.keyframe_insert("location", frame=frame)
        bpy.ops.render.render(animation=True)
        patch.hide_render = False
        bpy.ops.render.render(animation=True)
    finally:
        bpy.app.handlers.frame_change_post.remove(look)
    still, moving, shown = seen
    assert still == pytest.approx(300.0) and "hidden in renders" in moving and 50.0 < shown < 70.0


def test_a_chosen_camera_that_is_hidden_is_where_it_is(scene, terrain, tmp_path):
    data = bpy.data.cameras.new("Own")
    camera = bpy.data.objects.new("Own", data)
    helpers = bpy.data.collections.new("Helpers")
    helpers.objects.link(camera)
    scene.collection.children.link(helpers)
    camera.location = (0.0, -900.0, 400.0)
    camera.rotation_euler = (1.1, 0.0, 0.0)
    terrain.adaptive_terrain.camera_source, terrain.adaptive_terrain.camera = "CHOSEN", camera
    request.gather(terrain, depsgraph())
    hide(camera, "excluded")
    camera.location.z += 50.0
    [hidden] = request.gather(terrain, depsgraph()).views
    key(camera)
    with pytest.raises(session.TerrainError, match="camera 'Own' is hidden in viewports"):
        request.gather(terrain, depsgraph())
    scene.camera = camera  # Blender evaluates the scene's camera, hidden or not
    [view] = request.gather(terrain, depsgraph()).views
    assert hidden.world_to_camera == pytest.approx(view.world_to_camera, abs=1e-4)
    assert np.linalg.inv(view.world_to_camera)[2, 3] == pytest.approx(450.0)
