# SPDX-License-Identifier: GPL-3.0-or-later
"""Before Blender 4.5 exact normals are slow: live meshes get them at rest, renders and files always have them."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.operators.bridge import writer
from adaptive_terrain.operators.session import live, session
from blender_meshes import corner_normals
from live_windows import show_window, turns

ROUNDING = 0.0142  # radians: an encoded normal that is nearer to Blender's own is replaced by it


@pytest.fixture
def older(monkeypatch):
    """Write normals as Blender before 4.5 needs them."""
    monkeypatch.setattr(writer, "STORES_VERTEX_NORMALS", False)


def exact_normals(obj, mode: str) -> np.ndarray:
    """Return the normals that an update from nothing writes for the present frame, at the corners of its triangles."""
    session.record_of(obj).shown = None
    surface = session.update_object(obj, mode=mode).surface
    written = corner_normals(obj.data)
    assert np.abs(written - surface.normals[surface.corner_verts]).max() < ROUNDING
    return written


def turn() -> None:
    """Run the timer until it has written all meshes, and once more at rest."""
    turns()
    live.tick()


def test_a_live_mesh_gets_exact_normals_at_rest(scene, add_terrain, older, monkeypatch):
    terrain = add_terrain()
    show_window(monkeypatch)
    monkeypatch.setattr(live, "NORMALS_S", 1e9)
    turn()
    assert len(terrain.data.polygons) > 100 and not terrain.data.has_custom_normals
    rough = corner_normals(terrain.data)
    monkeypatch.setattr(live, "NORMALS_S", 0.0)
    turn()
    exact = corner_normals(terrain.data)
    assert not session.show_normals(terrain), "they are written once"
    assert np.array_equal(exact, exact_normals(terrain, "VIEWPORT"))
    assert np.abs(rough - exact).max() > 3 * ROUNDING, "the difference shows"


@pytest.mark.parametrize("same_detail", [True, False])
def test_renders_have_exact_normals(scene, add_terrain, older, monkeypatch, tmp_path, same_detail):
    terrains = [add_terrain("North"), add_terrain("South")]
    terrains[1].location.y = -1400.0
    for terrain in terrains:
        detail = terrain.adaptive_terrain.render
        detail.error_px = 1.0 if same_detail else 3.0
        detail.smooth_transitions = not same_detail
    show_window(monkeypatch)
    monkeypatch.setattr(live, "NORMALS_S", 1e9)
    scene.render.engine, scene.render.filepath = "BLENDER_WORKBENCH", str(tmp_path / "frame_")
    scene.render.resolution_x, scene.render.resolution_y = 64, 36
    for frame, x in ((5, 0.0), (7, 300.0)):
        scene.camera.location.x = x
        scene.camera.keyframe_insert("location", frame=frame)
    found = {}

    def look(scene, _unused=None):
        for terrain in terrains:
            found[scene.frame_current, terrain.name] = corner_normals(terrain.data)

    bpy.app.handlers.render_post.append(look)
    try:
        for frame in (5, 7):
            scene.frame_set(frame)
            for terrain in terrains:
                session.record_of(terrain).shown = session.record_of(terrain).live_key = None
            turn()
            assert not any(terrain.data.has_custom_normals for terrain in terrains)
            scene.frame_start = scene.frame_end = frame
            bpy.ops.render.render(animation=True)
    finally:
        bpy.app.handlers.render_post.remove(look)
    assert len(found) == 4
    for (frame, name), normals in found.items():
        scene.frame_set(frame)
        assert np.array_equal(normals, exact_normals(bpy.data.objects[name], "RENDER")), (frame, name)


def test_a_saved_mesh_has_exact_normals(scene, add_terrain, older, monkeypatch, tmp_path):
    terrain = add_terrain()
    show_window(monkeypatch)
    monkeypatch.setattr(live, "NORMALS_S", 1e9)
    turn()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    assert np.array_equal(corner_normals(terrain.data), exact_normals(terrain, "VIEWPORT"))


def test_free_normals_are_never_postponed(scene, add_terrain, monkeypatch):
    if not writer.STORES_VERTEX_NORMALS:
        pytest.skip("this Blender encodes normals")
    terrain = add_terrain()
    show_window(monkeypatch)
    monkeypatch.setattr(live, "NORMALS_S", 1e9)
    turn()
    assert terrain.data.has_custom_normals and session.record_of(terrain).postponed_normals is None
