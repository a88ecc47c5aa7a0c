# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that strips of a video edit show: Blender renders them inside the render of the edit's scene."""


def edits_of(scene, rendered) -> list:
    """Return those of the scenes `rendered` whose video edit shows another scene, `scene`, by a strip."""
    return [edit for edit in rendered if edit != scene and _strips_of(edit, scene)]


def cameras_in(edits, scene) -> list:
    """Return the cameras, each once, through which strips of video edits show a scene at the edits' present frames.

    None stands for the camera of the scene, where a strip names no other one. [] without a strip at that frame.
    """
    strips = [
        strip
        for edit in edits
        for strip in _strips_of(edit, scene)
        if strip.frame_final_start <= edit.frame_current < strip.frame_final_end
    ]
    return list(dict.fromkeys(strip.scene_camera for strip in strips))


def _strips_of(edit, scene) -> list:
    """Return the strips of an edit's scene, also inside meta strips, that show another scene and are not muted."""
    editor = edit.sequence_editor
    if editor is None or not edit.render.use_sequencer:
        return []
    strips = editor.strips_all if hasattr(editor, "strips_all") else editor.sequences_all  # before Blender 4.4
    return [strip for strip in strips if strip.type == "SCENE" and strip.scene == scene and not strip.mute]
