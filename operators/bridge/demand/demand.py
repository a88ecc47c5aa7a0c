# SPDX-License-Identifier: GPL-3.0-or-later
"""The attributes of an object's mesh that a scene reads: exact where possible, else everything.

Reads by Python (scripts, functions of drivers) are not found. Hidden objects count.
"""

from dataclasses import dataclass, field

from ....cbt_terrain.attributes.attribute import GEOMETRY, PICTURE
from .drivers import read_drivers
from .found import ACTIVE_COLOR, ALL, Demand
from .geometry import Sources, is_enabled, read_modifier, read_particles, sets_material_index
from .materials import ENGINES, WORKBENCH, Shading, read_material, read_rays, read_workbench, shading_of, used_slots
from .screens import read_screens

RENDER = "RENDER"
# What file formats export in addition to UVs and normals, which every mesh has.
EXPORTS = {"ply": ALL, "usd": ALL, "abc": ACTIVE_COLOR, "obj": ACTIVE_COLOR, "gltf": ACTIVE_COLOR, "fbx": ACTIVE_COLOR}
NOTHING_EXPORTED = ("stl",)


@dataclass
class _Scene:
    """The state of one search. `holding`: objects that have the mesh or geometry made from it."""

    found: Demand
    terrain: object
    objects: list
    render: bool
    shading: Shading
    holding: set
    materials: set = field(default_factory=set)

    def modifiers_of(self, obj) -> list:
        """Return the modifiers of an object that are on in this mode."""
        return [modifier for modifier in getattr(obj, "modifiers", ()) if is_enabled(modifier, self.render)]

    def words(self, obj, modifier) -> str:
        """Return the name of a modifier for the user, with its object unless that is the terrain."""
        return f"{'' if obj == self.terrain else f'object {obj.name}, '}modifier {modifier.name}"


def find_demand(obj, depsgraph, mode: str = RENDER, exports: tuple[str, ...] = ()) -> Demand:
    """Return the attributes of the mesh of `obj` that a scene reads, with their readers.

    Names are those of attributes, or special ones of found.py.

    Args:
        depsgraph: the scene's dependency graph.
        mode: "RENDER" or "VIEWPORT", which differ in modifiers, view layers and windows.
        exports: extensions of the files to export.
    """
    scene, render = depsgraph.scene.original, mode == RENDER
    layers = [layer for layer in scene.view_layers if layer.use or not render]
    shown = _all_objects(scene)
    holding = {other for other in shown if other.data == obj.data} | {obj}
    search = _Scene(Demand(), obj, shown, render, shading_of(scene, layers, preview=not render), holding)
    found = search.found
    _read_engine(found, scene, render)
    if not render:
        read_screens(found)
    for holder in list(holding):
        _read_holder(search, holder)
    _read_users(search)
    materials = _with_overrides(search.materials, layers)
    for material in materials:
        read_material(found, material, search.shading)
    read_rays(found, materials, search.shading)
    read_drivers(found, obj, shown, scene)
    for extension in exports:
        if extension not in NOTHING_EXPORTED:
            found.add(EXPORTS.get(extension, ALL), f"export of {extension}", GEOMETRY)
    return found


def _all_objects(scene) -> list:
    """Return the objects of a scene, of its background sets and of instanced collections."""
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
    """Add the reads of the render engine: of Workbench by its settings, of an unknown engine all attributes."""
    engine = scene.render.engine
    if engine == WORKBENCH:
        if render:
            read_workbench(found, scene.display.shading, "Workbench")
    elif engine not in ENGINES:
        found.add(ALL, f"render engine {engine} (unknown what it reads)", PICTURE)


def _read_holder(scene: _Scene, obj) -> None:
    """Add the reads of an object that has the terrain's mesh: of its modifiers and particles; note its materials."""
    modifiers = scene.modifiers_of(obj)
    for modifier in modifiers:
        words = scene.words(obj, modifier)
        sources = read_modifier(scene.found, modifier, words, scene.shading.trees, viewers=not scene.render)
        _add_materials(scene, sources)
    slots = range(len(obj.material_slots)) if any(map(sets_material_index, modifiers)) else used_slots(obj)
    numbers = set(slots)
    for system in obj.particle_systems:
        numbers.add(system.settings.material - 1)
        read_particles(scene.found, system, "" if obj == scene.terrain else f"object {obj.name}, ")
    scene.materials |= {obj.material_slots[n].material for n in numbers if 0 <= n < len(obj.material_slots)}


def _read_users(scene: _Scene) -> None:
    """Add the reads of objects whose modifiers use the terrain's geometry, directly or through other objects."""
    waiting = []
    for obj in scene.objects:
        if obj not in scene.holding:
            for modifier in scene.modifiers_of(obj):
                found = Demand()
                sources = read_modifier(found, modifier, scene.words(obj, modifier), scene.shading.trees)
                waiting.append((obj, modifier, found, sources))
    read = True
    while read:
        # every modifier of a new holder counts: later modifiers also see the geometry
        read = [item for item in waiting if item[0] in scene.holding or item[3].all_objects() & scene.holding]
        waiting = [item for item in waiting if item not in read]
        for obj, modifier, found, sources in read:
            scene.found.merge(found)
            if modifier.type == "DATA_TRANSFER" and sources.objects & scene.holding:
                words = f"{scene.words(obj, modifier)} (it transfers data layers)"
                scene.found.add(ALL, words, GEOMETRY)
            if modifier.type in ("NODES", "BOOLEAN"):
                scene.holding.add(obj)
                scene.materials |= {slot.material for slot in obj.material_slots}
                _add_materials(scene, sources)


def _add_materials(scene: _Scene, sources: Sources) -> None:
    """Add materials to search: those that a modifier sets, and those of its source objects.

    These are instanced, and instances read attributes of their points.
    """
    scene.materials |= sources.materials
    scene.materials |= {s.material for o in sources.all_objects() - scene.holding for s in o.material_slots}


def _with_overrides(materials: set, layers: list) -> set:
    """Return the materials that are shown: material overrides of view layers replace them."""
    overrides = {layer.material_override for layer in layers} or {None}
    return (overrides if None not in overrides else materials | overrides) - {None}
