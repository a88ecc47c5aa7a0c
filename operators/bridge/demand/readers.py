# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that each node type reads, and the materials, objects and collections that it receives."""

import bpy

from .found import ACTIVE_COLOR, ACTIVE_UV, ALL

POINTERS = {
    "MATERIAL": (bpy.types.Material, "materials"),
    "OBJECT": (bpy.types.Object, "objects"),
    "COLLECTION": (bpy.types.Collection, "collections"),
}


def note_reads(walk, node, output, context: tuple) -> None:
    """Note the attributes that a node reads for one of its outputs."""
    note = NOTING.get(node.bl_idname)
    if note is not None:
        note(walk, node, output, context)
    if node.bl_idname.startswith("GeometryNode"):
        _take_in(walk, node, context)


def _attribute(walk, node, _output, context):
    if node.attribute_name and node.attribute_type == "GEOMETRY":
        walk.read(node.attribute_name, node, context)
    elif node.attribute_name and node.attribute_type == "INSTANCER":
        walk.read(node.attribute_name, node, context, "of an instancer, which may be the terrain")


def _colour(walk, node, _output, context):
    walk.read(node.layer_name or ACTIVE_COLOR, node, context)


def _uv_map(walk, node, _output, context):
    walk.read(node.uv_map or ACTIVE_UV, node, context)


def _normal_map(walk, node, _output, context):
    if node.space == "TANGENT":
        walk.read(node.uv_map or ACTIVE_UV, node, context, "tangent")


def _tangent(walk, node, _output, context):
    if node.direction_type == "UV_MAP":
        walk.read(node.uv_map or ACTIVE_UV, node, context, "tangent")


def _coordinates(walk, node, output, context):
    if output.name == "UV":
        walk.read(ACTIVE_UV, node, context)


def _image(walk, node, _output, context):
    if not walk.feeding(node.inputs["Vector"]):  # other textures take generated coordinates then
        walk.read(ACTIVE_UV, node, context, "unlinked vector")


def _script(walk, node, _output, context):
    if walk.osl:
        walk.read(ALL, node, context, "an OSL script may read any attribute")


def _raycast(walk, node, _output, context):
    for item in node.sample_attribute_items:
        if item.name:
            walk.read(item.name, node, context, HIT)


def _point_density(walk, node, _output, context):
    if node.vertex_attribute_name:
        walk.read(node.vertex_attribute_name, node, context, "of the object whose points it takes")


def _volume(walk, node, _output, context):
    for socket in node.inputs:
        if socket.type == "STRING":
            _named(walk, node, socket, context)


def _named_attribute(walk, node, _output, context):
    _named(walk, node, node.inputs["Name"], context)


def _rename(walk, node, _output, context):
    for socket in node.inputs:
        if socket.type == "STRING" and socket.name in ("Name", "Old"):
            _named(walk, node, socket, context, pattern=True)


def _everything(why: str):
    return lambda walk, node, _output, context: walk.read(ALL, node, context, why)


def _named(walk, node, socket, context, pattern: bool = False) -> None:
    """Note the attribute that an input names."""
    name = walk.constant(node, socket, context)
    if name is None:
        walk.read(ALL, node, context, f"its {socket.name} is computed")
    elif pattern and "*" in name:
        walk.read(ALL, node, context, "a pattern of names")
    elif name:
        walk.read(name, node, context)


def _take_in(walk, node, context) -> None:
    """Collect the materials, objects and collections of a node's inputs.

    Links, switches and menus may pass those of the enclosing groups and of the modifier to any input.
    """
    for name in ("material", "object", "collection"):  # a node that is a value
        if isinstance(value := getattr(node, name, None), bpy.types.ID):
            getattr(walk, name + "s").add(value)
    for socket in node.inputs:
        if socket.type not in POINTERS:
            continue
        kind, name = POINTERS[socket.type]
        around = [other for group in context for other in group.inputs if other.type == socket.type]
        values = [getattr(other, "default_value", None) for other in [socket, *around]]
        getattr(walk, name).update(value for value in [*values, *walk.values.values()] if isinstance(value, kind))


HIT = "sampled where its ray hits"
NOTING = {
    "ShaderNodeAttribute": _attribute,
    "ShaderNodeVertexColor": _colour,
    "ShaderNodeUVMap": _uv_map,
    "ShaderNodeNormalMap": _normal_map,
    "ShaderNodeTangent": _tangent,
    "ShaderNodeTexCoord": _coordinates,
    "ShaderNodeTexImage": _image,
    "ShaderNodeScript": _script,
    "ShaderNodeRaycast": _raycast,
    "ShaderNodeTexPointDensity": _point_density,
    "ShaderNodeVolumePrincipled": _volume,
    "GeometryNodeInputNamedAttribute": _named_attribute,
    "GeometryNodeRenameAttribute": _rename,
    "GeometryNodeGetAttributeNames": _everything("it lists every attribute's name"),
    "GeometryNodeTransferAttributes": _everything("it transfers attributes by a filter"),
    "GeometryNodeXPBDSolver": _everything("the solver chooses attributes by name"),
}
