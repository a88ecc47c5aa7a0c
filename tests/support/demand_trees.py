# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes and node trees whose demand is known, for the bpy modules and the real program alike (no pytest)."""

import bpy

NODES_ALWAYS = bpy.app.version >= (5, 0)
EEVEE = "BLENDER_EEVEE_NEXT" if bpy.app.version < (5, 0) else "BLENDER_EEVEE"


def new_object(name="T", corners=((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))):
    """Add a polygon, by default a square, to the scene."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], [range(len(corners))])
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def new_material(name="M"):
    """Add a material whose node tree has only an output."""
    material = bpy.data.materials.new(name)
    if not NODES_ALWAYS:
        material.use_nodes = True
    material.node_tree.nodes.clear()
    material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    return material


def worn(engine="CYCLES"):
    """Open an empty file with an object that has a material; return the object, the node tree and its output node."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.render.engine = engine
    obj, material = new_object(), new_material()
    obj.data.materials.append(material)
    return obj, material.node_tree, material.node_tree.nodes[0]


def attribute(tree, name, kind="GEOMETRY"):
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name, node.attribute_type = name, kind
    return node


def colour(tree, name):
    return attribute(tree, name).outputs["Color"]


def emit(tree, socket, output):
    """Connect a socket's colour to the output."""
    node = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(socket, node.inputs["Color"])
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    return node


def shows(material, socket_of):
    """Connect the socket that `socket_of` adds to a material's tree to its output."""
    tree = material.node_tree
    emit(tree, socket_of(tree), next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial"))
    return material


def mix(tree, factor, first=None, second=None):
    """Add a mix of two colours."""
    node = tree.nodes.new("ShaderNodeMix")
    node.data_type, node.inputs[0].default_value = "RGBA", factor
    for socket, source in ((node.inputs[6], first), (node.inputs[7], second)):
        if source is not None:
            tree.links.new(source, socket)
    return node


def group(name, kind, inputs=(), outputs=()):
    """Add a node group with sockets (name, type); return the group, its input and its output node."""
    tree = bpy.data.node_groups.new(name, kind)
    for direction, sockets in (("INPUT", inputs), ("OUTPUT", outputs)):
        for label, socket in sockets:
            tree.interface.new_socket(label, in_out=direction, socket_type="NodeSocket" + socket)
    return tree, tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")


GIVEN = ("Name", "String"), ("F", "Float"), ("S", "Bool")


class Moved:
    """Geometry nodes that move an object's points: `offset` is the socket to feed, `given` the group's inputs."""

    def __init__(self, obj):
        sockets = [("Geometry", "Geometry")]
        self.tree, self.given, self.end = group("Moved", "GeometryNodeTree", [*sockets, *GIVEN], sockets)
        self.mover = self.tree.nodes.new("GeometryNodeSetPosition")
        self.tree.links.new(self.given.outputs[0], self.mover.inputs[0])
        self.tree.links.new(self.mover.outputs[0], self.end.inputs[0])
        self.offset = self.mover.inputs["Offset"]
        self.modifier = obj.modifiers.new("Nodes", "NODES")
        self.modifier.node_group = self.tree

    def named(self, name):
        """Add a node that reads an attribute."""
        node = self.tree.nodes.new("GeometryNodeInputNamedAttribute")
        node.inputs["Name"].default_value = name
        return node

    def compute_name(self, node):
        """Let the name of the attribute that a node reads be computed from the group's input."""
        join = self.tree.nodes.new("GeometryNodeStringJoin")
        self.tree.links.new(self.given.outputs["Name"], join.inputs[1])
        self.tree.links.new(join.outputs[0], node.inputs["Name"])

    def reads_computed(self):
        node = self.named("")
        self.compute_name(node)
        self.tree.links.new(node.outputs[0], self.offset)

    def reads(self, name):
        self.tree.links.new(self.named(name).outputs[0], self.offset)

    def put(self, label, value):
        """Set one of the modifier's inputs."""
        put(self.modifier, self._key(label), value)

    def put_attribute(self, label, name):
        """Let one of the modifier's inputs take an attribute."""
        key = self._key(label)
        if hasattr(self.modifier, "properties"):
            held = getattr(self.modifier.properties.inputs, key)
            held.type, held.attribute_name = "ATTRIBUTE", name
        else:
            self.modifier[key + "_use_attribute"], self.modifier[key + "_attribute_name"] = True, name

    def _key(self, label):
        return next(item.identifier for item in self.tree.interface.items_tree if item.name == label)


def put(modifier, key, value):
    if hasattr(modifier, "properties"):
        getattr(modifier.properties.inputs, key).value = value
    else:
        modifier[key] = value


def enabled(sockets):
    return [socket for socket in sockets if socket.enabled]
