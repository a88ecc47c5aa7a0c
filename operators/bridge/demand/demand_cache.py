# SPDX-License-Identifier: GPL-3.0-or-later
"""A cache of demands in memory, valid until one of their sources changes.

Blender reports the data-blocks of an update. It reports objects whenever they move or our mesh is written, so a key
tells whether their modifiers, materials, mesh or drivers have changed.
"""

import bpy

from .demand import RENDER, find_demand
from .found import Demand
from .geometry import modifier_key
from .screens import screens_key

# Any update of these types may change a demand.
TYPES = (
    *(bpy.types.Material, bpy.types.NodeTree, bpy.types.World, bpy.types.Light),
    *(bpy.types.ParticleSettings, bpy.types.Collection, bpy.types.Action),
)
_cached: dict[tuple[int, int], tuple[tuple, Demand]] = {}  # key and demand by session_uid of terrain and scene
_objects: dict[int, tuple] = {}  # key at the last update of an object, by session_uid
_driven: dict[int, tuple] = {}  # key of its drivers at the last update of a data-block, by session_uid


def demand_of(obj, depsgraph, mode: str) -> Demand:
    """Return the attributes that a terrain's scene reads, in a viewport from the cache if nothing has changed.

    mode: "VIEWPORT" or "RENDER". Do not change the result, which the cache holds. A render's demand is never cached: a
    script may have changed anything since the last reported update.
    """
    if mode == RENDER:
        return find_demand(obj, depsgraph, mode)
    scene = depsgraph.scene.original
    uids, key = (obj.session_uid, scene.session_uid), (_scene_key(scene), screens_key())
    if uids not in _cached or _cached[uids][0] != key:
        _cached[uids] = key, find_demand(obj, depsgraph, mode)
    return _cached[uids][1]


def note_update(depsgraph) -> None:
    """Drop all cached demands if an update of a dependency graph may have changed one."""
    stale = False
    for update in depsgraph.updates:
        block = update.id.original
        if isinstance(block, TYPES):  # any update of these may change a demand
            stale = True
            continue
        if isinstance(block, bpy.types.Object) and update.is_updated_geometry:
            stale |= _has_changed(_objects, block, _object_key(block))
        stale |= _has_changed(_driven, block, _drivers_key(block), unknown=())
    if stale:
        _cached.clear()


def forget() -> None:
    """Drop everything, after undo or another file."""
    _cached.clear()
    _objects.clear()
    _driven.clear()


def _has_changed(keys: dict[int, tuple], block, key: tuple, unknown: tuple | None = None) -> bool:
    """Store the key of a data-block; return whether it differs from the one at the last update.

    keys: stored keys by session_uid. unknown: key to compare with if none is stored for the block.
    """
    before = keys.get(block.session_uid, unknown)
    if before != key:
        keys[block.session_uid] = key
    return before != key


def _drivers_key(block) -> tuple:
    """Return a key of the paths that a data-block's drivers read, () without drivers."""
    data = getattr(block, "animation_data", None)
    if not data or not len(data.drivers):
        return ()
    variables = [variable for curve in data.drivers for variable in curve.driver.variables]
    return tuple(target.data_path for variable in variables for target in variable.targets)


def _object_key(obj) -> tuple:
    """Return a key of an object's mesh, materials, modifiers, instanced collection and particle systems."""
    data, slots = obj.data, tuple(slot.material.session_uid if slot.material else 0 for slot in obj.material_slots)
    modifiers = tuple(map(modifier_key, obj.modifiers)) if hasattr(obj, "modifiers") else ()
    collection = obj.instance_collection
    instanced = obj.instance_type, collection.session_uid if collection else 0
    return data.session_uid if data else 0, slots, modifiers, instanced, len(getattr(obj, "particle_systems", ()))


def _scene_key(scene) -> tuple:
    """Return a key of a scene's engine, view layers, background set and number of objects.

    Blender reports any change of a scene as an update of the scene, without the kind of change.
    """
    layers = tuple(
        (layer.name, layer.use, layer.material_override and layer.material_override.session_uid, *layer.aovs.keys())
        for layer in scene.view_layers
    )
    osl = getattr(getattr(scene, "cycles", None), "shading_system", False)
    return scene.render.engine, osl, layers, len(scene.objects), scene.background_set
