# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that the extension adds to Blender, and its removal in reverse order."""

import atexit
import gc
from pathlib import Path

import bpy
from bpy.props import PointerProperty

from . import handlers, jobs
from .accuracy import registered as accuracy
from .assets import library as asset_library
from .attributes import registered as attributes
from .bridge import freed_memory, writing
from .export import registered as export
from .farm import registered as farm
from .ground import keep_ground
from .ground import properties as ground_properties
from .ground import registered as ground
from .importing import add_terrain, import_terrain, menus, store_paths
from .importing import registered as importing
from .land import registered as land
from .land import render_wait
from .layers import images
from .layers import registered as layers
from .maps import registered as maps
from .overlay import panel as overlay_panel
from .overlay import registered as overlay
from .scatter import properties as scatter_properties
from .scatter import registered as scatter
from .scene import registered as scene
from .session import live, session
from .terrain import properties as terrain_properties
from .terrain import registered as terrain
from .text import translations
from .ui import object_menu, render_keys, status_bar
from .ui import registered as ui

# Groups of settings come before those that contain them: layers before scatter and terrain.
ROOMS = (
    *(ground, importing, attributes, layers, scatter, land, maps, terrain),
    *(overlay, scene, export, farm, accuracy, ui),
)
CLASSES = (*(cls for room in ROOMS for cls in room.CLASSES), jobs.CancelJob)
HANDLERS = (*(pair for room in ROOMS for pair in room.HANDLERS), *handlers.HANDLERS.items())
SETTINGS = (
    (bpy.types.Object, "adaptive_terrain", terrain_properties.TerrainSettings),
    (bpy.types.Scene, "adaptive_terrain", terrain_properties.SceneSettings),
    (bpy.types.Object, "adaptive_scatter", scatter_properties.ScatterSettings),
    (bpy.types.Object, "adaptive_terrain_keep", ground_properties.KeepSettings),
)
MENU_ENTRIES = (
    (bpy.types.VIEW3D_MT_mesh_add, add_terrain.draw_entry),
    (bpy.types.TOPBAR_MT_file_import, menus.draw_import_entry),
    (bpy.types.VIEW3D_MT_mesh_add, menus.draw_add_entry),
    (bpy.types.VIEW3D_MT_object, object_menu.draw_entry),
)
PRESETS = str(Path(__file__).parent)  # the folder that holds "presets"
# Modules with timers, threads, keys and drawing; they stop before the operators go.
SERVICES = (
    *(writing, translations, store_paths, asset_library, render_wait, render_keys, overlay_panel),
    *(live, status_bar),
)


def register() -> None:
    """Add classes, settings, handlers, menus and presets to Blender, and start the services."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    for owner, name, group in SETTINGS:
        setattr(owner, name, PointerProperty(type=group))
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).append(handler)
    for menu, entry in MENU_ENTRIES:
        menu.append(entry)
    bpy.utils.register_preset_path(PRESETS)
    store_paths.move_old_stores()  # of earlier versions, into the present data folder
    for service in SERVICES:
        service.start()
    if bpy.app.binary_path:
        # Python searches all objects for garbage at its exit. If they are frozen first, Blender's start and exit take
        # 1.5 s of a processor instead of 2.1 s.
        atexit.register(gc.freeze)
    else:
        atexit.register(unregister)  # as a module Blender crashes at exit if it finds Python's classes registered


def unregister() -> None:
    """Undo `register` in the opposite order; jobs are cancelled first."""
    atexit.unregister(unregister)
    jobs.stop_all()
    for service in reversed(SERVICES):
        service.stop()
    bpy.utils.unregister_preset_path(PRESETS)
    for menu, entry in MENU_ENTRIES:
        menu.remove(entry)
    for event, handler in HANDLERS:
        listed = getattr(bpy.app.handlers, event)
        if handler in listed:
            listed.remove(handler)
    for owner, name, _ in SETTINGS:
        delattr(owner, name)
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
    for forget in (handlers.forget, import_terrain.forget, images.forget, keep_ground.forget):
        forget()
    ground_properties.look_again()  # forgets whether any object is kept on the ground
    session.clear()
    freed_memory.unregister()
