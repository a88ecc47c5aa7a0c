# SPDX-License-Identifier: GPL-3.0-or-later
"""Node trees written as expressions."""

import bpy


def marked_group_node(material, mark: str):
    """Return the first group node of a material whose tree has the property `mark`; None without one, and for None."""
    nodes = material.node_tree.nodes if material is not None and material.node_tree else ()
    return next((node for node in nodes if node.type == "GROUP" and node.node_tree and mark in node.node_tree), None)


def first_node(tree, kind: str):
    """Return the first node of a tree of the type `kind`, as ShaderNodeBackground.

    Names differ by language: Blender translates those of new nodes.
    """
    return next(node for node in tree.nodes if node.bl_idname == kind)


class Nodes:
    """Methods that add a node to the tree and return its output (`add`: the node), and one that arranges all nodes."""

    def __init__(self, tree):
        self.tree = tree

    def add(self, kind: str, inputs: dict | None = None, **settings):
        """Add a node with settings; set its inputs (by name or index) to values or link them to sockets; return it."""
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        for name, value in (inputs or {}).items():
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, node.inputs[name])
            else:
                node.inputs[name].default_value = value
        return node

    def math(self, operation: str, *values):
        """Add a math node with sockets or numbers as inputs; return its output."""
        return self.add("ShaderNodeMath", dict(enumerate(values)), operation=operation).outputs[0]

    def vector(self, operation: str, *values):
        """Add a vector math node; return its output, a number if the operation gives one."""
        node = self.add("ShaderNodeVectorMath", dict(enumerate(values)), operation=operation)
        return node.outputs["Value" if operation in ("DOT_PRODUCT", "LENGTH", "DISTANCE") else "Vector"]

    def scaled(self, vector, factor):
        """Add a node that multiplies a vector by a number; return its output."""
        return self.add("ShaderNodeVectorMath", {0: vector, "Scale": factor}, operation="SCALE").outputs[0]

    def mix(self, factor, a, b):
        """Add a node that mixes two colours, `a` at factor 0 and `b` at 1; return its output."""
        node = self.add("ShaderNodeMix", data_type="RGBA", clamp_factor=True)
        colours = node.inputs[6], node.inputs[7]  # A and B; the node has further inputs of other types
        for socket, value in zip((node.inputs[0], *colours), (factor, a, b), strict=True):
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, socket)
            else:
                socket.default_value = value
        return node.outputs[2]

    def arrange(self) -> None:
        """Arrange the nodes in columns, each to the right of the nodes that feed it. The tree has no cycle."""
        column: dict = {}  # number of the column by node
        pending = list(self.tree.nodes)
        feeds = {node: {link.from_node for link in self.tree.links if link.to_node == node} for node in pending}
        while pending:
            ready = [node for node in pending if feeds[node] <= column.keys()]
            for node in ready:
                column[node] = 1 + max((column[before] for before in feeds[node]), default=-1)
            pending = [node for node in pending if node not in column]
        filled: dict[int, int] = {}  # number of placed nodes by column
        for node, number in column.items():
            node.location = 200.0 * number, -180.0 * filled.get(number, 0)
            filled[number] = filled.get(number, 0) + 1
