# SPDX-License-Identifier: GPL-3.0-or-later
"""What materials read of the mesh that wears them, and what rays of other shaders read of it."""

from dataclasses import dataclass, field
from itertools import islice

import bpy
import numpy as np

from ...cbt_terrain.effects.effect import PICTURE
from .found import ACTIVE_COLOR, ACTIVE_UV, ALL, Demand
from .readers import HIT
from .trees import Tree, nodes_inside
from .walk import Walk

# Which of a material's outputs an engine takes.
ENGINES = {"CYCLES": "CYCLES", "BLENDER_EEVEE": "EEVEE", "BLENDER_EEVEE_NEXT": "EEVEE"}
WORKBENCH = "BLENDER_WORKBENCH"
MOST_AOVS = 1000
HAS_RAYS = bpy.app.version >= (5, 1)


@dataclass
class Look:
    """How materials are shown. `targets`: outputs that are taken. `aovs`: names of those that a view layer has. `osl`:
    scripts run. `trees`: node trees read so far."""

    targets: set[str]
    aovs: set[str]
    osl: bool
    trees: dict[int, Tree] = field(default_factory=dict)


def look_of(scene, layers, preview: bool) -> Look:
    """How a scene is shown. `preview`: in a viewport, where EEVEE's preview is a click away."""
    engine = scene.render.engine
    targets = set() if engine == WORKBENCH else {ENGINES[engine]} if engine in ENGINES else {"ALL", "CYCLES", "EEVEE"}
    if preview:
        targets |= {"EEVEE"}
    osl = engine == "CYCLES" and bool(getattr(getattr(scene, "cycles", None), "shading_system", False))
    return Look(targets, {aov.name for layer in layers for aov in layer.aovs}, osl)


def read_material(found: Demand, material, look: Look) -> None:
    """Add what a material reads of the mesh that wears it."""
    tree = material.node_tree
    if tree is None or bpy.app.version < (5, 0) and not material.use_nodes:
        return
    _read_shader(found, tree, f"material {material.name}", look)


def read_rays(found: Demand, worn: set, look: Look) -> None:
    """Add what rays read that hit the mesh: those of any shader but the materials `worn`, which are read anyway."""
    if not HAS_RAYS:
        return
    blocks = [(block, kind) for kind in ("material", "world", "light") for block in getattr(bpy.data, kind + "s")]
    for block, kind in blocks:
        tree = block.node_tree
        if tree is None or block in worn or not any(_hits_others(node) for node in nodes_inside(tree)):
            continue
        everything = Demand()
        _read_shader(everything, tree, f"{kind} {block.name}", look)
        for name, readers in everything.items():
            for reader in readers:
                if HIT in reader.words:
                    found.add(name, *reader)


def read_workbench(found: Demand, shading, words: str) -> None:
    """Add what Workbench reads for a shading that is solid."""
    name = {"VERTEX": ACTIVE_COLOR, "TEXTURE": ACTIVE_UV}.get(shading.color_type)
    if name:
        found.add(name, words, PICTURE)


def worn_slots(obj) -> set[int]:
    """Numbers of the material slots that faces use."""
    last = len(obj.material_slots) - 1
    numbers = obj.data.attributes.get("material_index") if hasattr(obj.data, "attributes") else None
    if last < 0 or numbers is None or numbers.domain != "FACE":
        return {0} if last >= 0 else set()
    used = np.zeros(len(numbers.data), np.int32)
    numbers.data.foreach_get("value", used)
    return set(np.unique(np.clip(used, 0, last)).tolist())


def _hits_others(node) -> bool:
    return node.bl_idname == "ShaderNodeRaycast" and not node.only_local and len(node.sample_attribute_items) > 0


def _read_shader(found: Demand, tree, words: str, look: Look) -> None:
    walk = Walk(found, words, PICTURE, look.trees, osl=look.osl)
    ends = {end.as_pointer(): (end, ()) for target in look.targets if (end := tree.get_output_node(target))}
    aovs = list(islice(_aov_ends(tree, look.aovs, ()), MOST_AOVS)) if look.aovs else []
    if len(aovs) == MOST_AOVS:
        found.add(ALL, f"{words} (too many AOV outputs to follow)", PICTURE)
    for end, context in [*ends.values(), *aovs]:
        for socket in end.inputs:
            walk.visit(end, socket, context)


def _aov_ends(tree, names: set[str], context: tuple):
    """AOV outputs of a tree and of the groups in it, each with its context."""

    def is_one(node) -> bool:
        return node.bl_idname == "ShaderNodeOutputAOV" and node.aov_name in names and not node.mute

    for node in tree.nodes:
        inner = None if node.mute else getattr(node, "node_tree", None)
        if is_one(node):
            yield node, context
        elif inner is not None and any(map(is_one, nodes_inside(inner))):
            yield from _aov_ends(inner, names, (*context, node))
