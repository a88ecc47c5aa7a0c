# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame changes and renders rebuild the mesh, once a frame and for the camera of that frame."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators import handlers, jobs
from adaptive_terrain.operators.bridge.camera import active_camera
from adaptive_terrain.operators.session import live, session, stale_renders
from adaptive_terrain.operators.session.shot import frames_of
from adaptive_terrain.operators.ui import status_bar
from blender_meshes import digest_alone
from live_windows import turns


@pytest.fixture
def flight(scene):
    """Animate the camera to the north over frames 1 to 9."""
    for frame, y in ((1, -900.0), (9, -100.0)):
        scene.camera.location.y = y
        scene.camera.keyframe_insert("location", frame=frame)
    scene.frame_set(1)
    return scene


def test_a_frame_change_follows_the_camera(flight, add_terrain):
    terrain = add_terrain()
    flight.frame_set(2)
    first = digest_alone(terrain)
    flight.frame_set(8)
    assert len(terrain.data.polygons) > 100 and digest_alone(terrain) != first
    flight.frame_set(2)
    assert digest_alone(terrain) == first
    assert session.record_of(terrain).status.bounds.bound_px <= 1.0


def test_a_terrain_that_is_not_live_waits(flight, add_terrain):
    terrain = add_terrain()
    terrain.adaptive_terrain.live = False
    flight.frame_set(5)
    assert len(terrain.data.polygons) == 0


def test_markers_that_bind_cameras_are_followed(flight, add_terrain):
    terrain = add_terrain()
    other = bpy.data.objects.new("Far", bpy.data.cameras.new("Far"))
    other.location, other.rotation_euler = (0.0, -9000.0, 4000.0), (1.15, 0.0, 0.0)
    other.data.clip_end = 1e5
    flight.collection.objects.link(other)
    flight.timeline_markers.new("near", frame=1).camera = flight.camera
    flight.timeline_markers.new("far", frame=5).camera = other
    flight.frame_set(4)
    near = len(terrain.data.polygons)
    flight.frame_set(5)
    assert len(terrain.data.polygons) < near / 3


def test_markers_are_followed_with_time_stretching(flight, add_terrain):
    """Blender applies markers after its handlers: updating the scene once more asks for its own choice."""
    terrain = add_terrain()
    other = bpy.data.objects.new("Other", bpy.data.cameras.new("Other"))
    other.location, other.rotation_euler, other.data.clip_end = (0.0, -2000.0, 900.0), (1.15, 0.0, 0.0), 1e5
    flight.collection.objects.link(other)
    flight.timeline_markers.new("first", frame=1).camera = flight.camera
    flight.timeline_markers.new("second", frame=3).camera = other
    chosen = []
    for old, new in ((100, 200), (100, 50)):
        flight.render.frame_map_old, flight.render.frame_map_new = old, new
        for frame in range(1, 8):
            flight.frame_set(frame)
            assert active_camera(flight) == flight.camera, (old, new, frame)
            chosen.append(flight.camera.name)
            [view] = session.record_of(terrain).status.request.views
            eye = np.linalg.inv(view.world_to_camera)[:3, 3]
            np.testing.assert_allclose(eye, flight.camera.matrix_world.translation, atol=1e-3)
    assert chosen == ["Camera"] * 5 + ["Other"] * 2 + ["Camera"] + ["Other"] * 6


def render(scene, tmp_path, **settings):
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.device, scene.cycles.use_denoising = 1, "CPU", False
    scene.render.filepath = str(tmp_path / "frame_")
    for name, value in settings.items():
        setattr(scene.render, name, value)
    bpy.ops.render.render(animation=True)


def test_a_render_uses_its_settings_and_restores_the_viewports(flight, add_terrain, tmp_path):
    terrain = add_terrain()
    terrain.adaptive_terrain.viewport.error_px = 10.0
    flight.render.resolution_percentage = 25
    flight.frame_set(3)
    viewport = digest_alone(terrain)
    flight.frame_start = flight.frame_end = 3
    shown = []

    def look(scene, _unused):
        shown.append(len(terrain.data.polygons))

    bpy.app.handlers.render_post.append(look)
    try:
        render(flight, tmp_path)
    finally:
        bpy.app.handlers.render_post.remove(look)
    assert shown[0] > 0 and digest_alone(terrain) == viewport
    assert session.record_of(terrain).status.mode == "VIEWPORT"


def test_handlers_of_other_extensions_change_no_mesh(flight, add_terrain, tmp_path):
    """Before and after ours: they update the view layer, rebuild meshes and move objects while frames change."""
    terrain, found = add_terrain(), []
    flight.render.resolution_percentage = 5
    flight.frame_start, flight.frame_end = 1, 3
    other = bpy.data.objects.new("Other", bpy.data.meshes.new("Other"))
    flight.collection.objects.link(other)

    def look(scene, _unused):
        found[-1].append(digest_alone(terrain))

    def update(scene, _unused=None):
        bpy.context.view_layer.update()

    def rebuild(scene, _unused=None):
        other.data.clear_geometry()
        other.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, scene.frame_current)], [], [(0, 1, 2)])

    def move(scene, _unused=None):
        other.location.x = scene.frame_current
        update(scene)

    handlers_of = bpy.app.handlers
    added = [
        (handlers_of.render_pre, update),
        (handlers_of.frame_change_pre, rebuild),
        (handlers_of.frame_change_post, move),
    ]
    handlers_of.render_post.append(look)
    try:
        for are_there in (False, True):
            found.append([])
            for functions, function in added if are_there else []:
                functions.insert(0, function)
                functions.append(function)
            render(flight, tmp_path)
    finally:
        for functions, function in [*added, *added, (handlers_of.render_post, look)]:
            if function in functions:
                functions.remove(function)
    assert found[0] == found[1] and len(set(found[0])) == 3


def test_shutter_times_do_not_rebuild(scene, add_terrain, monkeypatch):
    """Shutter times may be whole neighbouring frames: only the frame of render_pre counts, until render_post."""
    updates = []
    monkeypatch.setattr(
        handlers, "update_all", lambda scene, depsgraph, mode: updates.append(scene.frame_current) or []
    )
    rendering = SimpleNamespace(mode="RENDER")
    fake = SimpleNamespace(session_uid=1, frame_current=5, frame_subframe=0.0, objects=[])
    handlers.on_render_pre(fake)
    handlers.on_frame_change(fake, rendering)
    for frame, subframe in ((4, 0.0), (5, 0.5), (6, 0.0)):
        fake.frame_current, fake.frame_subframe = frame, subframe
        handlers.on_frame_change(fake, rendering)
    assert updates == [5]
    handlers.on_render_post(fake)
    fake.frame_current, fake.frame_subframe = 5, 0.0
    handlers.on_frame_change(fake, rendering)
    assert updates == [5]


def test_one_terrain_that_fails_does_not_stop_the_other(flight, add_terrain):
    broken, good = add_terrain("Broken"), add_terrain("Good")
    broken.adaptive_terrain.store = "/nowhere"
    flight.frame_set(4)
    assert len(good.data.polygons) > 100
    assert "/nowhere" in session.record_of(broken).status.error


def test_a_stale_frame_has_an_error_with_fields():
    errors = [TerrainError("There is no store", "/a", fix="import it"), TerrainError("It is flat", expected="a scale")]
    error = stale_renders.stale_frame_error(4, errors[::-1])
    assert error.what == (
        "Frame 4 is not rendered, since its mesh would be stale. It is flat; expected a scale. There is no store"
    )
    assert (error.where, error.fix) == ("/a", "import it")
    assert stale_renders.stale_frame_error(4, errors[:1] * 2).what.endswith("be stale. There is no store")


def test_stale_frames_are_told_of_in_few_words():
    why = "There is no terrain store."
    assert stale_renders.message_lines({3: why, 2: why}) == ["Rendered with the mesh of another frame: 2, 3", why]
    assert stale_renders.message_lines(dict.fromkeys(range(1, 241), why))[0].endswith(" 8, 9, 10 and 230 more")


@pytest.fixture
def window(monkeypatch, scene):
    """Give the live timer a window manager with one window on the scene."""
    shown = SimpleNamespace(scene=scene, view_layer=bpy.context.view_layer, screen=SimpleNamespace(areas=[]))
    context = SimpleNamespace(window_manager=SimpleNamespace(windows=[shown]))
    named = {"types": bpy.types, "app": bpy.app, "data": bpy.data}
    monkeypatch.setattr(live, "bpy", SimpleNamespace(context=context, **named))
    bpy.context.view_layer.update()
    return shown


def test_live_update_writes_from_a_worker(window, add_terrain):
    terrain = add_terrain()
    bpy.context.view_layer.update()
    turns()
    assert len(terrain.data.polygons) > 100
    before = digest_alone(terrain)
    terrain.adaptive_terrain.viewport.error_px = 6.0
    bpy.context.view_layer.update()
    turns()
    assert digest_alone(terrain) != before


def test_a_stale_result_is_dropped(window, add_terrain):
    terrain = add_terrain()
    bpy.context.view_layer.update()
    live.mark_dirty()
    assert live.tick() == live.BUSY_S
    terrain.adaptive_terrain.viewport.error_px = 12.0
    update = session.update_object(terrain)  # the user clicked Update in the meantime
    turns()
    assert len(terrain.data.polygons) == update.triangles


def test_a_result_whose_terrain_is_gone_is_dropped(window, add_terrain):
    terrain = add_terrain()
    bpy.context.view_layer.update()
    live.mark_dirty()
    assert live.tick() == live.BUSY_S
    bpy.data.objects.remove(terrain)
    bpy.context.view_layer.update()
    turns()
    assert session.all_terrains() == []


def test_live_update_begins_when_the_kernels_are_ready(window, add_terrain, preparing, monkeypatch):
    redrawn = []
    monkeypatch.setattr(jobs, "redraw_panels", lambda: redrawn.append(1))
    terrain = add_terrain()
    bpy.context.view_layer.update()
    live.mark_dirty()
    for fraction in (0.25, 0.5, 0.5):
        preparing.fraction = fraction
        assert live.tick() == live.IDLE_S
        status_bar._tick()
    assert len(redrawn) == 2 and len(terrain.data.polygons) == 0
    preparing.fraction = None
    status_bar._tick()
    preparing.done.set()
    turns()
    assert len(redrawn) >= 4, "the bar goes, then Update can be clicked"
    assert len(terrain.data.polygons) > 100


def test_frames_of_a_shot_are_those_that_a_render_writes(flight, tmp_path):
    flight.frame_start, flight.frame_end, flight.frame_step = 2, 9, 3
    render(flight, tmp_path, resolution_percentage=1)
    written = [int(path.stem.removeprefix("frame_")) for path in sorted(tmp_path.iterdir())]
    assert written == list(frames_of(flight)) == [2, 5, 8]
