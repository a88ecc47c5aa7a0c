# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that the extension adds to Blender, and its removal in reverse order."""

import atexit
import gc

import bpy

from . import handlers, jobs
from .accuracy import measure as measure_accuracy
from .accuracy import sweep as sweep_accuracy
from .bridge import freed_memory
from .export import bake_terrain, export_terrain, export_tiles, map_camera
from .farm import submit_to_farm
from .ground import add_collider, drop_to_ground, keep_above, keep_ground, pick_ground, profile_curve, viewshed
from .ground import properties as keep_properties
from .importing import add_terrain, import_terrain, menus, move_stores, pack_store, store_paths
from .land import bake_land, render_wait, shape_land, water_surface
from .land import cache as land_cache
from .land import presets as land_presets
from .land import stack_list as land_list
from .layers import images as layer_images
from .layers import operators as splat_layers
from .layers import terrain_material
from .maps import operators as bake_maps
from .overlay import panel as overlay_panel
from .scatter import operators as add_scatter
from .scatter import starter as starter_collection
from .scene import set_up
from .session import live, session
from .terrain import frame_terrain, freeze_detail, properties, update_terrain
from .text import translations
from .ui import object_menu, panels, status_bar, status_row

MODULES = (
    translations,
    properties,
    keep_properties,
    keep_ground,
    store_paths,
    move_stores,
    import_terrain,
    add_terrain,
    menus,
    frame_terrain,
    pack_store,
    update_terrain,
    freeze_detail,
    bake_terrain,
    bake_land,
    bake_maps,
    terrain_material,
    set_up,
    add_scatter,
    starter_collection,
    splat_layers,
    layer_images,
    land_list,
    land_presets,
    land_cache,
    shape_land,
    render_wait,
    water_surface,
    export_terrain,
    export_tiles,
    map_camera,
    submit_to_farm,
    drop_to_ground,
    keep_above,
    pick_ground,
    profile_curve,
    viewshed,
    add_collider,
    measure_accuracy,
    sweep_accuracy,
    overlay_panel,
    status_row,
    panels,
    object_menu,
    handlers,
    live,
    status_bar,
    jobs,  # ends what runs before the operators go
)


def register() -> None:
    for module in MODULES:
        module.register()
    if bpy.app.binary_path:
        # Python looks for garbage once more at its end. Without all that kernels are, Blender's start and end take 1.5
        # and not 2.1 s of a processor.
        atexit.register(gc.freeze)
    else:
        atexit.register(unregister)  # as a module Blender crashes at exit if it finds Python's classes registered


def unregister() -> None:
    atexit.unregister(unregister)
    for module in reversed(MODULES):
        module.unregister()
    session.clear()
    freed_memory.unregister()
