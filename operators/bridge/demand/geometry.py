# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that modifiers, geometry nodes and particle systems read, and the objects whose geometry they use."""

import re
from dataclasses import dataclass, field
from functools import cache

import bpy

from ....cbt_terrain.attributes.attribute import GEOMETRY
from .found import ACTIVE_UV, VERTEX_GROUP, Demand
from .trees import Trees, animated_paths, nodes_inside
from .walk import NodeWalk


@dataclass
class Sources:
    """The inputs of a modifier: materials it may set, and objects and collections whose geometry it may use."""

    materials: set = field(default_factory=set)
    objects: set = field(default_factory=set)
    collections: set = field(default_factory=set)

    def all_objects(self) -> set:
        """Return the objects, including those of the collections."""
        return self.objects.union(*(collection.all_objects for collection in self.collections))


def is_enabled(modifier, render: bool) -> bool:
    """Return whether a modifier is on in a render or in a viewport; one with an animated switch counts as on."""
    switch = "show_render" if render else "show_viewport"
    return getattr(modifier, switch) or switch in "".join(_animated(modifier))


def read_modifier(found: Demand, modifier, label: str, trees: Trees, viewers: bool = False) -> Sources:
    """Add the attributes that one modifier reads to `found`, and return the data that it uses.

    It is read even if it is off. label: the modifier's name for the user. trees: node trees that were read before.
    viewers: viewer nodes count as outputs.
    """
    if modifier.type == "NODES":
        return _read_nodes(found, modifier, label, trees, viewers) if modifier.node_group else Sources()
    # Names of the properties that are texts, such as an attribute's name, and of those that refer to data-blocks.
    texts, pointers = _properties(type(modifier))
    for name in texts:
        if value := getattr(modifier, name):
            group = "vertex_group" in name or name.endswith("_weight")
            found.add(VERTEX_GROUP + value if group else value, f"{label}, {name}", GEOMETRY)
    by_uv = getattr(modifier, "texture_coords", "") == "UV" and not modifier.uv_layer
    masks_by_uv = getattr(modifier, "mask_tex_mapping", "") == "UV" and not modifier.mask_tex_uv_layer
    if by_uv or masks_by_uv:
        found.add(ACTIVE_UV, f"{label}, texture coordinates", GEOMETRY)
    values = (getattr(modifier, name) for name in pointers)
    return Sources(objects={value for value in values if isinstance(value, bpy.types.Object)})


def modifier_key(modifier) -> tuple:
    """Return a key of everything, except node trees, that `read_modifier` depends on."""
    shown = modifier.name, modifier.type, modifier.show_render, modifier.show_viewport
    if modifier.type != "NODES":
        texts, pointers = _properties(type(modifier))
        return *shown, *(str(getattr(modifier, name, "")) for name in (*texts, *pointers, *COORDINATES))
    if modifier.node_group is None:
        return shown
    values, attributes = _inputs(modifier)
    return *shown, modifier.node_group.session_uid, str(sorted(values.items())), *attributes


def sets_material_index(modifier) -> bool:
    """Return whether a modifier's nodes may give faces another material slot."""
    tree = modifier.node_group if modifier.type == "NODES" else None
    return tree is not None and any(node.bl_idname == "GeometryNodeSetMaterialIndex" for node in nodes_inside(tree))


def read_particles(found: Demand, system, label: str) -> None:
    """Add the attributes that a particle system reads of its emitter. label: start of the texts about the reader."""
    label = f"{label}particles {system.name}"
    texts = [p.identifier for p in system.bl_rna.properties if p.type == "STRING"]
    for name in texts:
        if name.startswith("vertex_group") and getattr(system, name):
            found.add(VERTEX_GROUP + getattr(system, name), f"{label}, {name}", GEOMETRY)
    for slot in system.settings.texture_slots:
        if slot and slot.texture_coords == "UV":
            found.add(slot.uv_layer or ACTIVE_UV, f"{label}, texture", GEOMETRY)
    found.add(ACTIVE_UV, f"{label} (hair takes the emitter's UV)", GEOMETRY)


def _read_nodes(found: Demand, modifier, label: str, trees: Trees, viewers: bool) -> Sources:
    """Add the attributes that a geometry-nodes modifier reads, and return the data that it uses.

    label: the modifier's name for the user. trees: node trees that were read before. viewers: viewer nodes count as
    outputs.
    """
    values, attributes = _inputs(modifier)
    for input_name, name in attributes:
        if name:
            found.add(name, f"{label}, input {input_name}", GEOMETRY)
    walk = NodeWalk(found, label, GEOMETRY, trees, values)
    for end in modifier.node_group.nodes:
        viewed = viewers and end.bl_idname == "GeometryNodeViewer" and not end.mute
        if viewed or end.bl_idname == "NodeGroupOutput" and end.is_active_output:
            for socket in end.inputs:
                walk.visit(end, socket)
    # Data-blocks that are inputs of the modifier count, whether or not a node uses them.
    materials, objects, collections = ({v for v in values.values() if isinstance(v, kind)} for kind in DATA_BLOCKS)
    return Sources(walk.materials | materials, walk.objects | objects, walk.collections | collections)


DATA_BLOCKS = bpy.types.Material, bpy.types.Object, bpy.types.Collection
COORDINATES = "texture_coords", "mask_tex_mapping"


def _inputs(modifier) -> tuple[dict, list[tuple[str, str]]]:
    """Return a geometry-nodes modifier's constant input values by identifier, and (input, attribute) names.

    Animated values are left out.
    """
    values, attributes = {}, []
    for item in modifier.node_group.interface.items_tree:
        if item.item_type != "SOCKET" or item.in_out != "INPUT":
            continue
        key = item.identifier
        if hasattr(modifier, "properties"):  # Blender 5.2
            entry = getattr(modifier.properties.inputs, key, None)
            if getattr(entry, "type", "VALUE") == "ATTRIBUTE":
                attributes.append((item.name, entry.attribute_name))
            elif entry is not None:
                values[key] = getattr(entry, "value", None)
        elif modifier.get(key + "_use_attribute"):
            attributes.append((item.name, modifier.get(key + "_attribute_name", "")))
        elif key in modifier:
            values[key] = modifier[key]
    # All words of the animated data paths: one of them is the identifier of the input.
    animated = {name for path in _animated(modifier) for name in re.findall(r"\w+", path)}
    return {key: value for key, value in values.items() if key not in animated}, attributes


def _animated(modifier) -> list[str]:
    """Return the animated data paths of a modifier, relative to it."""
    start = f'modifiers["{bpy.utils.escape_identifier(modifier.name)}"]'
    return [path[len(start) :] for path in animated_paths(modifier.id_data) if path.startswith(start)]


@cache
def _properties(kind: type) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of a modifier type's writable text properties and of its pointer properties."""
    properties = [p for p in kind.bl_rna.properties if p.identifier not in ("name", "rna_type")]
    texts = tuple(p.identifier for p in properties if p.type == "STRING" and not p.is_readonly)
    return texts, tuple(p.identifier for p in properties if p.type == "POINTER")
