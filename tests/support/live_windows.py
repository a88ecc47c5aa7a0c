# SPDX-License-Identifier: GPL-3.0-or-later
"""A window for the live update, and turns of its timer."""

import time
from types import SimpleNamespace

import bpy
from adaptive_terrain.operators.session import live


def show_window(monkeypatch, scene=None, view_layer=None) -> None:
    """Let the live update see one window, by default on the current scene."""
    scene, view_layer = scene or bpy.context.scene, view_layer or bpy.context.view_layer
    window = SimpleNamespace(scene=scene, view_layer=view_layer, screen=SimpleNamespace(areas=()))
    monkeypatch.setattr(live, "_windows", lambda: [window])


def turns(changed: bool = True) -> None:
    """Run the timer of the live update until nothing is under way, first after a change of the scene."""
    if changed:
        live.mark_dirty()
    for _ in range(10_000):
        if live.tick() == live.IDLE_S:
            return
        time.sleep(0.005)
    raise AssertionError("the live update never ended")
