# SPDX-License-Identifier: GPL-3.0-or-later
"""Which attributes of an object's mesh does a scene read? Precise where that can be known, everything where it cannot.

Not seen is what Python reads: scripts, drivers' own functions. Hidden objects count, their modifiers would read.
"""

from dataclasses import dataclass, field

from ...cbt_terrain.effects.effect import GEOMETRY, PICTURE
from .drivers import read_drivers
from .found import ACTIVE_COLOR, ALL, Demand
from .geometry import Taken, is_enabled, read_modifier, read_particles, sets_material_index
from .materials import ENGINES, WORKBENCH, Look, look_of, read_material, read_rays, read_workbench, worn_slots
from .screens import read_screens

RENDER = "RENDER"
# What file formats take with them beside UVs and normals, which every mesh has.
EXPORTS = {"ply": ALL, "usd": ALL, "abc": ACTIVE_COLOR, "obj": ACTIVE_COLOR, "gltf": ACTIVE_COLOR, "fbx": ACTIVE_COLOR}
NOTHING_EXPORTED = ("stl",)


@dataclass
class _Scene:
    """What a gathering goes through. `holding`: objects that have the mesh, or geometry that is made from it."""

    found: Demand
    terrain: object
    objects: list
    render: bool
    look: Look
    holding: set
    materials: set = field(default_factory=set)

    def modifiers_of(self, obj) -> list:
        return [modifier for modifier in getattr(obj, "modifiers", ()) if is_enabled(modifier, self.render)]

    def words(self, obj, modifier) -> str:
        return f"{'' if obj == self.terrain else f'object {obj.name}, '}modifier {modifier.name}"


def demand(obj, depsgraph, mode: str = RENDER, exports: tuple[str, ...] = ()) -> Demand:
    """What a scene reads of the mesh of `obj`: readers by the attribute's name, and by the names of found.py.

    `depsgraph`: of the scene. `mode`: "RENDER" or "VIEWPORT", which differ in modifiers, view layers and windows.
    `exports`: extensions of files that are written beside.
    """
    scene, render = depsgraph.scene.original, mode == RENDER
    layers = [layer for layer in scene.view_layers if layer.use or not render]
    shown = _objects(scene)
    holding = {other for other in shown if other.data == obj.data} | {obj}
    gathering = _Scene(Demand(), obj, shown, render, look_of(scene, layers, preview=not render), holding)
    found = gathering.found
    _read_engine(found, scene, render)
    if not render:
        read_screens(found)
    for holder in list(holding):
        _read_holder(gathering, holder)
    _read_takers(gathering)
    materials = _worn(gathering.materials, layers)
    for material in materials:
        read_material(found, material, gathering.look)
    read_rays(found, materials, gathering.look)
    read_drivers(found, obj, shown, scene)
    for extension in exports:
        if extension not in NOTHING_EXPORTED:
            found.add(EXPORTS.get(extension, ALL), f"export of {extension}", GEOMETRY)
    return found


def _objects(scene) -> list:
    """Of a scene and its background sets, and what collections are instanced there."""
    waiting, seen = [], set()
    while scene is not None and scene not in seen:
        seen.add(scene)
        waiting += scene.objects
        scene = scene.background_set
    found = dict.fromkeys(waiting)
    while waiting:
        obj = waiting.pop()
        collection = obj.instance_collection if obj.instance_type == "COLLECTION" else None
        inside = [other for other in collection.all_objects if other not in found] if collection else []
        found |= dict.fromkeys(inside)
        waiting += inside
    return list(found)


def _read_engine(found: Demand, scene, render: bool) -> None:
    engine = scene.render.engine
    if engine == WORKBENCH:
        if render:
            read_workbench(found, scene.display.shading, "Workbench")
    elif engine not in ENGINES:
        found.add(ALL, f"render engine {engine} (unknown what it reads)", PICTURE)


def _read_holder(scene: _Scene, obj) -> None:
    """An object that has the mesh itself."""
    modifiers = scene.modifiers_of(obj)
    for modifier in modifiers:
        words = scene.words(obj, modifier)
        taken = read_modifier(scene.found, modifier, words, scene.look.trees, viewers=not scene.render)
        _wear(scene, taken)
    slots = range(len(obj.material_slots)) if any(map(sets_material_index, modifiers)) else worn_slots(obj)
    numbers = set(slots)
    for system in obj.particle_systems:
        numbers.add(system.settings.material - 1)
        read_particles(scene.found, system, "" if obj == scene.terrain else f"object {obj.name}, ")
    scene.materials |= {obj.material_slots[n].material for n in numbers if 0 <= n < len(obj.material_slots)}


def _read_takers(scene: _Scene) -> None:
    """Objects whose modifiers take geometry from those that hold it, and from those objects in turn."""
    waiting = []
    for obj in scene.objects:
        if obj not in scene.holding:
            for modifier in scene.modifiers_of(obj):
                found = Demand()
                taken = read_modifier(found, modifier, scene.words(obj, modifier), scene.look.trees)
                waiting.append((obj, modifier, found, taken))
    read = True
    while read:
        # Of an object that has become a holder every modifier counts: those after the taking one see the geometry.
        read = [item for item in waiting if item[0] in scene.holding or item[3].all_objects() & scene.holding]
        waiting = [item for item in waiting if item not in read]
        for obj, modifier, found, taken in read:
            scene.found.merge(found)
            if modifier.type == "DATA_TRANSFER" and taken.objects & scene.holding:
                words = f"{scene.words(obj, modifier)} (it transfers data layers)"
                scene.found.add(ALL, words, GEOMETRY)
            if modifier.type in ("NODES", "BOOLEAN"):
                scene.holding.add(obj)
                scene.materials |= {slot.material for slot in obj.material_slots}
                _wear(scene, taken)


def _wear(scene: _Scene, taken: Taken) -> None:
    """Materials that a modifier sets, and those of what it takes in: instances read their points' attributes."""
    scene.materials |= taken.materials
    scene.materials |= {s.material for o in taken.all_objects() - scene.holding for s in o.material_slots}


def _worn(materials: set, layers: list) -> set:
    """With what view layers put in their place."""
    overrides = {layer.material_override for layer in layers} or {None}
    return (overrides if None not in overrides else materials | overrides) - {None}
