# SPDX-License-Identifier: GPL-3.0-or-later
"""Random node trees that read attributes by name, and small scenes to see what they make of them."""

import bpy
import numpy as np
from demand_trees import NODES_ALWAYS, group, put

NAMES = [f"at{k}" for k in range(12)]
TYPES = {"FLOAT": (1, "value"), "FLOAT_COLOR": (4, "color"), "FLOAT_VECTOR": (3, "vector"), "BYTE_COLOR": (4, "color")}
SIDE = 9
FACTORS = 0.0, 1.0, 0.0, 1.0, 0.4


def square(name="T"):
    """Add a grid of SIDE x SIDE points to the scene."""
    across = np.linspace(-1, 1, SIDE)
    points = [(x, y, 0.2 * x * y) for y in across for x in across]
    corners = [(j * SIDE + i, j * SIDE + i + 1, (j + 1) * SIDE + i + 1, (j + 1) * SIDE + i)
               for j in range(SIDE - 1) for i in range(SIDE - 1)]  # fmt: skip
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], corners)
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def write(mesh, names) -> None:
    """Give the mesh those of NAMES, with values that are the same each time; take the others away."""
    for name in NAMES:
        if name in mesh.attributes:
            mesh.attributes.remove(mesh.attributes[name])
    kinds = list(TYPES)
    values = np.random.default_rng(5).random((len(NAMES), SIDE * SIDE, 4)).astype(np.float32)
    for name in names:
        number = NAMES.index(name)
        width, member = TYPES[kinds[number % 4]]
        attribute = mesh.attributes.new(name, kinds[number % 4], "POINT")
        attribute.data.foreach_set(member, np.ascontiguousarray(values[number, :, :width]).ravel())
    mesh.update()


def picture_scene():
    """Add a lit square below a camera, for Cycles at 24 x 24 pixels; return the object and its material."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.seed = 3
    scene.render.resolution_x = scene.render.resolution_y = 24
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    obj = square()
    camera = scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = 0.0, 0.0, 3.0
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.rotation_euler = 0.5, 0.3, 0.0
    for item in (camera, sun):
        scene.collection.objects.link(item)
    material = bpy.data.materials.new("M")
    if not NODES_ALWAYS:
        material.use_nodes = True
    obj.data.materials.append(material)
    return obj, material


def shader_tree(material, source, names) -> None:
    """Fill a material with groups, mixes by constant and other factors, muted nodes and links, loose ends."""
    tree, groups = material.node_tree, []
    tree.nodes.clear()
    for number in range(source.randint(0, 3)):
        groups.append(_shader_group(source, number, list(groups), names))
    pool = _colours(tree, source, names, groups)
    output, surface = tree.nodes.new("ShaderNodeOutputMaterial"), None
    for _ in range(source.randint(1, 3)):
        shader = _shader(tree, source, pool)
        if surface is not None:
            mix = tree.nodes.new("ShaderNodeMixShader")
            mix.inputs[0].default_value = source.choice([0.0, 1.0, 0.5])
            if source.random() < 0.2:
                tree.links.new(source.choice(pool), mix.inputs[0])
            tree.links.new(surface, mix.inputs[1])
            tree.links.new(shader, mix.inputs[2])
            shader = mix.outputs[0]
        surface = shader
    tree.links.new(surface, output.inputs["Surface"])
    if source.random() < 0.25:
        moved = tree.nodes.new("ShaderNodeDisplacement")
        moved.inputs["Scale"].default_value = 0.1
        tree.links.new(source.choice(pool), moved.inputs["Height"])
        tree.links.new(moved.outputs[0], output.inputs["Displacement"])


def _shader_group(source, number, groups, names):
    sockets = ("A", "Color"), ("B", "Color"), ("F", "Float")
    tree, given, end = group(f"G{number}", "ShaderNodeTree", sockets, [("X", "Color"), ("Y", "Color")])
    pool = _colours(tree, source, names, groups, [given.outputs[0], given.outputs[1]])
    mix = tree.nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    for origin, socket in ((given.outputs[2], 0), (source.choice(pool), 6), (source.choice(pool), 7)):
        tree.links.new(origin, mix.inputs[socket])
    tree.links.new(mix.outputs[2], end.inputs[0])
    tree.links.new(source.choice(pool), end.inputs[1])
    return tree


def _shader(tree, source, pool):
    if source.random() < 0.5:
        node = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(source.choice(pool), node.inputs[0])
        return node.outputs[0]
    node = tree.nodes.new("ShaderNodeBsdfPrincipled")
    node.inputs["Emission Strength"].default_value = source.choice([0.0, 0.0, 1.0])
    for name in ("Base Color", "Emission Color", *(["Roughness"] if source.random() < 0.3 else [])):
        tree.links.new(source.choice(pool), node.inputs[name])
    if source.random() < 0.4:
        bump = tree.nodes.new("ShaderNodeBump")
        tree.links.new(source.choice(pool), bump.inputs["Height"])
        tree.links.new(bump.outputs[0], node.inputs["Normal"])
    return node.outputs[0]


def _colours(tree, source, names, groups, pool=()):
    """Return sockets with colours; many are unused."""
    pool = list(pool)
    for _ in range(source.randint(4, 14)):
        node, outputs = _colour(tree, source, names, groups, pool)
        if source.random() < 0.08 and node.bl_idname not in ("ShaderNodeAttribute", "ShaderNodeVertexColor"):
            node.mute = True
        pool += outputs
    for link in tree.links:
        if source.random() < 0.05:
            link.is_muted = True
    return pool


def _colour(tree, source, names, groups, pool):
    kind, new = source.random(), tree.nodes.new
    link = tree.links.new
    if kind < 0.38 or not pool:
        if source.random() < 0.25:
            node = new("ShaderNodeVertexColor")
            node.layer_name = source.choice(names[1::2])
            return node, [node.outputs["Color"]]
        node = new("ShaderNodeAttribute")
        node.attribute_name = source.choice(names)
        return node, [node.outputs[source.choice(["Color", "Vector", "Fac"])]]
    if kind < 0.62:
        node = new("ShaderNodeMix")
        node.data_type = source.choice(["RGBA", "RGBA", "FLOAT", "VECTOR"])
        node.blend_type = source.choice(["MIX", "MIX", "ADD", "MULTIPLY", "OVERLAY"])
        node.clamp_factor = source.random() < 0.7
        first, second, out = {"FLOAT": (2, 3, 0), "VECTOR": (4, 5, 1), "RGBA": (6, 7, 2)}[node.data_type]
        node.inputs[0].default_value = source.choice(FACTORS)
        for socket, chance in ((0, 0.25), (first, 0.85), (second, 0.85)):
            if source.random() < chance:
                link(source.choice(pool), node.inputs[socket])
        return node, [node.outputs[out]]
    if kind < 0.75:
        node = new("ShaderNodeMath")
        node.operation = source.choice(["ADD", "MULTIPLY", "SINE", "MAXIMUM", "POWER"])
        for socket in range(2):
            if source.random() < 0.8:
                link(source.choice(pool), node.inputs[socket])
        return node, [node.outputs[0]]
    if kind < 0.82:
        node = new("NodeReroute")
        link(source.choice(pool), node.inputs[0])
        return node, [node.outputs[0]]
    if kind < 0.9 and groups:
        node = new("ShaderNodeGroup")
        node.node_tree = source.choice(groups)
        for socket in node.inputs:
            if source.random() < 0.7:
                link(source.choice(pool), socket)
            elif socket.type == "VALUE":
                socket.default_value = source.choice([0.0, 1.0, 0.5])
        return node, list(node.outputs)
    node = new("ShaderNodeTexNoise")
    node.inputs["Scale"].default_value = 3.0
    if source.random() < 0.5:
        link(source.choice(pool), node.inputs["Vector"])
    return node, [node.outputs[1]]


def geometry_scene():
    return square()


def geometry_tree(obj, source, names) -> None:
    """Give an object geometry nodes that move its points by attributes, by name, by text and by the modifier's name."""
    groups = []
    for number in range(source.randint(0, 3)):
        groups.append(_field_group(source, number, list(groups), names))
    sockets = [("Geometry", "Geometry")]
    tree, given, end = group("Main", "GeometryNodeTree", [*sockets, ("Name", "String")], sockets)
    pool = _fields(tree, source, names, groups, [], [given.outputs[1]])
    flow = given.outputs[0]
    for _ in range(source.randint(1, 3)):
        if source.random() < 0.3:
            node = tree.nodes.new("GeometryNodeStoreNamedAttribute")
            node.inputs["Name"].default_value = source.choice(names)
            value = next(socket for socket in node.inputs if socket.name == "Value" and socket.enabled)
            tree.links.new(source.choice(pool[-4:]), value)
        else:
            node, up = tree.nodes.new("GeometryNodeSetPosition"), tree.nodes.new("ShaderNodeCombineXYZ")
            tree.links.new(source.choice(pool[-4:]), up.inputs[2])
            tree.links.new(up.outputs[0], node.inputs["Offset"])
            if source.random() < 0.3:
                tree.links.new(source.choice(pool[-4:]), node.inputs["Selection"])
        node.mute = source.random() < 0.1
        tree.links.new(flow, node.inputs[0])
        flow = node.outputs[0]
    tree.links.new(flow, end.inputs[0])
    modifier = obj.modifiers.new("Nodes", "NODES")
    modifier.node_group = tree
    name = next(item.identifier for item in tree.interface.items_tree if item.name == "Name")
    put(modifier, name, source.choice(names))
    obj.update_tag()


def _field_group(source, number, groups, names):
    sockets = ("A", "Float"), ("F", "Float"), ("Name", "String")
    tree, given, end = group(f"F{number}", "GeometryNodeTree", sockets, [("X", "Float"), ("Y", "Float")])
    pool = _fields(tree, source, names, groups, [given.outputs[0]], [given.outputs[2]])
    for socket in end.inputs[:2]:
        tree.links.new(source.choice(pool[-3:]), socket)
    return tree


def _usable(sockets):
    return [s for s in sockets if s.enabled and s.type not in ("CUSTOM", "GEOMETRY", "STRING", "MENU")]


def _fields(tree, source, names, groups, pool, texts):
    """Return sockets with numbers."""
    for _ in range(source.randint(5, 12)):
        made = _field(tree, source, names, groups, pool, texts)
        if made is not None:
            node, output = made
            if source.random() < 0.08 and node.bl_idname != "GeometryNodeInputNamedAttribute":
                node.mute = True
            pool.append(output)
    return pool


def _field(tree, source, names, groups, pool, texts):
    kind, new, link = source.random(), tree.nodes.new, tree.links.new
    if kind < 0.4 or not pool:
        node = new("GeometryNodeInputNamedAttribute")
        if source.random() < 0.3:
            link(source.choice(texts), node.inputs[0])
        elif source.random() < 0.2:
            text = new("FunctionNodeInputString")
            text.string = source.choice(names)
            link(text.outputs[0], node.inputs[0])
        else:
            node.inputs[0].default_value = source.choice(names)
        return node, _usable(node.outputs)[0]
    if kind < 0.6:
        node = new("ShaderNodeMix")
        node.clamp_factor = source.random() < 0.5
        node.inputs[0].default_value = source.choice([0.0, 1.0, 0.4])
        for socket, chance in ((2, 0.85), (3, 0.85), (0, 0.2)):
            if source.random() < chance:
                link(source.choice(pool), node.inputs[socket])
        return node, node.outputs[0]
    if kind < 0.72:
        node = new("GeometryNodeSwitch")
        node.input_type = "FLOAT"
        switch, *sides = _usable(node.inputs)
        if source.random() < 0.5:
            switch.default_value = source.random() < 0.5
        else:
            link(source.choice(pool), switch)
        for side in sides:
            link(source.choice(pool), side)
        return node, _usable(node.outputs)[0]
    if kind < 0.85:
        node = new("ShaderNodeMath")
        node.operation = source.choice(["ADD", "MULTIPLY", "SINE"])
        for socket in range(2):
            if source.random() < 0.8:
                link(source.choice(pool), node.inputs[socket])
        return node, node.outputs[0]
    if not groups:
        return None
    node = new("GeometryNodeGroup")
    node.node_tree = source.choice(groups)
    for socket in node.inputs:
        if socket.type == "STRING":
            socket.default_value = source.choice(names)
        elif source.random() < 0.6:
            link(source.choice(pool), socket)
        else:
            socket.default_value = source.choice([0.0, 1.0])
    return node, source.choice(list(node.outputs))
