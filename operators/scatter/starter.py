# SPDX-License-Identifier: GPL-3.0-or-later
"""Add Starter Collection: plants and rocks to scatter, built by geometry nodes, in collections of the file."""

import bpy

from ..bridge.demand.trees import tree_of_new
from ..bridge.nodes import Nodes, first_node
from ..scene.haze import join_haze
from ..session.polls import ObjectModeOperator
from . import starter_forms
from .habitats import set_habitat
from .request import is_scatter

ROOT = "Starter Collection"
MARK = "adaptive_terrain_starter"  # a property of collections and materials, by which they are found under any name
# Kind: name of its collection, name and form of its objects, and the size of each.
KINDS = {
    "CONIFERS": ("Conifers", "Conifer", starter_forms.conifer, (1.0, 0.76, 0.5)),
    "BROADLEAVES": ("Broadleaves", "Broadleaf", starter_forms.broadleaf, (1.0, 0.88, 0.72)),
    "BUSHES": ("Bushes", "Bush", starter_forms.bush, (1.0, 0.8, 0.6)),
    "GRASS": ("Grass", "Grass", starter_forms.grass, (1.0, 0.85, 0.7)),
    "ROCKS": ("Rocks", "Rock", starter_forms.rock, (2.0, 1.2, 0.7, 0.3)),
}
KIND_ITEMS = [
    ("CONIFERS", "Conifers", "Woods of spruces below the tree line, on ground up to 30° steep"),
    ("BROADLEAVES", "Broadleaves", "Woods of round trees below the tree line, on ground up to 30° steep"),
    ("BUSHES", "Bushes", "Low bushes below the tree line, on ground up to 30° steep"),
    ("GRASS", "Grass", "Tufts of grass, for ground near the camera"),
    ("ROCKS", "Rocks", "Rocks of four sizes"),
]
# Linear RGB inside and at the tips, and roughness.
MATERIALS = {
    "Bark": ((0.03, 0.022, 0.016), (0.075, 0.055, 0.04), 0.9),
    "Needles": ((0.016, 0.032, 0.013), (0.15, 0.205, 0.065), 0.75),
    "Leaves": ((0.012, 0.026, 0.006), (0.115, 0.17, 0.035), 0.7),
    "Grass": ((0.05, 0.075, 0.016), (0.26, 0.28, 0.09), 0.7),
    "Stone": ((0.05, 0.05, 0.048), (0.17, 0.172, 0.168), 0.9),
}
DIFFERENCE = 0.6  # between the colours of instances: the range of red, as a fraction of its mean


class AddStarterCollection(ObjectModeOperator, bpy.types.Operator):
    """Add conifers, broadleaves, bushes, grass and rocks to the file, as a hidden collection, and scatter one kind of
    them"""

    bl_idname = "adaptive_terrain.starter_add"
    bl_label = "Add Starter Collection"
    bl_options = {"REGISTER", "UNDO"}

    kind: bpy.props.EnumProperty(name="Kind", description="Objects to scatter", items=KIND_ITEMS)

    def execute(self, context):
        """Add the collections and put the chosen kind on the active scatter, if there is one."""
        obj = context.object
        is_on_scatter = obj is not None and is_scatter(obj)
        found = put_kind(context, obj, self.kind) if is_on_scatter else add_starter(context)[self.kind]
        self.report({"INFO"}, f"{found.name} has {len(found.objects)} objects")
        return {"FINISHED"}


def put_kind(context, scatter, kind: str) -> bpy.types.Collection:
    """Put a kind (key of KINDS) on a scatter, with rules for the ground where it grows; return its collection."""
    found = add_starter(context)[kind]
    set_habitat(scatter, kind)
    scatter.adaptive_scatter.collection = found
    return found


def add_starter(context) -> dict[str, bpy.types.Collection]:
    """Add the kinds that the file lacks, hidden from the scene's view layers; return the collections by key of KINDS.

    A root collection that the file has already is among them, as ROOT.
    """
    found = {collection[MARK]: collection for collection in bpy.data.collections if MARK in collection}
    missing = [kind for kind in KINDS if kind not in found]
    if missing:
        root = found.get(ROOT) or _new_collection(ROOT, ROOT)
        if root.name not in context.scene.collection.children:
            context.scene.collection.children.link(root)
        materials = {name: _material(name) for name in MATERIALS}
        for kind in missing:
            found[kind] = _new_collection(KINDS[kind][0], kind)
            root.children.link(found[kind])
            for obj in _build(context, kind, materials):
                found[kind].objects.link(obj)
        for view_layer in context.scene.view_layers:
            view_layer.layer_collection.children[root.name].exclude = True
    return found


def _new_collection(name: str, mark: str) -> bpy.types.Collection:
    """Create a collection with a mark, by which it is found again under another name."""
    collection = bpy.data.collections.new(name)
    collection[MARK] = mark
    return collection


def _build(context, kind: str, materials: dict) -> list[bpy.types.Object]:
    """Build the objects of a kind: evaluate their node trees and keep only the meshes.

    materials: by the names of MATERIALS. The objects are in no collection.
    """
    _, name, form, sizes = KINDS[kind]
    objects = []
    for number, size in enumerate(sizes):
        tree = bpy.data.node_groups.new(name, "GeometryNodeTree")
        tree.is_modifier = True
        tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
        form(starter_forms.FormNodes(tree, seed=number + 1), materials, size)
        obj = bpy.data.objects.new(f"{name} {number + 1}", bpy.data.meshes.new(name))
        obj.modifiers.new(name, "NODES").node_group = tree
        context.scene.collection.objects.link(obj)  # Blender evaluates no object outside of the scene
        objects.append(obj)
    depsgraph = context.evaluated_depsgraph_get()
    for obj in objects:
        evaluated, empty, tree = obj.evaluated_get(depsgraph), obj.data, obj.modifiers[0].node_group
        mesh = bpy.data.meshes.new_from_object(evaluated)
        if mesh.materials[0] is None:  # a slot that primitives bring and no face uses
            mesh.materials.pop(index=0)
        mesh.name = obj.name
        obj.data = mesh
        obj.modifiers.clear()
        context.scene.collection.objects.unlink(obj)
        bpy.data.meshes.remove(empty)
        bpy.data.node_groups.remove(tree)
    return objects


def _material(name: str) -> bpy.types.Material:
    """Return the material of this name, from the file or new: it mixes two colours by `shade`, varied by instance."""
    for material in bpy.data.materials:
        if material.get(MARK) == name:
            return material
    material = bpy.data.materials.new(name)
    material[MARK] = name
    inside, tips, roughness = MATERIALS[name]
    tree = tree_of_new(material)
    nodes, shader = Nodes(tree), first_node(tree, "ShaderNodeBsdfPrincipled")
    shade = nodes.add("ShaderNodeAttribute", attribute_name=starter_forms.SHADE).outputs["Fac"]
    color = nodes.mix(shade, (*inside, 1.0), (*tips, 1.0))
    random = nodes.add("ShaderNodeObjectInfo").outputs["Random"]
    red = nodes.math("MULTIPLY_ADD", random, DIFFERENCE, 1.0 - DIFFERENCE / 2)  # varies most: some are warmer
    other = nodes.math("MULTIPLY_ADD", random, DIFFERENCE / 2, 1.0 - DIFFERENCE / 4)  # green and blue
    tint = nodes.add("ShaderNodeCombineXYZ", {0: red, 1: other, 2: other}).outputs[0]
    tree.links.new(nodes.vector("MULTIPLY", color, tint), shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Specular IOR Level"].default_value = 0.2
    nodes.arrange()
    join_haze(material)
    return material
