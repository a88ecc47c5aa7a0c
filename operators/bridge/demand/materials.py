# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes of a mesh that its materials read, and that Raycast nodes of other shaders read where they hit it.

Functions add them to the Demand `found`. `shading` tells which outputs of a material the scene's engine uses.
"""

from dataclasses import dataclass, field
from itertools import islice

import bpy
import numpy as np

from ....cbt_terrain.attributes.attribute import PICTURE
from .found import ACTIVE_COLOR, ACTIVE_UV, ALL, Demand
from .trees import Trees, nodes_inside
from .walk import NodeWalk

# The material output that an engine uses.
ENGINES = {"CYCLES": "CYCLES", "BLENDER_EEVEE": "EEVEE", "BLENDER_EEVEE_NEXT": "EEVEE"}
WORKBENCH = "BLENDER_WORKBENCH"
MAX_AOVS = 1000
HAS_RAYCAST_NODE = bpy.app.version >= (5, 1)


@dataclass
class Shading:
    """How a scene shows materials.

    Attributes:
        targets: the used material outputs: "ALL", "CYCLES" or "EEVEE".
        aovs: names of the view layers' AOVs.
        osl: whether OSL scripts run.
        trees: node trees read so far.
    """

    targets: set[str]
    aovs: set[str]
    osl: bool
    trees: Trees = field(default_factory=Trees)


def shading_of(scene, layers, preview: bool) -> Shading:
    """Return how a scene shows materials.

    The result has the material outputs that its engine uses (none of Workbench, all of an unknown engine), the names of
    its AOVs, and whether Cycles runs OSL scripts. layers: view layers whose AOVs count. preview: include EEVEE, which a
    viewport may show at any time.
    """
    engine = scene.render.engine
    targets = set() if engine == WORKBENCH else {ENGINES[engine]} if engine in ENGINES else {"ALL", "CYCLES", "EEVEE"}
    if preview:
        targets |= {"EEVEE"}
    osl = engine == "CYCLES" and bool(getattr(getattr(scene, "cycles", None), "shading_system", False))
    return Shading(targets, {aov.name for layer in layers for aov in layer.aovs}, osl)


def read_material(found: Demand, material, shading: Shading) -> None:
    """Add the attributes that a material reads of its mesh; none if it has no nodes."""
    tree = material.node_tree
    if tree is None or bpy.app.version < (5, 0) and not material.use_nodes:
        return
    _read_shader(found, tree, f"material {material.name}", shading)


def read_rays(found: Demand, materials: set, shading: Shading) -> None:
    """Add to `found` the attributes that Raycast nodes of other shaders may read where their rays hit the mesh.

    Blender has these nodes since 5.1. materials: the mesh's own, which `read_material` reads.
    """
    if not HAS_RAYCAST_NODE:
        return
    blocks = [(block, kind) for kind in ("material", "world", "light") for block in getattr(bpy.data, kind + "s")]
    for block, kind in blocks:
        tree = block.node_tree
        if tree is None or block in materials or not any(_hits_others(node) for node in nodes_inside(tree)):
            continue
        everything = Demand()
        _read_shader(everything, tree, f"{kind} {block.name}", shading)
        for name, readers in everything.items():
            for reader in readers:
                if reader.at_hit:
                    found.add(name, *reader)


def read_workbench(found: Demand, shading, label: str) -> None:
    """Add the attribute that Workbench reads for a solid shading, if any. label: the reader's name for the user."""
    name = {"VERTEX": ACTIVE_COLOR, "TEXTURE": ACTIVE_UV}.get(shading.color_type)
    if name:
        found.add(name, label, PICTURE)


def used_slots(obj) -> set[int]:
    """Return the numbers of the material slots that faces use, from 0; a number beyond the last is clamped.

    The first is used if faces have no numbers. The result is empty for an object without slots.
    """
    last = len(obj.material_slots) - 1
    numbers = obj.data.attributes.get("material_index") if hasattr(obj.data, "attributes") else None
    if last < 0 or numbers is None or numbers.domain != "FACE":
        return {0} if last >= 0 else set()
    used = np.zeros(len(numbers.data), np.int32)
    numbers.data.foreach_get("value", used)
    return set(np.unique(np.clip(used, 0, last)).tolist())


def _hits_others(node) -> bool:
    """Return whether a node is a Raycast that reads attributes of other objects where its rays hit."""
    return node.bl_idname == "ShaderNodeRaycast" and not node.only_local and len(node.sample_attribute_items) > 0


def _read_shader(found: Demand, tree, label: str, shading: Shading) -> None:
    """Add the attributes that a shader's node tree reads, from its used outputs and AOVs backwards.

    With MAX_AOVS or more AOV outputs it counts as reading everything. label: the owner's name for the user. `context`
    of an output: the group nodes that it is in, the outermost first.
    """
    walk = NodeWalk(found, label, PICTURE, shading.trees, osl=shading.osl)
    # By pointer, since several targets may have one output.
    ends = {end.as_pointer(): (end, ()) for target in shading.targets if (end := tree.get_output_node(target))}
    aovs = list(islice(_aov_ends(tree, shading.aovs, ()), MAX_AOVS)) if shading.aovs else []
    if len(aovs) == MAX_AOVS:
        found.add(ALL, f"{label} (too many AOV outputs to follow)", PICTURE)
    for end, context in [*ends.values(), *aovs]:
        for socket in end.inputs:
            walk.visit(end, socket, context)


def _aov_ends(tree, names: set[str], context: tuple):
    """Yield the AOV output nodes of a tree and of its groups, each with its context.

    names: AOVs of the view layers. context: enclosing group nodes.
    """

    def is_used_aov(node) -> bool:
        """Return whether a node is an output to one of the AOVs."""
        return node.bl_idname == "ShaderNodeOutputAOV" and node.aov_name in names and not node.mute

    for node in tree.nodes:
        inner = None if node.mute else getattr(node, "node_tree", None)
        if is_used_aov(node):
            yield node, context
        elif inner is not None and any(map(is_used_aov, nodes_inside(inner))):
            yield from _aov_ends(inner, names, (*context, node))
