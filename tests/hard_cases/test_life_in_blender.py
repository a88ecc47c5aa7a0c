# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases of a terrain's life in a Blender file: 35, 36 and 47."""

import random

import pytest

bpy = pytest.importorskip("bpy")

from adaptive_terrain.cbt_terrain.errors import TerrainError  # noqa: E402
from adaptive_terrain.operators.session import session  # noqa: E402
from blender_meshes import digest, digest_alone  # noqa: E402


def test_case_35_frames_in_random_order_give_the_same_meshes(flight, add_terrain):
    """Ten frames of a camera on an animated parent have the same meshes in random order as in sequence."""
    terrain = add_terrain()
    played = {}
    for frame in range(1, 21, 2):
        flight.frame_set(frame)
        played[frame] = digest(terrain)
    assert len(set(played.values())) == 10
    order = list(played)
    random.Random(4).shuffle(order)
    for frame in order:
        flight.frame_set(frame)
        assert digest(terrain) == played[frame]


def test_case_35_subframes(flight, add_terrain):
    """A subframe has a different mesh, and returning to the frame restores its mesh."""
    terrain = add_terrain()
    flight.frame_set(5)
    whole = digest(terrain)
    flight.frame_set(5, subframe=0.5)
    assert digest(terrain) != whole
    flight.frame_set(5)
    assert digest(terrain) == whole


def test_case_36_motion_blur_keeps_one_topology(flight, add_terrain, tmp_path):
    """A Cycles render with motion blur keeps one mesh for all shutter times of a frame, and another for the next."""
    terrain = add_terrain()
    flight.frame_start, flight.frame_end = 5, 6
    flight.render.engine = "CYCLES"
    flight.cycles.samples, flight.cycles.device = 1, "CPU"
    flight.cycles.use_denoising = False
    flight.render.resolution_percentage = 25
    flight.render.use_motion_blur, flight.render.motion_blur_shutter = True, 1.0
    flight.render.motion_blur_position = "START"  # the shutter closes on the next whole frame
    flight.render.filepath = str(tmp_path / "frame_")
    seen, current = {}, []

    def on_pre(scene, _unused):
        current[:] = [scene.frame_current]

    def on_change(scene, depsgraph):
        if depsgraph.mode == "RENDER":
            seen.setdefault(current[0], set()).add((scene.frame_current, scene.frame_subframe, digest(terrain)))

    bpy.app.handlers.render_pre.append(on_pre)
    bpy.app.handlers.frame_change_post.append(on_change)
    try:
        bpy.ops.render.render(animation=True)
    finally:
        bpy.app.handlers.render_pre.remove(on_pre)
        bpy.app.handlers.frame_change_post.remove(on_change)
    for frame in (5, 6):
        assert (frame + 1, 0.0) in {(whole, subframe) for whole, subframe, _ in seen[frame]}
        assert len({mesh for _, _, mesh in seen[frame]}) == 1
    assert {mesh for _, _, mesh in seen[5]} != {mesh for _, _, mesh in seen[6]}


def test_case_47_undo_and_redo(scene, add_terrain):
    """Undo and redo restore settings and mesh, and an update after each gives the same mesh."""
    name = add_terrain().name
    bpy.ops.ed.undo_push(message="start")
    detail = bpy.data.objects[name].adaptive_terrain.viewport
    session.update_object(bpy.data.objects[name])
    fine = digest(bpy.data.objects[name])
    bpy.ops.ed.undo_push(message="fine")
    detail.error_px = 10.0
    session.update_object(bpy.data.objects[name])
    coarse = digest(bpy.data.objects[name])
    bpy.ops.ed.undo_push(message="coarse")
    assert coarse != fine
    bpy.ops.ed.undo()
    terrain = bpy.data.objects[name]
    assert terrain.adaptive_terrain.viewport.error_px == 1.0 and digest(terrain) == fine
    session.update_object(terrain)
    assert digest(terrain) == fine
    bpy.ops.ed.redo()
    terrain = bpy.data.objects[name]
    assert terrain.adaptive_terrain.viewport.error_px == 10.0 and digest(terrain) == coarse
    bpy.ops.ed.undo()
    bpy.ops.ed.undo()
    terrain = bpy.data.objects[name]
    assert len(terrain.data.polygons) == 0
    session.update_object(terrain)
    assert digest(terrain) == fine


def test_case_47_save_and_reload(scene, add_terrain, tmp_path):
    """A saved and reloaded file keeps settings and mesh, and an update changes nothing."""
    terrain = add_terrain()
    settings = terrain.adaptive_terrain
    settings.viewport.error_px, settings.render.meshlet, settings.vertical_scale = 3.0, 2, 1.5
    settings.camera_source, settings.camera = "CHOSEN", scene.camera
    settings.cleanup.use_below, settings.cleanup.below = True, -20.0
    session.update_object(terrain)
    before = digest_alone(terrain)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "terrain.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "terrain.blend"))
    terrain = bpy.data.objects["Terrain"]
    settings = terrain.adaptive_terrain
    assert (settings.viewport.error_px, settings.render.meshlet, settings.vertical_scale) == (3.0, 2, 1.5)
    assert settings.camera == bpy.data.objects["Camera"] and settings.cleanup.below == -20.0
    assert digest_alone(terrain) == before
    session.update_object(terrain)
    assert digest_alone(terrain) == before


def test_case_47_append_and_link(scene, add_terrain, tmp_path):
    """An appended terrain updates; a linked one does not change."""
    add_terrain().adaptive_terrain.viewport.error_px = 7.0
    path = str(tmp_path / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    for link in (False, True):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        with bpy.data.libraries.load(path, link=link) as (_there, here):
            here.objects = ["Terrain", "Camera"]
        for obj in here.objects:
            bpy.context.scene.collection.objects.link(obj)
        terrain, bpy.context.scene.camera = here.objects
        assert terrain.adaptive_terrain.viewport.error_px == 7.0
        bpy.context.scene.frame_set(2)
        assert session.is_terrain(terrain) is not link
        assert (len(terrain.data.polygons) > 0) is not link, "linked objects do not change"


def test_case_47_library_override_is_left_alone(scene, add_terrain, tmp_path):
    """A library override keeps its mesh after its settings change."""
    session.update_object(add_terrain())
    path = str(tmp_path / "library.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_there, here):
        here.objects = ["Terrain", "Camera"]
    terrain, camera = here.objects
    mesh = terrain.data
    bpy.context.scene.collection.objects.link(camera)
    override = terrain.override_create(remap_local_usages=True)
    bpy.context.scene.collection.objects.link(override)
    assert override.library is None and not session.is_terrain(override)
    override.data = mesh.override_create()
    assert override.data.library is None and not session.is_terrain(override)
    bpy.context.scene.camera = camera
    before = digest_alone(override)
    override.adaptive_terrain.viewport.error_px = 9.0
    bpy.context.scene.frame_set(2)
    assert digest_alone(override) == before


def test_case_47_duplicate_and_delete(flight, add_terrain):
    """A copy refines for its location; deleted terrains leave no record, and the frame handler still works."""
    terrain = add_terrain()
    flight.frame_set(2)
    other = terrain.copy()
    other.data = terrain.data.copy()
    flight.collection.objects.link(other)
    other.location.y = 300.0
    flight.frame_set(3)
    assert digest(other) != digest(terrain)
    bpy.data.objects.remove(terrain)
    flight.frame_set(4)
    assert session.all_terrains() == [other]
    bpy.data.objects.remove(other)
    flight.frame_set(5)
    assert session.all_terrains() == [] and session._records == {}


def test_case_47_two_terrains(flight, add_terrain):
    """Two terrains have separate engines, and deleting one does not change the other's mesh."""
    near, far = add_terrain("Near"), add_terrain("Far")
    far.location.y = 4000.0
    flight.frame_set(2)
    assert len(near.data.polygons) > len(far.data.polygons) > 0
    assert session.record_of(near).terrain is not session.record_of(far).terrain
    alone = digest(near)
    bpy.data.objects.remove(far)
    flight.frame_set(3)
    flight.frame_set(2)
    assert digest(near) == alone


def test_case_47_edit_mode_is_left_alone(scene, add_terrain):
    """A terrain in edit mode is refused with a message, and updates again afterwards."""
    terrain = add_terrain()
    session.update_object(terrain)
    bpy.ops.object.mode_set(mode="EDIT")
    terrain.adaptive_terrain.viewport.error_px = 9.0
    with pytest.raises(TerrainError, match="edit mode"):
        session.update_object(terrain)
    bpy.ops.object.mode_set(mode="OBJECT")
    session.update_object(terrain)
