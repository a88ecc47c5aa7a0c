# SPDX-License-Identifier: GPL-3.0-or-later
"""A demand is kept until something that it depends on changes; in memory alone, never in the file.

Blender says which data-blocks an update has touched. Objects are touched whenever our own mesh is written or something
moves: whether their modifiers, materials, mesh or drivers are others is told by a key.
"""

import bpy

from .demand import RENDER, demand
from .found import Demand
from .geometry import modifier_key
from .screens import screens_key

# Whatever of these is touched may be read otherwise.
TYPES = (
    *(bpy.types.Material, bpy.types.NodeTree, bpy.types.World, bpy.types.Light),
    *(bpy.types.ParticleSettings, bpy.types.Collection, bpy.types.Action),
)
_kept: dict[tuple[int, int], tuple[tuple, Demand]] = {}  # by session_uid of terrain and scene: its key, the demand
_objects: dict[int, tuple] = {}  # by session_uid: the key it had when it was last touched
_driven: dict[int, tuple] = {}  # the same of drivers, of whatever has any


def demand_of(obj, depsgraph, mode: str) -> Demand:
    """The demand of a terrain's scene. A render's is always gathered: scripts that start one may have changed anything
    since the last update that was told of."""
    if mode == RENDER:
        return demand(obj, depsgraph, mode)
    scene = depsgraph.scene.original
    place, key = (obj.session_uid, scene.session_uid), (_scene_key(scene), screens_key())
    if place not in _kept or _kept[place][0] != key:
        _kept[place] = key, demand(obj, depsgraph, mode)
    return _kept[place][1]


def note_update(depsgraph) -> None:
    """Forget what an update of a dependency graph has made stale."""
    stale = False
    for update in depsgraph.updates:
        block = update.id.original
        if isinstance(block, TYPES):
            stale = True
            continue
        if isinstance(block, bpy.types.Object) and update.is_updated_geometry:
            stale |= _is_other(_objects, block, _object_key(block))
        stale |= _is_other(_driven, block, _drivers_key(block), unknown=())
    if stale:
        _kept.clear()


def forget() -> None:
    """Another file, or undo: nothing is known."""
    _kept.clear()
    _objects.clear()
    _driven.clear()


def _is_other(keys: dict[int, tuple], block, key: tuple, unknown: tuple | None = None) -> bool:
    """Whether a data-block has another key than when it was last touched; the key is noted."""
    before = keys.get(block.session_uid, unknown)
    if before != key:
        keys[block.session_uid] = key
    return before != key


def _drivers_key(block) -> tuple:
    data = getattr(block, "animation_data", None)
    if not data or not len(data.drivers):
        return ()
    variables = [variable for curve in data.drivers for variable in curve.driver.variables]
    return tuple(target.data_path for variable in variables for target in variable.targets)


def _object_key(obj) -> tuple:
    data, slots = obj.data, tuple(slot.material.session_uid if slot.material else 0 for slot in obj.material_slots)
    modifiers = tuple(map(modifier_key, obj.modifiers)) if hasattr(obj, "modifiers") else ()
    collection = obj.instance_collection
    instanced = obj.instance_type, collection.session_uid if collection else 0
    return data.session_uid if data else 0, slots, modifiers, instanced, len(getattr(obj, "particle_systems", ()))


def _scene_key(scene) -> tuple:
    """Of settings, which Blender tells of together with everything else of a scene, and of which objects it has."""
    layers = tuple(
        (layer.name, layer.use, layer.material_override and layer.material_override.session_uid, *layer.aovs.keys())
        for layer in scene.view_layers
    )
    osl = getattr(getattr(scene, "cycles", None), "shading_system", False)
    return scene.render.engine, osl, layers, len(scene.objects), scene.background_set
