# SPDX-License-Identifier: GPL-3.0-or-later
"""Haze over a terrain, as a node group before the output of its materials.

A volume of that size would be noisy and slow. The group instead computes how much haze lies between the camera and a
point, from air whose density falls by e for each `Height`, and mixes the haze's light into the camera's rays.
Reflections and indirect light stay as they are.
"""

import math

import bpy

from ..bridge.nodes import Nodes, marked_group_node
from ..layers.material import copy_material, shows_layers
from ..terrain import sight

GROUP = "Terrain Haze"
MARK = "adaptive_terrain_haze"  # a property of the group, by which it is found under any name
SHADER, COLOR, DISTANCE, BASE, HEIGHT = "Shader", "Color", "Distance", "Base", "Height"
MIN_HEIGHT = 0.05  # of the terrain's longer side: flat land has haze above it, too
THIN = 1e-3  # difference of heights, in scale heights, below which the density is that of one height


def set_haze(obj, amount: float, color) -> None:
    """Give the terrain's own material haze that hides `amount` of the light of ground as far away as it is long.

    Water and plants that have haze already get the same; materials of other terrains and of the user stay. amount: from
    0, which removes the haze, to less than 1. color: linear RGB. DISTANCE is the one at which haze of constant density
    leaves 1 / e of the ground's light. Raises TerrainError without a store.
    """
    box = sight.box_of(obj)
    sides, low = box.max(axis=0) - box.min(axis=0), float(box[:, 2].min())
    side = float(max(sides[:2]))
    others = {other for other in bpy.data.materials if marked_group_node(other, MARK) and not shows_layers(other)}
    values = {
        COLOR: (*color, 1.0),
        DISTANCE: -side / math.log(1.0 - amount) if amount > 0.0 else 0.0,
        BASE: low,
        HEIGHT: max(float(sides[2]), MIN_HEIGHT * side),
    }
    for material in others | {slot.material for slot in obj.material_slots if shows_layers(slot.material)}:
        _apply(material, values)


def join_haze(material) -> None:
    """Give a new material the haze that another material of the file has, if there is one."""
    for other in bpy.data.materials:
        if other is not material and (node := marked_group_node(other, MARK)) is not None:
            values = {name: node.inputs[name].default_value for name in (DISTANCE, BASE, HEIGHT)}
            _apply(material, values | {COLOR: tuple(node.inputs[COLOR].default_value)})
            return


def without_haze(material):
    """Return a copy of a material without its haze; the material itself if it has none, and None for None.

    Exporters take the haze for light of the surface. The haze also dilutes colors that are baked into an image.
    """
    if marked_group_node(material, MARK) is None:
        return material
    copied = copy_material(material)
    copied.name = f"{material.name} without haze"
    _remove(copied.node_tree, marked_group_node(copied, MARK))
    return copied


def _apply(material, values: dict) -> None:
    """Set the values of a material's haze; add it if it is missing. A DISTANCE of 0 removes it.

    values: by COLOR, DISTANCE, BASE and HEIGHT. A linked material and one without a surface stay as they are.
    """
    if material.library is not None:
        return
    tree, node = material.node_tree, marked_group_node(material, MARK)
    output = tree.get_output_node("ALL")
    if node is None and output is not None and output.inputs["Surface"].is_linked and values[DISTANCE] > 0.0:
        node = Nodes(tree).add("ShaderNodeGroup", node_tree=haze_group())
        surface = output.inputs["Surface"].links[0]
        node.location, output.location.x = output.location, output.location.x + 200.0
        tree.links.new(surface.from_socket, node.inputs[SHADER])
        tree.links.new(node.outputs[0], output.inputs["Surface"])
        material.cycles.emission_sampling = "NONE"  # the haze lights nothing
    if node is None:
        return
    if values[DISTANCE] > 0.0:
        for name, value in values.items():
            node.inputs[name].default_value = value
        return
    _remove(tree, node)


def _remove(tree, node) -> None:
    """Remove the haze's node from a material's tree; the surface before it takes its place."""
    for link in node.outputs[0].links if node.inputs[SHADER].is_linked else ():
        tree.links.new(node.inputs[SHADER].links[0].from_socket, link.to_socket)
    tree.nodes.remove(node)


def haze_group() -> bpy.types.NodeTree:
    """Return the node group of the haze, by its MARK; it is built if the file has none, or only a linked one."""
    for group in bpy.data.node_groups:
        if MARK in group and group.library is None:
            return group
    tree = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    tree[MARK] = True
    tree.interface.new_socket(SHADER, in_out="OUTPUT", socket_type="NodeSocketShader")
    tree.interface.new_socket(SHADER, in_out="INPUT", socket_type="NodeSocketShader")
    tree.interface.new_socket(COLOR, in_out="INPUT", socket_type="NodeSocketColor")
    for name in (DISTANCE, BASE, HEIGHT):
        socket = tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketFloat")
        socket.subtype, socket.default_value = "DISTANCE", {DISTANCE: 1e5, BASE: 0.0, HEIGHT: 2000.0}[name]
    n = Nodes(tree)
    group_inputs = n.add("NodeGroupInput").outputs
    geometry = n.add("ShaderNodeNewGeometry").outputs
    away = n.add("ShaderNodeCameraData").outputs["View Distance"]
    # Height of the point above the base, and of the camera above the point (rise), in scale heights.
    height = n.math("MAXIMUM", group_inputs[HEIGHT], 1e-6)
    above = n.math("SUBTRACT", _z(n, geometry["Position"]), group_inputs[BASE])
    point = n.math("DIVIDE", above, height)
    rise = n.math("DIVIDE", n.math("MULTIPLY", _z(n, geometry["Incoming"]), away), height)
    # Mean density along the line of sight: the integral of exp(-z) over a segment, by its length.
    # lower: height of the lower end of the segment; below the base the air is as dense as at the base.
    lower = n.math("MAXIMUM", n.math("MINIMUM", point, n.math("ADD", point, rise)), 0.0)
    span = n.math("MAXIMUM", n.math("ABSOLUTE", rise), THIN)
    mean = n.math("DIVIDE", n.math("SUBTRACT", 1.0, _decay(n, span)), span)
    density = n.math("MULTIPLY", mean, _decay(n, lower))
    # Optical depth: at full density, light falls by e for each Distance. hidden: the part of it that haze absorbs.
    depth = n.math("DIVIDE", n.math("MULTIPLY", density, away), n.math("MAXIMUM", group_inputs[DISTANCE], 1e-6))
    hidden = n.math("SUBTRACT", 1.0, _decay(n, depth))
    factor = n.math("MULTIPLY", hidden, n.add("ShaderNodeLightPath").outputs["Is Camera Ray"])
    haze = n.add("ShaderNodeEmission", {"Color": group_inputs[COLOR]}).outputs[0]
    mixed = n.add("ShaderNodeMixShader", {0: factor, 1: group_inputs[SHADER], 2: haze})
    n.add("NodeGroupOutput", {SHADER: mixed.outputs[0]})
    n.arrange()
    return tree


def _z(n: Nodes, vector):
    """Add a node that gives the z component of a vector; return its output socket."""
    return n.add("ShaderNodeSeparateXYZ", {0: vector}).outputs["Z"]


def _decay(n: Nodes, value):
    """Add nodes that compute exp(-value); return their output socket."""
    return n.math("EXPONENT", n.math("MULTIPLY", value, -1.0))
