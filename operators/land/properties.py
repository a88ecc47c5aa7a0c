# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the stack that shapes the land: `object.adaptive_terrain.land`, made from the effects' declarations."""

import math

import bpy
import numpy as np
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ...cbt_terrain.attributes import splat_rules as rules
from ...cbt_terrain.attributes.attribute import Parameter
from ...cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS, RENAMED
from ...cbt_terrain.height_operators.height_operator import HeightOperator
from ...cbt_terrain.height_operators.mask import HEIGHT, SLOPE
from ..layers.properties import BANDS, AspectSettings, band
from ..terrain.detail_properties import changed
from ..text.numbers import unit_text

EVERYWHERE, BY_RULE, BY_IMAGE, BY_OBJECT = "NONE", "RULE", "IMAGE", "OBJECT"
EVERYWHERE_FINE, SEEN = "WHOLE", "SEEN"
DEGREES = "degrees"
# Blender's name for the unit of a declaration; other units are written into the label.
UNITS = {
    "m": {"unit": "LENGTH"},
    "m2": {"unit": "AREA"},
    "m3": {"unit": "VOLUME"},
    "m/s": {"unit": "VELOCITY"},
    DEGREES: {"subtype": "ANGLE"},
}
LABEL = 15  # characters of a name that a panel of the usual width shows
MAX_SEED = 2**31 - 1
# Nothing here is animated: other numbers are another land, which takes its time.
STILL = {"update": changed, "options": set()}


def number_of(parameter: Parameter, group) -> float:
    """Return a parameter's value from an entry's property group, in the declared unit and range.

    Blender stores float32: a value that equals the default in float32 is returned as the exact default, and others with
    seven digits. A value that is not finite counts as the default.
    """
    value = getattr(group, parameter.name)
    if isinstance(parameter.default, int):
        return min(max(value, int(parameter.min)), int(parameter.max))
    if np.float32(value) == np.float32(_to_blender(parameter, parameter.default)) or not math.isfinite(value):
        return parameter.default
    value = math.degrees(value) if parameter.unit == DEGREES else value
    return min(max(float(f"{value:.7g}"), parameter.min), parameter.max)


def set_number(parameter: Parameter, group, value: float) -> None:
    """Set a parameter's number in a property group, in the declaration's unit."""
    setattr(group, parameter.name, value if isinstance(parameter.default, int) else _to_blender(parameter, value))


def _to_blender(parameter: Parameter, value: float) -> float:
    """Convert a parameter's value from its declared unit to Blender's: degrees to radians."""
    return math.radians(value) if parameter.unit == DEGREES else value


def _make_property(parameter: Parameter):
    """Return the Blender property for a declared parameter, with its label, unit, range and default.

    A unit that Blender does not know is written into the label, or into the tooltip if the label gets too long.
    """
    blender_unit, about = UNITS.get(parameter.unit, {}), parameter.about
    label = parameter.name.replace("_", " ").title()
    if parameter.unit and not blender_unit and parameter.unit != parameter.name:
        unit = unit_text(parameter.unit)
        with_unit = f"{label} ({unit})"
        label, about = (with_unit, about) if len(with_unit) <= LABEL else (label, f"{about} ({unit})")
    options = {"name": label, "description": about} | STILL  # which forbids animation
    if isinstance(parameter.default, int):
        return IntProperty(**options, default=parameter.default, min=int(parameter.min), max=int(parameter.max))
    low, high, default = (_to_blender(parameter, value) for value in (parameter.min, parameter.max, parameter.default))
    if not parameter.unit and (low, high) == (0.0, 1.0):
        blender_unit = {"subtype": "FACTOR"}
    # Decimals for four significant digits of the default; if that is 0, of the maximum, and then three at least.
    decimals = min(6, max(0 if default else 3, 3 - math.floor(math.log10(abs(default) or high))))
    return FloatProperty(**options, default=default, min=low, max=high, precision=decimals, **blender_unit)


def _make_group(effect: HeightOperator) -> type:
    """Return a PropertyGroup class with a property for each parameter of a height operator."""
    numbers = {parameter.name: _make_property(parameter) for parameter in effect.parameters}
    members = {"__annotations__": numbers, "__doc__": effect.about}
    return type(f"AdaptiveTerrainLand_{effect.name}", (bpy.types.PropertyGroup,), members)


GROUPS = {name: _make_group(effect) for name, effect in HEIGHT_OPERATORS.items()}
EARLIER_GROUPS = {before: GROUPS[now] for before, now in RENAMED.items()}  # of entries in older files


# What rules of masks are about -> its group, in the order of the menu. Numbers: default limits and edge, range.
RULES = {
    HEIGHT: BANDS[rules.HEIGHT],
    SLOPE: BANDS[rules.SLOPE],
    "mean_curvature": BANDS[rules.CURVATURE],
    "profile_curvature": band(
        "Profile Curvature", "curvature downhill (1/m): above 0 where it gets steeper", 0, 10, 0.01, (-10, 10)
    ),
    "plan_curvature": band(
        "Plan Curvature", "curvature of contour lines (1/m): above 0 on ridges", 0, 10, 0.01, (-10, 10)
    ),
    "flow": BANDS[rules.FLOW],
    "wetness": BANDS[rules.WETNESS],
    "sky": band("Sky", "share of visible sky: 1 on open level ground, less in gorges", 0.8, 1, 0.1, (0, 1)),
    **{name: BANDS[name] for name in ("wear", "sediment", "scree", "snow", "water_depth")},
    "slides": band(
        "Slides", "depth of snow from avalanches (m): below 0 where it slid away", 0.5, 1e4, 0.5, (-1e4, 1e4)
    ),
    "water_speed": band("Water Speed", "speed of the water (m/s)", 0.5, 1e3, 0.5, (0, 1e3)),
    "discharge": band("Discharge", "amount of water that passes (m³/s)", 1, 1e6, 1, (0, 1e6), decades=True, step=100),
}


class LandMask(bpy.types.PropertyGroup):
    """Where an effect acts, and how much."""

    kind: EnumProperty(
        name="Mask", description="Where the effect acts",
        items=[(EVERYWHERE, "Everywhere", "The effect acts on the whole terrain"),
               (BY_RULE, "Rule", "The effect acts where the ground has a certain height, slope, direction or other "
                                 "property"),
               (BY_IMAGE, "Image", "The effect acts where a painted image over the terrain is bright"),
               (BY_OBJECT, "Object", "The effect acts inside the outline of an object, seen from above")],
        **STILL,
    )  # fmt: skip
    factor: FloatProperty(
        name="Amount", description="Strength of the effect inside the mask: 0 is none, 1 is all",
        default=1.0, min=0.0, max=1.0, subtype="FACTOR", **STILL,
    )  # fmt: skip
    image: PointerProperty(
        name="Image",
        description="Image over the whole terrain, north up: its red channel is the strength of the effect",
        type=bpy.types.Image, poll=lambda self, item: item.source in {"FILE", "GENERATED"}, **STILL,
    )  # fmt: skip
    object: PointerProperty(
        name="Object", description="Mesh whose outline from above is the mask; it may be hidden",
        type=bpy.types.Object, poll=lambda self, item: item.type == "MESH" and item != self.id_data, **STILL,
    )  # fmt: skip
    aspect: PointerProperty(type=AspectSettings)


for _name, _group in RULES.items():
    LandMask.__annotations__[_name] = PointerProperty(type=_group)


class LandEntry(bpy.types.PropertyGroup):
    """One effect of the stack. Its numbers are in the member of the effect's name."""

    name: StringProperty(name="Name", description="As the list shows it")
    effect: StringProperty(name="Effect", description="Kind of the land effect", **STILL)
    on: BoolProperty(name="Switched On", description="Use this effect", default=True, **STILL)
    seed: IntProperty(
        name="Seed", description="Another number gives another random pattern", default=0, min=0, max=MAX_SEED, **STILL
    )
    mask: PointerProperty(type=LandMask)


for _name, _group in (GROUPS | EARLIER_GROUPS).items():
    LandEntry.__annotations__[_name] = PointerProperty(type=_group)


class LandSettings(bpy.types.PropertyGroup):
    """Effects on heights, in the order in which they act."""

    entries: CollectionProperty(type=LandEntry)
    where: EnumProperty(
        name="Detail",
        description="Where the land is shaped in full detail",
        items=[(EVERYWHERE_FINE, "Everywhere", "The whole terrain, as fine as its height map"),
               (SEEN, "In the Shot", "Only what the frames of the scene show, as fine as they show it; the rest stays "
                                     "coarse. It saves time on large terrains")],
        **STILL,
    )  # fmt: skip
    active: IntProperty(name="Active", options=set())


OTHER_RULES = [group for group in RULES.values() if group not in BANDS.values()]
