# SPDX-License-Identifier: GPL-3.0-or-later
"""Links and animation of node trees, as a walk needs them."""

import re
from dataclasses import dataclass, field

import bpy

# An animated property of a node: its name, and the number of the input whose value it is, if it is one.
PATH = re.compile(r'nodes\["((?:[^"\\]|\\.)*)"\](?:\.inputs\[(\d+)\]\.default_value)?')


@dataclass
class Trees:
    """Node trees read so far, by pointers of nodes and sockets, which stay valid until an edit.

    Attributes:
        read: pointers of these trees.
        feeding: (node, output) of the valid, unmuted links to an input, by the input's pointer.
        varied: inputs with an animated or driven value.
        altered: nodes with any other animated property, of which nothing is known.
    """

    read: set[int] = field(default_factory=set)
    feeding: dict[int, list[tuple]] = field(default_factory=dict)
    varied: set[int] = field(default_factory=set)
    altered: set[int] = field(default_factory=set)

    def add(self, tree) -> None:
        """Read the links and the animation of a node tree, unless it was read before.

        An input whose value is animated goes to `varied`, a node with any other animated setting to `altered`.
        """
        if tree.as_pointer() in self.read:
            return
        self.read.add(tree.as_pointer())
        for link in tree.links:
            if link.is_valid and not link.is_muted:
                self.feeding.setdefault(link.to_socket.as_pointer(), []).append((link.from_node, link.from_socket))
        for path in animated_paths(tree):
            match = PATH.match(path)  # [1]: the node's name with escapes, [2]: the number of its input
            node = match and tree.nodes.get(match[1].replace('\\"', '"').replace("\\\\", "\\"))
            if not node:
                continue
            if match[2] is not None and int(match[2]) < len(node.inputs):
                self.varied.add(node.inputs[int(match[2])].as_pointer())
            else:
                self.altered.add(node.as_pointer())


def animated_paths(block) -> list[str]:
    """Return the data paths of a data-block that drivers, its action or its strips change."""
    data = block.animation_data
    if not data:
        return []
    actions = [data.action, *(strip.action for track in data.nla_tracks for strip in track.strips)]
    curves = list(data.drivers)
    for action in actions:
        if action is not None:
            curves += _curves_of(action)
    return [curve.data_path for curve in curves]


def _curves_of(action) -> list:
    """Return the curves of all slots of an action; `action.fcurves` lists only the first in Blender 4.4 and 4.5,
    none in 5.0.
    """
    if len(getattr(action, "layers", ())):
        bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
        return [curve for bag in bags for curve in bag.fcurves]
    return list(getattr(action, "fcurves", ()))


def tree_of_new(block):
    """Return the node tree of a new material or world, which Blender before 5.0 creates only on request."""
    if bpy.app.version < (5, 0):
        block.use_nodes = True
    return block.node_tree


def nodes_inside(tree, seen: set[int] | None = None):
    """Yield every node of a tree and of its groups, each group once. seen: pointers of trees that were visited."""
    seen = set() if seen is None else seen
    if tree.as_pointer() in seen:
        return
    seen.add(tree.as_pointer())
    for node in tree.nodes:
        yield node
        if getattr(node, "node_tree", None):
            yield from nodes_inside(node.node_tree, seen)
