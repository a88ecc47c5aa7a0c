# SPDX-License-Identifier: GPL-3.0-or-later
"""What a walk needs of one node tree: which sockets feed which, and what animation may change."""

import re
from dataclasses import dataclass, field

import bpy

# An animated property of a node: its name, and the number of the input whose value it is, if it is one.
PATH = re.compile(r'nodes\["((?:[^"\\]|\\.)*)"\](?:\.inputs\[(\d+)\]\.default_value)?')


@dataclass
class Trees:
    """Node trees that were read, by the pointers of their parts, which hold while nothing edits them.

    `feeding`: of an input, the (node, output) of its links that are valid and not muted. `varied`: inputs whose value
    is animated or driven. `altered`: nodes of which anything else is, so that nothing of them is known.
    """

    read: set[int] = field(default_factory=set)
    feeding: dict[int, list[tuple]] = field(default_factory=dict)
    varied: set[int] = field(default_factory=set)
    altered: set[int] = field(default_factory=set)

    def add(self, tree) -> None:
        """Read a tree, once."""
        if tree.as_pointer() in self.read:
            return
        self.read.add(tree.as_pointer())
        for link in tree.links:
            if link.is_valid and not link.is_muted:
                self.feeding.setdefault(link.to_socket.as_pointer(), []).append((link.from_node, link.from_socket))
        for path in animated_paths(tree):
            named = PATH.match(path)
            node = named and tree.nodes.get(named[1].replace('\\"', '"').replace("\\\\", "\\"))
            if not node:
                continue
            if named[2] is not None and int(named[2]) < len(node.inputs):
                self.varied.add(node.inputs[int(named[2])].as_pointer())
            else:
                self.altered.add(node.as_pointer())


def animated_paths(block) -> list[str]:
    """Data paths of a data-block that drivers, its action or its strips change."""
    data = block.animation_data
    if not data:
        return []
    actions = [data.action, *(strip.action for track in data.nla_tracks for strip in track.strips)]
    curves = list(data.drivers)
    for action in actions:
        if action is not None:
            curves += _curves(action)
    return [curve.data_path for curve in curves]


def _curves(action) -> list:
    """Of every slot: `action.fcurves` of Blender 4.4 and 4.5 has those of the first alone, and 5.0 has none."""
    if len(getattr(action, "layers", ())):
        bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
        return [curve for bag in bags for curve in bag.fcurves]
    return list(getattr(action, "fcurves", ()))


def tree_of_new(block):
    """The node tree of a material or world that was just made. Before Blender 5.0 there is none until one asks for it;
    6.0 takes away what asks."""
    if bpy.app.version < (5, 0):
        block.use_nodes = True
    return block.node_tree


def nodes_inside(tree, seen: set[int] | None = None):
    """Every node of a tree and of the groups in it, each group once."""
    seen = set() if seen is None else seen
    if tree.as_pointer() in seen:
        return
    seen.add(tree.as_pointer())
    for node in tree.nodes:
        yield node
        if getattr(node, "node_tree", None):
            yield from nodes_inside(node.node_tree, seen)
