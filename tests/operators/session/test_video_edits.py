# SPDX-License-Identifier: GPL-3.0-or-later
"""A video edit shows a scene by strips, each with its own camera."""

import bpy
import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.operators.session import session, stale_renders


def new_strip(edit, scene, start, camera=None):
    """Add a strip of two frames that shows a scene through a camera, or through its own."""
    editor = edit.sequence_editor
    strip = (editor.strips if hasattr(editor, "strips") else editor.sequences).new_scene("Strip", scene, 1, start)
    strip.frame_final_duration, strip.scene_camera = 2, camera
    return strip


@pytest.fixture
def edit(scene, tmp_path):
    """Add a scene whose video edit shows the scene through its camera in frames 1 and 2, through another in 3 and 4.

    Scenes render 16 x 16 pixels.
    """
    east = bpy.data.objects.new("East", bpy.data.cameras.new("East"))
    east.location, east.rotation_euler, east.data.clip_end = (900.0, 0.0, 300.0), (1.2, 0.0, 1.57), 1e5
    scene.collection.objects.link(east)
    edit = bpy.data.scenes.new("Edit")
    edit.sequence_editor_create()
    for made in (scene, edit):
        made.render.engine = "CYCLES"
        made.cycles.samples, made.cycles.device, made.cycles.use_denoising = 1, "CPU", False
        made.render.resolution_x = made.render.resolution_y = 16
    new_strip(edit, scene, 1)
    new_strip(edit, scene, 3, east)
    muted = new_strip(edit, scene, 1, east)
    muted.mute = True
    edit.frame_start, edit.frame_end, edit.render.filepath = 1, 4, str(tmp_path / "frame_")
    return edit


def eyes_of(terrain) -> list:
    """Return the places of the eyes that a terrain is refined for, rounded to metres."""
    request = session.record_of(terrain).status.request
    views = request.views if request is not None else []
    return [np.linalg.inv(view.world_to_camera)[:3, 3].round().tolist() for view in views]


@pytest.fixture
def rendered(edit, add_terrain):
    """Return a function that renders the edit, and the eyes of the terrain at each picture of the scene."""
    terrain, eyes = add_terrain(), []

    def look(_scene, _unused):
        eyes.append(eyes_of(terrain))

    def render() -> list:
        bpy.app.handlers.render_post.append(look)
        try:
            bpy.ops.render.render(animation=True, scene=edit.name)
        finally:
            bpy.app.handlers.render_post.remove(look)
        return eyes[::2]  # each is followed by one of the edit

    return render


def test_strips_are_refined_for_their_cameras(rendered, capsys):
    south, east = [[0.0, -900.0, 400.0]], [[900.0, 0.0, 300.0]]
    assert rendered() == [south, south, east, east]
    assert "cannot be refined" not in capsys.readouterr().out, "the edit itself has no camera"


def test_strips_at_the_same_frame_are_refined_together(rendered, edit, scene):
    new_strip(edit, scene, 3)
    assert sorted(rendered()[2]) == [[0.0, -900.0, 400.0], [900.0, 0.0, 300.0]]


def test_a_stale_strip_names_the_picture_of_the_edit(rendered, scene, capsys):
    scene.adaptive_terrain.stop_stale_renders = False
    bpy.data.objects["Terrain"].scale.z = 0.0
    rendered()
    output = capsys.readouterr().out
    assert [f"frame {frame} is rendered with a stale mesh" in output for frame in range(6)] == [
        False,
        *[True] * 4,
        False,
    ]


def test_a_command_names_the_picture_of_the_edit(rendered):
    terrain = bpy.data.objects["Terrain"]
    for frame, scale in ((1, 1.0), (2, 0.0)):
        terrain.scale.z = scale
        terrain.keyframe_insert("scale", index=2, frame=frame)
    with pytest.raises(TerrainError, match="Frame 2 is not rendered"), stale_renders.raise_for_stale_frames():
        rendered()
