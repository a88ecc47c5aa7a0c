# SPDX-License-Identifier: GPL-3.0-or-later
"""The button *Terrain Material*."""

import bpy

from ...cbt_terrain.attributes.splat import NAMES
from ..maps.images import map_image, map_vector, tile_metres
from ..session.polls import TerrainObjectOperator, cancelled_by_errors
from .material import COLORS, LAYERS_PER_SPLAT, NORMAL, SKY, SUN, LayerSources, give_terrain_material
from .properties import colors_of


class TerrainMaterial(TerrainObjectOperator, bpy.types.Operator):
    """Give the terrain a material with the colours of its layers, the light and the baked maps. Press it again after
    you added layers or baked maps: your own nodes and settings stay"""

    bl_idname = "adaptive_terrain.terrain_material"
    bl_label = "Terrain Material"
    bl_options = {"REGISTER", "UNDO"}

    sky: bpy.props.BoolProperty(
        name="Sky",
        description="Darken ground that sees little of the sky. Without a baked map of it, a large height map takes "
        "seconds",
    )
    sun: bpy.props.BoolProperty(
        name="Sun",
        description="Darken ground that lies in the shadow of the terrain, for lamps that cast no shadow. "
        "Shadow in the node group sets how much",
    )

    @cancelled_by_errors
    def execute(self, context):
        """Build the material from the layers, the chosen light and the baked maps of the active terrain."""
        light = [name for name, on in ((SKY, self.sky), (SUN, self.sun)) if on]
        material = give_terrain_material(context.object, material_sources(context.object, light))
        self.report({"INFO"}, f"{material.name} is the material of {context.object.name}")
        return {"FINISHED"}


def material_sources(obj, light) -> LayerSources:
    """Return the inputs of the terrain's material: its layers, the light that it reads and its baked maps.

    light: SKY and SUN that the user chose; those with a baked map are always used.
    """
    layers = colors_of(obj.adaptive_terrain)
    num_splats = -(-len(layers) // LAYERS_PER_SPLAT)  # rounded up
    names = (COLORS, NORMAL, SKY, SUN, *NAMES[:num_splats])
    maps = {name: image for name in names if (image := map_image(obj, name)) is not None}
    layers = [] if COLORS in maps else layers  # the map has their colours
    light = [name for name in (SKY, SUN) if name in light or name in maps]
    return LayerSources(layers, light, maps, place=lambda tree: map_vector(tree, obj), tile=tile_metres(obj))
