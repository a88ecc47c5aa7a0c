# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of effects: `object.adaptive_terrain.effects.<name>`, made from the effects' declarations."""

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty, IntProperty, PointerProperty

from ...cbt_terrain.attributes.attribute import AttributeDeclaration, Parameter
from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
from ..terrain.detail_properties import changed

ON_DEMAND, PINNED, OFF = "DEMAND", "PINNED", "OFF"
WHEN = [
    (ON_DEMAND, "On Demand", "Compute it only if a material, a modifier, a driver or an export uses it", "LINKED", 0),
    (PINNED, "Pinned", "Compute it always, for scripts that read it; updates take longer", "PINNED", 1),
    (OFF, "Off", "Materials read 0, which saves time; other attributes may still use it", "CANCEL", 2),
]


def is_number(parameter: Parameter) -> bool:
    """Return whether a parameter is a number, which gets a setting; others are gathered from the scene."""
    return isinstance(parameter.default, int | float)


def changed_numbers(settings, name: str) -> tuple[tuple[str, float], ...]:
    """Return (name, value) of an attribute's parameters that differ from their defaults in a terrain's settings.

    Values are clamped to the declared ranges.
    """
    group, found = getattr(settings.effects, name), []
    for parameter in filter(is_number, ATTRIBUTES[name].parameters):
        value = getattr(group, parameter.name)
        if np.float32(value) != np.float32(parameter.default):  # Blender stores float32
            found.append((parameter.name, min(max(value, parameter.min), parameter.max)))
    return tuple(found)


def _make_property(parameter: Parameter):
    """Return the Blender property for a declared parameter."""
    about = f"{parameter.about} ({parameter.unit})" if parameter.unit else parameter.about
    label = parameter.name.replace("_", " ").title()
    options = {"name": label, "description": about, "default": parameter.default, "update": changed}
    if isinstance(parameter.default, int):
        return IntProperty(**options, min=int(parameter.min), max=int(parameter.max))
    return FloatProperty(**options, min=parameter.min, max=parameter.max, precision=3)


def _make_group(effect: AttributeDeclaration) -> type:
    """Return a PropertyGroup class for an attribute, not registered: when it is computed, and its numbers."""
    when = EnumProperty(name=effect.name, description=effect.about, items=WHEN, update=changed)
    numbers = {parameter.name: _make_property(parameter) for parameter in filter(is_number, effect.parameters)}
    members = {"__annotations__": {"when": when} | numbers, "__doc__": effect.about}
    return type(f"AdaptiveTerrainEffect_{effect.name}", (bpy.types.PropertyGroup,), members)


GROUPS = {name: _make_group(effect) for name, effect in ATTRIBUTES.items()}
_scale = FloatProperty(
    name="Geometry Scale",
    description="Size of the smallest forms that modifiers and geometry nodes see in attributes: larger is smoother. 0 "
    "is the distance between the heights of the file",
    default=0.0, min=0.0, soft_max=1000.0, precision=2, unit="LENGTH", update=changed,
)  # fmt: skip
_active = IntProperty(
    name="Chosen Attribute",
    description="Row of the list whose details are shown",
    default=2, options=set(),
)  # fmt: skip
EffectsSettings = type(
    "AdaptiveTerrainEffects",
    (bpy.types.PropertyGroup,),
    {
        "__annotations__": {name: PointerProperty(type=group) for name, group in GROUPS.items()}
        | {"geometry_metres": _scale, "active": _active},
        "__doc__": "When effects are computed, and with which numbers; a member for each, of the effect's name.",
    },
)
