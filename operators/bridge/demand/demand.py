# SPDX-License-Identifier: GPL-3.0-or-later
"""The attributes of an object's mesh that a scene reads: exact where possible, else everything.

Reads by Python (scripts, functions of drivers) are not found. Hidden objects count. Each name in a Demand has its
readers; an attribute that pixels show has the family PICTURE, one from which geometry is made GEOMETRY. A function adds
what it finds to the Demand `found` or to the _Search `search`.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

from ....cbt_terrain.attributes.attribute import GEOMETRY, PICTURE
from .drivers import read_drivers
from .found import ALL, Demand
from .geometry import Sources, is_enabled, read_modifier, read_particles, sets_material_index
from .materials import ENGINES, WORKBENCH, Shading, read_material, read_rays, read_workbench, shading_of, used_slots
from .screens import read_screens

RENDER = "RENDER"


@dataclass
class _Search:
    """The state of one search.

    Attributes:
        found: the demand to add to.
        terrain: the object whose mesh is read.
        objects: all objects of the scene.
        render: whether render settings count, otherwise those of viewports.
        shading: how the scene shows materials, with the node trees read so far.
        holding: objects that have the mesh or geometry made from it.
        materials: materials that may show the mesh, to be read last.
    """

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

    def label_of(self, obj, modifier) -> str:
        """Return the name of a modifier for the user, with its object unless that is the terrain."""
        return f"{'' if obj == self.terrain else f'object {obj.name}, '}modifier {modifier.name}"


def find_demand(obj, depsgraph, mode: str = RENDER) -> Demand:
    """Return the attributes of the mesh of `obj` that a scene reads, with their readers.

    Names are those of attributes, or stand for all of them, for the active colour or UV map, or for a vertex group.

    Args:
        depsgraph: the scene's dependency graph.
        mode: "RENDER" or "VIEWPORT", which differ in modifiers, view layers and windows.
    """
    scene, render = depsgraph.scene.original, mode == RENDER
    layers = [layer for layer in scene.view_layers if layer.use or not render]
    shown = _all_objects(scene)
    holding = {other for other in shown if other.data == obj.data} | {obj}  # objects with the terrain's mesh
    shading = shading_of(scene, layers, preview=not render)  # how the scene shows materials
    search = _Search(Demand(), terrain=obj, objects=shown, render=render, shading=shading, holding=holding)
    found = search.found  # the calls below add to it, and to the objects and materials of `search`
    _read_engine(found, scene, render)
    if not render:
        read_screens(found)
    for holder in list(holding):  # a copy, since more objects may be found that hold geometry made from the mesh
        _read_holder(search, holder)
    _read_users(search)
    materials = _with_overrides(search.materials, layers)
    for material in materials:
        read_material(found, material, search.shading)
    read_rays(found, materials, search.shading)  # of other shaders, whose rays hit the mesh
    read_drivers(found, obj, shown, scene)
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
    """Add the reads of the render engine: of Workbench by its settings, of an unknown engine all attributes.

    Outside of renders Workbench draws viewports, which `read_screens` reads.
    """
    engine = scene.render.engine
    if engine == WORKBENCH:
        if render:
            read_workbench(found, scene.display.shading, "Workbench")
    elif engine not in ENGINES:
        found.add(ALL, f"render engine {engine} (unknown what it reads)", PICTURE)


def _read_holder(search: _Search, obj) -> None:
    """Add the reads of an object that has the terrain's mesh: of its modifiers and particles; note its materials.

    Materials are read later. `sources`: materials that a modifier sets, and objects whose geometry it uses.
    """
    modifiers = search.modifiers_of(obj)
    for modifier in modifiers:
        label = search.label_of(obj, modifier)
        sources = read_modifier(search.found, modifier, label, search.shading.trees, viewers=not search.render)
        _add_materials(search, sources)
    # Nodes that set the material index may put any slot on faces.
    slots = range(len(obj.material_slots)) if any(map(sets_material_index, modifiers)) else used_slots(obj)
    numbers = set(slots)
    for system in obj.particle_systems:
        numbers.add(system.settings.material - 1)  # which counts from 1
        read_particles(search.found, system, "" if obj == search.terrain else f"object {obj.name}, ")
    search.materials |= {obj.material_slots[n].material for n in numbers if 0 <= n < len(obj.material_slots)}


class _Waiting(NamedTuple):
    """A modifier that counts once it uses an object with the terrain's geometry; `found`: the attributes it reads."""

    obj: object
    modifier: object
    found: Demand
    sources: Sources

    def uses_one_of(self, holding: set) -> bool:
        """Return whether the modifier uses one of some objects, or is of one: later ones also see its geometry."""
        return self.obj in holding or bool(self.sources.all_objects() & holding)


def _read_users(search: _Search) -> None:
    """Add the reads of objects whose modifiers use the terrain's geometry, directly or through other objects."""
    waiting = []
    for obj in search.objects:
        if obj not in search.holding:
            for modifier in search.modifiers_of(obj):
                found = Demand()
                sources = read_modifier(found, modifier, search.label_of(obj, modifier), search.shading.trees)
                waiting.append(_Waiting(obj, modifier, found, sources))
    while read := [item for item in waiting if item.uses_one_of(search.holding)]:
        waiting = [item for item in waiting if item not in read]
        for obj, modifier, found, sources in read:
            search.found.merge(found)
            if modifier.type == "DATA_TRANSFER" and sources.objects & search.holding:
                label = f"{search.label_of(obj, modifier)} (it transfers data layers)"
                search.found.add(ALL, label, GEOMETRY)
            if modifier.type in ("NODES", "BOOLEAN"):  # these put the used geometry into the object's own
                search.holding.add(obj)
                search.materials |= {slot.material for slot in obj.material_slots}
                _add_materials(search, sources)


def _add_materials(search: _Search, sources: Sources) -> None:
    """Add materials to search: those that a modifier sets, and those of its source objects.

    Materials of instanced objects read attributes of the instances' points. Those of objects with the terrain's
    geometry are added with these objects.
    """
    search.materials |= sources.materials
    search.materials |= {s.material for o in sources.all_objects() - search.holding for s in o.material_slots}


def _with_overrides(materials: set, layers: list) -> set:
    """Return the materials that view layers show: their overrides, and `materials` if a layer has no override.

    None, which stands for an empty slot, is left out.
    """
    overrides = {layer.material_override for layer in layers} or {None}
    return (overrides if None not in overrides else materials | overrides) - {None}
