# SPDX-License-Identifier: GPL-3.0-or-later
"""*Add Water Surface*: the water that a stack has left on a terrain, as an object of its own with a material."""

from dataclasses import replace

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.land.water import WATER
from ...cbt_terrain.land.water_surface import water_of
from ...cbt_terrain.run import launch
from ..mesh.writer import write_mesh
from ..scene import land_request, session
from ..scene.land_request import land_of
from .nodes import Nodes

MATERIAL = "Terrain Water"
DEPTH = "water_depth"
SHALLOW, DEEP = (0.16, 0.34, 0.31, 1.0), (0.004, 0.025, 0.045, 1.0)  # linear, of clear mountain water
CLEAR_M = 6.0  # depth at which no ground shows any more


class AddWaterSurface(bpy.types.Operator):
    """Add the water that the stack has left, as a child of the terrain: cut at the shore, with depth and speed as
    attributes. Press it again after shaping, and the object is written anew"""

    bl_idname = "adaptive_terrain.add_water"
    bl_label = "Add Water Surface"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and session.is_terrain(context.object) and context.mode == "OBJECT"

    def execute(self, context):
        obj = context.object
        try:
            surface = surface_of(obj, context.evaluated_depsgraph_get())
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        water = object_of(obj)
        write_mesh(water.data, surface, smooth=True)
        if not water.data.materials:
            water.data.materials.append(bpy.data.materials.get(MATERIAL) or new_material())
        self.report({"INFO"}, f"{water.name}: {len(surface.triangles):,} triangles")
        return {"FINISHED"}


def surface_of(obj, depsgraph):
    """The water on a terrain, which is shaped first if it has to be, as its settings place heights."""
    settings = obj.adaptive_terrain
    store, land = bpy.path.abspath(settings.store), land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=True)
    if not store:
        raise TerrainError(f"The terrain {obj.name!r} has no height field; import one from its panel.")
    field = land_request.raster_of(store, land, session.open_field)
    if DEPTH not in field.layers:
        raise TerrainError(f"No effect of {obj.name!r} leaves water: add {WATER.label!r} to its stack.")
    surface = water_of(field, launch.default_threads())
    positions = surface.positions.copy()
    positions[:, 2] = positions[:, 2] * settings.vertical_scale + settings.vertical_offset
    return replace(surface, positions=positions)


def object_of(obj):
    """The terrain's own water: the child that was made for it, or a new one."""
    name = f"{obj.name} Water"
    for child in obj.children:
        if child.name == name and child.type == "MESH" and not child.adaptive_terrain.enabled:
            return child
    water = bpy.data.objects.new(name, bpy.data.meshes.new(name))
    for collection in obj.users_collection:
        collection.objects.link(water)
    water.parent = obj
    return water


def new_material():
    """Clear over the shore, dark where it is deep."""
    material = bpy.data.materials.new(MATERIAL)
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    nodes = Nodes(tree)
    depth = nodes.add("ShaderNodeAttribute", attribute_name=DEPTH).outputs["Fac"]
    part = nodes.add("ShaderNodeMapRange", {"Value": depth, "From Max": CLEAR_M}).outputs["Result"]
    opaque = nodes.math("POWER", part, 0.4)
    shader = nodes.add(
        "ShaderNodeBsdfPrincipled",
        {"Base Color": nodes.mix(opaque, SHALLOW, DEEP), "Roughness": 0.08, "IOR": 1.333,
         "Alpha": nodes.math("MAXIMUM", opaque, 0.25)},
    )  # fmt: skip
    nodes.add("ShaderNodeOutputMaterial", {"Surface": shader.outputs[0]})
    nodes.arrange()
    return material


register, unregister = bpy.utils.register_classes_factory((AddWaterSurface,))
