# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that each node type reads, and the materials, objects and collections that it receives.

A function `_read_TYPE(walk, node, output, context)` serves one type of node. `walk` is the NodeWalk that the reads are
added to, `output` the output that is used, `context` the enclosing group nodes, the innermost last.
"""

import bpy

from .found import ACTIVE_COLOR, ACTIVE_UV, ALL

POINTERS = {
    "MATERIAL": (bpy.types.Material, "materials"),
    "OBJECT": (bpy.types.Object, "objects"),
    "COLLECTION": (bpy.types.Collection, "collections"),
}


def note_reads(walk, node, output, context: tuple) -> None:
    """Add to a walk the attributes that a node reads for one of its outputs, and data-blocks that a geometry node gets.

    context: enclosing group nodes, the innermost last.
    """
    note = NOTING.get(node.bl_idname)
    if note is not None:
        note(walk, node, output, context)
    if node.bl_idname.startswith("GeometryNode"):
        _collect_sources(walk, node, context)


def _read_attribute(walk, node, _output, context):
    """Add the attribute that an Attribute node names."""
    if node.attribute_name and node.attribute_type == "GEOMETRY":
        walk.read(node.attribute_name, node, context)
    elif node.attribute_name and node.attribute_type == "INSTANCER":
        walk.read(node.attribute_name, node, context, "of an instancer, which may be the terrain")


def _read_colour(walk, node, _output, context):
    """Add the attribute of a Color Attribute node."""
    walk.read(node.layer_name or ACTIVE_COLOR, node, context)


def _read_uv_map(walk, node, _output, context):
    """Add the UV map of a UV Map node."""
    walk.read(node.uv_map or ACTIVE_UV, node, context)


def _read_normal_map(walk, node, _output, context):
    """Add the UV map that a Normal Map node needs for tangents."""
    if node.space == "TANGENT":
        walk.read(node.uv_map or ACTIVE_UV, node, context, "tangent")


def _read_tangent(walk, node, _output, context):
    """Add the UV map that a Tangent node needs."""
    if node.direction_type == "UV_MAP":
        walk.read(node.uv_map or ACTIVE_UV, node, context, "tangent")


def _read_coordinates(walk, node, output, context):
    """Add the active UV map if a Texture Coordinate node's UV is used."""
    if output.name == "UV":
        walk.read(ACTIVE_UV, node, context)


def _read_image(walk, node, _output, context):
    """Add the active UV map for an Image Texture without a linked vector."""
    if not walk.feeding(node.inputs["Vector"]):  # other textures take generated coordinates then
        walk.read(ACTIVE_UV, node, context, "unlinked vector")


def _read_script(walk, node, _output, context):
    """Add all attributes for an OSL script, which may read any."""
    if walk.osl:
        walk.read(ALL, node, context, "an OSL script may read any attribute")


def _read_raycast(walk, node, _output, context):
    """Add the attributes that a Raycast node samples where its rays hit."""
    for item in node.sample_attribute_items:
        if item.name:
            walk.read(item.name, node, context, "sampled where its ray hits", at_hit=True)


def _read_point_density(walk, node, _output, context):
    """Add the vertex attribute of a Point Density node."""
    if node.vertex_attribute_name:
        walk.read(node.vertex_attribute_name, node, context, "of the object whose points it takes")


def _read_volume(walk, node, _output, context):
    """Add the attributes that a Principled Volume names."""
    for socket in node.inputs:
        if socket.type == "STRING":
            _read_input_name(walk, node, socket, context)


def _read_named_attribute(walk, node, _output, context):
    """Add the attribute that a Named Attribute node names."""
    _read_input_name(walk, node, node.inputs["Name"], context)


def _read_rename(walk, node, _output, context):
    """Add the attributes that a Rename Attribute node names, maybe by a pattern."""
    for socket in node.inputs:
        if socket.type == "STRING" and socket.name in ("Name", "Old"):
            _read_input_name(walk, node, socket, context, pattern=True)


def _read_everything(why: str):
    """Return a function that adds all attributes for a node, with a reason for the user."""
    return lambda walk, node, _output, context: walk.read(ALL, node, context, why)


def _read_input_name(walk, node, socket, context, pattern: bool = False) -> None:
    """Add the attribute that a text input names; all if the name is computed.

    pattern: the name may contain `*`.
    """
    name = walk.constant(node, socket, context)
    if name is None:
        walk.read(ALL, node, context, f"its {socket.name} is computed")
    elif pattern and "*" in name:
        walk.read(ALL, node, context, "a pattern of names")
    elif name:
        walk.read(name, node, context)


def _collect_sources(walk, node, context) -> None:
    """Add the materials, objects and collections of a node's inputs to a walk.

    Links, switches and menus may pass those of the enclosing groups and of the modifier to any input, so these
    count, too.
    """
    for name in ("material", "object", "collection"):  # properties of a node that has a data-block as its value
        if isinstance(value := getattr(node, name, None), bpy.types.ID):
            getattr(walk, name + "s").add(value)
    for socket in node.inputs:
        if socket.type not in POINTERS:
            continue
        kind, name = POINTERS[socket.type]
        of_groups = [other for group in context for other in group.inputs if other.type == socket.type]
        values = [getattr(other, "default_value", None) for other in [socket, *of_groups]]
        getattr(walk, name).update(value for value in [*values, *walk.values.values()] if isinstance(value, kind))


NOTING = {
    "ShaderNodeAttribute": _read_attribute,
    "ShaderNodeVertexColor": _read_colour,
    "ShaderNodeUVMap": _read_uv_map,
    "ShaderNodeNormalMap": _read_normal_map,
    "ShaderNodeTangent": _read_tangent,
    "ShaderNodeTexCoord": _read_coordinates,
    "ShaderNodeTexImage": _read_image,
    "ShaderNodeScript": _read_script,
    "ShaderNodeRaycast": _read_raycast,
    "ShaderNodeTexPointDensity": _read_point_density,
    "ShaderNodeVolumePrincipled": _read_volume,
    "GeometryNodeInputNamedAttribute": _read_named_attribute,
    "GeometryNodeRenameAttribute": _read_rename,
    "GeometryNodeGetAttributeNames": _read_everything("it lists every attribute's name"),
    "GeometryNodeTransferAttributes": _read_everything("it transfers attributes by a filter"),
    "GeometryNodeXPBDSolver": _read_everything("the solver chooses attributes by name"),
}
