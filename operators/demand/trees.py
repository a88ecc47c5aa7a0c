# SPDX-License-Identifier: GPL-3.0-or-later
"""What a walk needs of one node tree: which sockets feed which, and what animation may change."""

import re
from typing import NamedTuple

# An animated property of a node: its name, and the number of the input whose value it is, if it is one.
PATH = re.compile(r'nodes\["((?:[^"\\]|\\.)*)"\](?:\.inputs\[(\d+)\]\.default_value)?')


class Tree(NamedTuple):
    """`feeding`: by the pointer of an input, the (node, output) of its links that are valid and not muted. `varied`:
    (node's name, number of the input) of values that are animated or driven. `altered`: names of nodes of which
    anything else is, so that nothing of them is known."""

    feeding: dict[int, list[tuple]]
    varied: set[tuple[str, int]]
    altered: set[str]


def read_tree(tree) -> Tree:
    found = Tree({}, set(), set())
    for link in tree.links:
        if link.is_valid and not link.is_muted:
            found.feeding.setdefault(link.to_socket.as_pointer(), []).append((link.from_node, link.from_socket))
    for path in animated_paths(tree):
        if named := PATH.match(path):
            name = named[1].replace('\\"', '"').replace("\\\\", "\\")
            if named[2] is not None:
                found.varied.add((name, int(named[2])))
            else:
                found.altered.add(name)
    return found


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
