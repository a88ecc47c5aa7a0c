# SPDX-License-Identifier: GPL-3.0-or-later
"""How an object is kept on the ground, or above it, in every frame: `object.adaptive_terrain_keep`."""

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, PointerProperty

ON, ABOVE = "ON", "ABOVE"


class KeepSettings(bpy.types.PropertyGroup):
    """The operators of the panel *Ground* write it; the object's delta transforms then belong to keep_ground.py."""

    keep: BoolProperty(name="Keep Every Frame", description="Move the object vertically in every frame")
    how: EnumProperty(
        name="Keep",
        items=[(ON, "On Ground", "At the offset from the ground, whatever height its animation gives it"),
               (ABOVE, "Above Ground", "Where its animation has it, but never lower than the clearance")],
    )  # fmt: skip
    offset: FloatProperty(name="Offset", description="Metres from the ground up to the origin", unit="LENGTH")
    clearance: FloatProperty(
        name="Clearance",
        description="Metres that the ground lies below the origin at least, straight down",
        default=2.0, min=0.0, unit="LENGTH",
    )  # fmt: skip
    align: BoolProperty(name="Align to Normal", description="Turn the object's Z axis to the ground's normal")
    terrain: PointerProperty(
        name="Terrain",
        description="The terrain that counts as ground; empty: the highest at the place",
        type=bpy.types.Object, poll=lambda self, item: item.adaptive_terrain.enabled,
    )  # fmt: skip


def register() -> None:
    bpy.utils.register_class(KeepSettings)
    bpy.types.Object.adaptive_terrain_keep = PointerProperty(type=KeepSettings)


def unregister() -> None:
    del bpy.types.Object.adaptive_terrain_keep
    bpy.utils.unregister_class(KeepSettings)
