# SPDX-License-Identifier: GPL-3.0-or-later
"""A window for the live update, and the vertices of Blender objects."""

from types import SimpleNamespace

import bpy
import numpy as np
from adaptive_terrain.operators.session import live


def show_window(monkeypatch, scene=None, view_layer=None) -> None:
    """Let the live update see one window, by default on the current scene."""
    scene, view_layer = scene or bpy.context.scene, view_layer or bpy.context.view_layer
    window = SimpleNamespace(scene=scene, view_layer=view_layer, screen=SimpleNamespace(areas=()))
    monkeypatch.setattr(live, "_windows", lambda: [window])


def positions(obj) -> np.ndarray:
    """Return the vertices of an object's mesh, float32 [V, 3]."""
    array = np.empty(3 * len(obj.data.vertices), np.float32)
    obj.data.vertices.foreach_get("co", array)
    return array.reshape(-1, 3)
