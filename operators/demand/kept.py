# SPDX-License-Identifier: GPL-3.0-or-later
"""A demand is kept until something that it depends on changes; in memory alone, never in the file.

Blender says which data-blocks an update has touched. Objects are touched whenever our own mesh is written: whether
their modifiers, materials or mesh are others is told by a key.
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
        block = update.id
        if isinstance(block, TYPES):
            stale = True
        elif isinstance(block, bpy.types.Object) and update.is_updated_geometry:
            original = block.original
            key = _object_key(original)
            stale |= _objects.get(original.session_uid) != key
            _objects[original.session_uid] = key
    if stale:
        _kept.clear()


def forget() -> None:
    """Another file, or undo: nothing is known."""
    _kept.clear()
    _objects.clear()


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
