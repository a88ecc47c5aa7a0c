# SPDX-License-Identifier: GPL-3.0-or-later
"""The walk backwards through node trees, from what is used to what that reads.

Muted nodes are passed by their internal links; a group is entered by the output that is used and left by the input that
is used, so a group that is used twice is walked twice, in two contexts: a context is the tuple of group nodes that the
walk is in, the innermost last.
"""

from dataclasses import dataclass, field

from .found import ALL, Demand
from .inputs import used_inputs
from .readers import note_reads
from .trees import Tree, read_tree

DEEPEST = 30  # groups in groups
MOST_STEPS = 20_000  # groups that are used twice in groups that are used twice ... would never end
KNOWN = "ShaderNode", "GeometryNode", "FunctionNode", "Node"
CONSTANTS = int, float, bool, str


@dataclass
class Walk:
    """One walk. `words`: what is walked. `family`: of its readers. `values`: of the inputs of the outermost tree, by
    identifier. `osl`: scripts run. `trees`: those read so far, which several walks may share. What geometry nodes take
    in is collected in `materials`, `objects` and `collections`."""

    found: Demand
    words: str
    family: str
    trees: dict[int, Tree]
    values: dict = field(default_factory=dict)
    osl: bool = False
    seen: set = field(default_factory=set)
    materials: set = field(default_factory=set)
    objects: set = field(default_factory=set)
    collections: set = field(default_factory=set)

    def visit(self, node, socket, context: tuple = ()) -> None:
        """Note what everything reads that feeds an input."""
        waiting = [(node, socket, context)]
        while waiting:
            node, socket, context = waiting.pop()
            if len(self.seen) > MOST_STEPS:
                self.read(ALL, node, context[:1], "too many groups in groups to follow")
                return
            for source, output in self.feeding(node, socket):
                waiting += self._through(source, output, context)

    def feeding(self, node, socket) -> list[tuple]:
        """(node, output) of what feeds an input."""
        return self._tree(node).feeding.get(socket.as_pointer(), [])

    def is_altered(self, node) -> bool:
        """Whether animation changes more of a node than values of its inputs."""
        return node.name in self._tree(node).altered

    def constant(self, node, socket, context: tuple):
        """The value of an input if it has one for good, else None."""
        for _ in range(100):
            links = self.feeding(node, socket)
            if len(links) > 1:
                return None
            if not links:
                return self._own_value(node, socket)
            source, output = links[0]
            if source.bl_idname == "FunctionNodeInputString":
                return None if source.mute or self.is_altered(source) else source.string
            if source.bl_idname == "NodeGroupInput" and not context:
                value = self.values.get(output.identifier)
                return value if isinstance(value, CONSTANTS) else None
            step = self._passed(source, output, context)
            if step is None or self.is_altered(step[0]):
                return None
            node, socket, context = step
        return None

    def read(self, name: str, node, context: tuple, why: str = "") -> None:
        """Note that a node reads an attribute."""
        groups = [f"group {group.node_tree.name}" for group in context]
        words = ", ".join([self.words, *groups, f"node {node.name}"])
        self.found.add(name, f"{words} ({why})" if why else words, self.family)

    def _tree(self, node) -> Tree:
        tree = node.id_data
        key = tree.as_pointer()
        if key not in self.trees:
            self.trees[key] = read_tree(tree)
        return self.trees[key]

    def _own_value(self, node, socket):
        """Of an input that nothing feeds."""
        if self.is_altered(node) or not hasattr(socket, "default_value"):
            return None
        number = next((i for i, other in enumerate(node.inputs) if other == socket), -1)
        value = socket.default_value
        return None if (node.name, number) in self._tree(node).varied or not isinstance(value, CONSTANTS) else value

    def _passed(self, node, output, context: tuple) -> tuple | None:
        """The input whose value an output passes on as it is, with its node and context; None if there is none."""
        if node.mute:
            through = [link.from_socket for link in node.internal_links if link.to_socket == output]
            return (node, through[0], context) if through else None
        if node.bl_idname == "NodeReroute":
            return node, node.inputs[0], context
        if node.bl_idname == "NodeGroupInput" and context:
            outer = context[-1]
            inputs = [socket for socket in outer.inputs if socket.identifier == output.identifier]
            return (outer, inputs[0], context[:-1]) if inputs else None
        return None

    def _through(self, node, output, context: tuple) -> list[tuple]:
        """Note what a node reads for one of its outputs; returns (node, input, context) of what that needs."""
        key = node.as_pointer(), output.identifier, tuple(group.as_pointer() for group in context)
        if key in self.seen:
            return []
        self.seen.add(key)
        if node.mute:  # which no animation changes
            return [(node, link.from_socket, context) for link in node.internal_links if link.to_socket == output]
        if node.bl_idname == "NodeGroupInput":
            step = self._passed(node, output, context)
            return [step] if step else []
        if getattr(node, "node_tree", None) is not None:
            return self._into(node, output, context)
        note_reads(self, node, output, context)
        if not node.bl_idname.startswith(KNOWN) or node.bl_idname.endswith("NodeCustomGroup"):
            self.read(ALL, node, context, f"an unknown type of node, {node.bl_idname}")
        return [(node, socket, context) for socket in used_inputs(self, node, context)]

    def _into(self, group, output, context: tuple) -> list[tuple]:
        """The end of a group that makes one of its outputs."""
        if len(context) >= DEEPEST:
            self.read(ALL, group, context[:1], "groups too deep to follow")
            return []
        ends = [n for n in group.node_tree.nodes if n.bl_idname == "NodeGroupOutput" and n.is_active_output]
        inside = (*context, group)
        return [(e, s, inside) for e in ends for s in e.inputs if s.identifier == output.identifier]
