# SPDX-License-Identifier: GPL-3.0-or-later
"""The button *Terrain Material*."""

import bpy

from ..scene import session
from .material import SKY, SUN, Sources, dress


class TerrainMaterial(bpy.types.Operator):
    """Give the terrain a material of its layers and light, made from what there is. Press it again when layers were
    added or maps baked: links and settings stay"""

    bl_idname = "adaptive_terrain.terrain_material"
    bl_label = "Terrain Material"
    bl_options = {"REGISTER", "UNDO"}

    sky: bpy.props.BoolProperty(name="Sky", description="Darken what sees little of the sky", default=True)
    sun: bpy.props.BoolProperty(
        name="Sun", description="Read the suns' shadows, for light that casts none; see Shadow of the group"
    )

    @classmethod
    def poll(cls, context):
        return context.object is not None and session.is_terrain(context.object) and context.mode == "OBJECT"

    def execute(self, context):
        light = [name for name, on in ((SKY, self.sky), (SUN, self.sun)) if on]
        material = dress(context.object, sources_of(context.object, light))
        self.report({"INFO"}, f"{material.name} is the material of {context.object.name}")
        return {"FINISHED"}


def sources_of(obj, light) -> Sources:
    """What there is of the terrain: its layers, the maps that are baked."""
    return Sources([], light)


register, unregister = bpy.utils.register_classes_factory((TerrainMaterial,))
