# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that the extension adds to Blender, and its removal in reverse order."""

import atexit
import gc

import bpy

from . import handlers, jobs
from .effects import add_scatter, bake_maps, splat_layers, terrain_material
from .farm import submit_to_farm
from .ground import add_collider, drop_to_ground, keep_above, keep_ground, pick_ground, profile_curve, viewshed
from .importing import add_terrain, import_terrain, move_stores, pack_store, store_paths
from .land import land_cache, land_list, land_presets, shape_land, water_surface
from .mesh import freed_memory
from .output import bake_land, bake_terrain, export_terrain
from .properties import keep_properties, layer_images, properties
from .report import measure_accuracy, sweep_accuracy
from .scene import freeze_detail, session, update_terrain
from .ui import effects_panel, overlay_panel, panels, scatter_panel, status_bar, status_row
from .viewport import frame_terrain, live

MODULES = (
    properties,
    keep_properties,
    keep_ground,
    store_paths,
    move_stores,
    import_terrain,
    add_terrain,
    frame_terrain,
    pack_store,
    update_terrain,
    freeze_detail,
    bake_terrain,
    bake_land,
    bake_maps,
    terrain_material,
    add_scatter,
    splat_layers,
    layer_images,
    land_list,
    land_presets,
    land_cache,
    shape_land,
    water_surface,
    export_terrain,
    submit_to_farm,
    drop_to_ground,
    keep_above,
    pick_ground,
    profile_curve,
    viewshed,
    add_collider,
    measure_accuracy,
    sweep_accuracy,
    effects_panel,
    overlay_panel,
    status_row,
    panels,
    scatter_panel,
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
