# SPDX-License-Identifier: GPL-3.0-or-later
"""The keys of a render, before which tiles or land may be missing; where no poll holds, Blender's own entries count."""

import bpy

from ..importing.render_loaded import RenderLoaded
from ..land.shape_land import ShapeAndRender

_keys: list[tuple] = []  # keymap, and an entry of it


def start() -> None:
    """Give F12 to RenderLoaded, before all others, and then F12 and Ctrl F12 to ShapeAndRender."""
    config = bpy.context.window_manager.keyconfigs.addon
    if config is None or bpy.app.background:
        return
    keymap = config.keymaps.new("Screen")
    for animation in (False, True):
        item = keymap.keymap_items.new(ShapeAndRender.bl_idname, "F12", "PRESS", ctrl=animation)
        item.properties.animation = animation
        _keys.append((keymap, item))
    _keys.append((keymap, keymap.keymap_items.new(RenderLoaded.bl_idname, "F12", "PRESS", head=True)))


def stop() -> None:
    """Remove the keys that `start` has added."""
    for keymap, item in _keys:
        keymap.keymap_items.remove(item)
    _keys.clear()
