# SPDX-License-Identifier: GPL-3.0-or-later
"""How an object is kept on the ground, or above it, in every frame: `object.adaptive_terrain_keep`."""

import bpy
from bpy.app.handlers import persistent
from bpy.props import BoolProperty, EnumProperty, FloatProperty, PointerProperty

ON, ABOVE = "ON", "ABOVE"
_looked: tuple[int, bool] | None = None  # number of objects at the last look, and whether any was kept


def is_any_on_ground() -> bool:
    """Return whether any object of the file is kept on or above the ground.

    The answer is cached until `look_again` or another number of objects: looking at 10,000 objects would make a frame
    take a third longer.
    """
    global _looked
    count = len(bpy.data.objects)  # others may be appended without a handler's call
    if _looked is None or _looked[0] != count:
        _looked = count, any(obj.adaptive_terrain_keep.keep for obj in bpy.data.objects)
    return _looked[1]


@persistent
def look_again(_self=None, _context=None) -> None:
    """Forget whether any object is kept on the ground, so that the next call looks again."""
    global _looked
    _looked = None


class KeepSettings(bpy.types.PropertyGroup):
    """The operators of the panel *Ground* write it; the object's delta transforms then belong to keep_ground.py."""

    keep: BoolProperty(
        name="Keep Every Frame",
        description="Move the object up or down in every frame, so that it follows the ground",
        update=look_again,
    )  # fmt: skip
    how: EnumProperty(
        name="Keep", description="How the object follows the ground",
        items=[(ON, "On Ground", "Stay at the offset from the ground, whatever height its animation gives it"),
               (ABOVE, "Above Ground", "Follow its animation, but never come closer to the ground than the clearance")],
    )  # fmt: skip
    offset: FloatProperty(name="Offset", description="Height of the origin above the ground, in metres", unit="LENGTH")
    clearance: FloatProperty(
        name="Clearance",
        description="Smallest distance from the origin straight down to the ground, in metres",
        default=2.0, min=0.0, unit="LENGTH",
    )  # fmt: skip
    align: BoolProperty(
        name="Align to Normal", description="Tilt the object with the slope: its Z axis follows the ground's normal"
    )
    terrain: PointerProperty(
        name="Terrain",
        description="Terrain that counts as ground. Empty: the highest one at the object's place",
        type=bpy.types.Object, poll=lambda self, item: item.adaptive_terrain.enabled,
    )  # fmt: skip
