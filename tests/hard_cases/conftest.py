# SPDX-License-Identifier: GPL-3.0-or-later
"""Fixtures of the hard cases; those for Blender are shared with the tests of the operators."""

import pytest
from blender_scenes import add_terrain, empty, grid_surface, scene, store  # noqa: F401
from flights import arguments, undisturbed  # noqa: F401
from forked_children import fork_children  # noqa: F401


@pytest.fixture
def flight(scene):  # noqa: F811
    """Return a scene whose camera flies over frames 1 to 20 on an animated, rotating parent."""
    import bpy

    parent = bpy.data.objects.new("Rig", None)
    scene.collection.objects.link(parent)
    scene.camera.parent = parent
    for frame, x, turn in ((1, -300.0, 0.0), (20, 300.0, 0.6)):
        parent.location.x, parent.rotation_euler.z = x, turn
        parent.keyframe_insert("location", frame=frame)
        parent.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_set(1)
    return scene
