# SPDX-License-Identifier: GPL-3.0-or-later
"""A walk backwards through node trees, from used outputs to the attributes they read.

The walk passes muted nodes along their internal links. It enters a group by the used output and leaves it by the used
input, so it walks a group that is used twice in two contexts. A context is the tuple of enclosing group nodes, the
innermost last.
"""

from dataclasses import dataclass, field

from .found import ALL, Demand
from .inputs import used_inputs
from .readers import note_reads
from .trees import Trees

MAX_DEPTH = 30  # of nested groups
MAX_STEPS = 10_000  # nested groups that are each used twice would take exponentially many
KNOWN = "ShaderNode", "GeometryNode", "FunctionNode", "Node"
CONSTANTS = int, float, bool, str


@dataclass
class NodeWalk:
    """One walk.

    Attributes:
        found: the demand to add to.
        label: name of the walked object for people.
        family: family of the readers.
        trees: node trees read so far, which several walks may share.
        values: constant values of the outermost tree's inputs, by identifier.
        osl: whether OSL scripts run.
        seen: visited outputs: pointer of the node, identifier of the output, pointers of the context's nodes.
        materials, objects, collections: those that geometry nodes receive.
    """

    found: Demand
    label: str
    family: str
    trees: Trees
    values: dict = field(default_factory=dict)
    osl: bool = False
    seen: set = field(default_factory=set)
    materials: set = field(default_factory=set)
    objects: set = field(default_factory=set)
    collections: set = field(default_factory=set)

    def visit(self, node, socket, context: tuple = ()) -> None:
        """Walk backwards from an input of a node: add the reads of all nodes that feed it.

        Outputs that were visited before are passed over. A walk of more than MAX_STEPS outputs ends, and counts as
        reading everything. socket: the input. context: enclosing group nodes, innermost last.
        """
        self.trees.add(node.id_data)
        waiting = [(node, socket, context)]
        while waiting:
            node, socket, context = waiting.pop()
            if len(self.seen) > MAX_STEPS:
                self.read(ALL, node, context[:1], "too many groups in groups to follow")  # [:1]: a short label
                return
            for source, output in self.feeding(socket):
                waiting += self._read_and_step(source, output, context)

    def feeding(self, socket) -> list[tuple]:
        """Return the (node, output) pairs that feed an input."""
        return self.trees.feeding.get(socket.as_pointer(), [])

    def is_altered(self, node) -> bool:
        """Return whether animation changes more of a node than the values of its inputs."""
        return node.as_pointer() in self.trees.altered

    def constant(self, node, socket, context: tuple):
        """Return the value of an input if nothing can change it, else None.

        context: enclosing group nodes, innermost last. A link is followed back through reroutes, muted nodes and
        groups, 100 steps at most. It may end at a String node; the values of other nodes count as computed.
        """
        for _ in range(100):
            links = self.feeding(socket)
            if len(links) > 1:
                return None
            if not links:
                return self._unlinked_value(node, socket)
            source, output = links[0]
            # altered: animated in more than the values of its inputs.
            if source.bl_idname == "FunctionNodeInputString":
                return None if source.mute or self.is_altered(source) else source.string
            if source.bl_idname == "NodeGroupInput" and not context:
                value = self.values.get(output.identifier)
                return value if isinstance(value, CONSTANTS) else None
            step = self._input_passed_to(source, output, context)
            if step is None or self.is_altered(step[0]):
                return None
            node, socket, context = step
        return None

    def read(self, name: str, node, context: tuple, why: str = "", at_hit: bool = False) -> None:
        """Add a node as the reader of an attribute. why: added to the reader's label.

        context: enclosing group nodes, innermost last. at_hit: the node reads the attribute where its rays hit.
        """
        groups = [f"group {group.node_tree.name}" for group in context]
        label = ", ".join([self.label, *groups, f"node {node.name}"])
        self.found.add(name, f"{label} ({why})" if why else label, self.family, at_hit)

    def _unlinked_value(self, node, socket):
        """Return the value of an unlinked input; None if animation may change it or it is no number or text.

        Drivers count as animation.
        """
        if self.is_altered(node) or socket.as_pointer() in self.trees.varied:
            return None
        value = getattr(socket, "default_value", None)
        return value if isinstance(value, CONSTANTS) else None

    def _input_passed_to(self, node, output, context: tuple) -> tuple | None:
        """Return (node, input, context) of the input that an output passes on unchanged; None if there is none.

        An input of the outermost tree comes from no other node, so the result is None for it.
        """
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

    def _read_and_step(self, node, output, context: tuple) -> list[tuple]:
        """Add the reads of a node for one of its outputs; return (node, input, context) of the inputs that it needs.

        [] if this output was visited in the same context before, and at the inputs of the outermost tree.
        """
        key = node.as_pointer(), output.identifier, tuple(group.as_pointer() for group in context)
        if key in self.seen:
            return []
        self.seen.add(key)
        if node.mute:  # a muted node reads nothing, and passes an input on
            return [(node, link.from_socket, context) for link in node.internal_links if link.to_socket == output]
        if node.bl_idname == "NodeGroupInput":
            step = self._input_passed_to(node, output, context)
            return [step] if step else []
        if getattr(node, "node_tree", None) is not None:
            return self._enter_group(node, output, context)
        note_reads(self, node, output, context)
        if not node.bl_idname.startswith(KNOWN) or node.bl_idname.endswith("NodeCustomGroup"):
            self.read(ALL, node, context, f"an unknown type of node, {node.bl_idname}")
        fed = (socket for socket in used_inputs(self, node, context) if self.feeding(socket))
        return [(node, socket, context) for socket in fed]

    def _enter_group(self, group, output, context: tuple) -> list[tuple]:
        """Enter a group node: return (output node, its input, longer context) for one of the group's outputs.

        A group nested deeper than MAX_DEPTH counts as reading everything, and is not entered: the result is [].
        """
        if len(context) >= MAX_DEPTH:
            self.read(ALL, group, context[:1], "groups too deep to follow")  # [:1]: a short label
            return []
        self.trees.add(group.node_tree)
        ends = [n for n in group.node_tree.nodes if n.bl_idname == "NodeGroupOutput" and n.is_active_output]
        inside = (*context, group)
        return [(e, s, inside) for e in ends for s in e.inputs if s.identifier == output.identifier]
