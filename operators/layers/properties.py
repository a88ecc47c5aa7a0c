# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the splat layers of a terrain (`object.adaptive_terrain.layers`), and the one place that reads them."""

import math
from dataclasses import replace

import bpy
import numpy as np
from bpy.props import (
    BoolProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ...cbt_terrain.attributes import splat_rules as rules
from ...cbt_terrain.attributes.color import DEFAULT_COLORS
from ...cbt_terrain.errors import TerrainError
from ..terrain.detail_properties import changed
from ..terrain.displacement_properties import DisplacementSettings, is_gray
from .images import painted_of


def band(
    label: str,
    about: str,
    low: float,
    high: float,
    edge: float,
    ends: tuple[float, float],
    decades: bool = False,
    **options,
) -> type:
    """Return a PropertyGroup class for a rule about one quantity: a switch, a low and a high limit, and a soft edge.

    label, about: name of the quantity, and a phrase for tooltips. low, high, edge: defaults. ends: range of the limits;
    a limit at an end of the range is open. decades: the edge is in powers of ten, so it has no unit. options: further
    arguments of the limits.
    """
    lowest, highest = ends
    options = {"min": lowest, "max": highest, "update": changed, "precision": 3} | options
    left_out = ("min", "max", "unit") if decades else ("min", "max")  # the edge has its own
    edge_options = {name: value for name, value in options.items() if name not in left_out}
    limits = {
        "use": BoolProperty(name=label, description=f"Limit to ground with a certain {about}", update=changed),
        "low": FloatProperty(name="From", description=f"Lower limit of the {about}", default=low, **options),
        "high": FloatProperty(name="To", description=f"Upper limit of the {about}", default=high, **options),
        "edge": FloatProperty(
            name="Edge",
            description="Width of the soft transition at each limit; 0 is a hard border"
            + (". In powers of ten" if decades else ""),
            default=edge, min=0.0, max=min(highest - lowest, rules.MAX_EDGE), **edge_options,
        ),
    }  # fmt: skip
    members = {"__annotations__": limits, "__doc__": about}
    return type(f"AdaptiveTerrainLayer{label.replace(' ', '')}", (bpy.types.PropertyGroup,), members)


_HALF_TURN = math.pi / 2
MAX_FLOAT = float(np.finfo(np.float32).max)  # panels show it as "inf"
# Kind of rule -> its group. The order is that of the panel.
BANDS = {
    rules.RELIEF: band("Relief", "relative height: 0 at the lowest point, 1 at the highest", 0, 1, 0.1, (0, 1)),
    rules.HEIGHT: band("Height", "height", -1e5, 1e5, 50.0, (-1e5, 1e5), unit="LENGTH"),
    rules.SLOPE: band("Slope", "slope: 90° is upright", 0, _HALF_TURN, 0.15, (0, _HALF_TURN), subtype="ANGLE"),
    rules.CURVATURE: band("Curvature", "curvature (1/m): above 0 on ridges, below 0 in hollows",
                           -10, 10, 0.01, (-10, 10)),
    rules.FLOW: band("Flow", "area that drains through it: large in streams", 0, MAX_FLOAT, 1.0,
                     (0, MAX_FLOAT), decades=True, unit="AREA", step=100),
    rules.WETNESS: band("Wetness", "wetness: about 3 on slopes, 12 in valleys", -50, 50, 2, (-50, 50)),
    **{
        name: band(label, f"depth of {what}, made by land effects", 0.5, 1e4, 0.5, (0, 1e4), unit="LENGTH")
        for name, label, what in (
            ("wear", "Wear", "rock that erosion has removed"),
            ("sediment", "Sediment", "the material that rivers have deposited"),
            ("scree", "Scree", "loose stones"),
            ("snow", "Snow", "snow"),
            ("water_depth", "Water Depth", "water"),
        )
    },
    rules.NOISE: band("Patches", "value of the layer's noise, from -1 to 1, for patches", 0, 1, 0.3, (-1, 1)),
}  # fmt: skip


class AspectSettings(bpy.types.PropertyGroup):
    """Which way the ground faces."""

    use: BoolProperty(name="Aspect", description="Limit to ground that faces a certain direction", update=changed)
    direction: FloatProperty(
        name="Towards",
        description="Compass direction in which the ground falls, clockwise from north: 90° is east",
        min=0.0, max=math.tau, subtype="ANGLE", update=changed,
    )  # fmt: skip
    within: FloatProperty(
        name="Within",
        description="Largest angle from that direction",
        default=math.radians(60), min=0.0, max=math.pi, subtype="ANGLE", update=changed,
    )  # fmt: skip
    edge: FloatProperty(
        name="Edge",
        description="Width of the soft transition, as a difference of cosines; 0 is a hard border",
        default=0.4, min=0.0, max=2.0, precision=3, update=changed,
    )  # fmt: skip


def _on_rename(self, context) -> None:
    """Update the layers' masks and the scatters that name a layer, after the user has renamed it.

    They stay if another layer still has the name.
    """
    terrain, before = self.id_data, self.last_name
    self.last_name = self.name
    layers = terrain.adaptive_terrain.layers
    if before and before not in [layer.name for layer in layers]:
        for layer in layers:
            if layer.mask == before:
                layer.mask = self.name
        for child in terrain.children:
            if child.adaptive_scatter.layer == before:
                child.adaptive_scatter.layer = self.name
    changed(self, context)


class LayerSettings(bpy.types.PropertyGroup):
    """A splat layer: its colour, and the rules for the ground that it covers."""

    name: StringProperty(name="Name", default="Layer", update=_on_rename)
    last_name: StringProperty(options={"HIDDEN"})
    color: FloatVectorProperty(
        name="Color",
        description="Colour of the ground in the terrain's material where this layer is",
        subtype="COLOR", size=3, min=0.0, max=1.0, default=(0.3, 0.3, 0.3),
    )  # fmt: skip
    strength: FloatProperty(
        name="Strength", description="How much of the ground the layer covers where its rules hold: 0 is nothing, 1 is "
        "all", default=1.0, min=0.0, max=1.0,
        subtype="FACTOR", update=changed,
    )  # fmt: skip
    on_top: BoolProperty(
        name="On Top",
        description="Cover the layers above it in the list; otherwise share the ground with them",
        default=True, update=changed,
    )  # fmt: skip
    noise_size: FloatProperty(
        name="Noise Size", description="Size of the largest patches of the layer's noise",
        default=200.0, min=0.001, max=1e6, unit="LENGTH", update=changed,
    )  # fmt: skip
    ragged: FloatProperty(
        name="Ragged Edges",
        description="How much noise moves the borders of the layer, in widths of their soft transition; 0: not at all",
        default=0.8, min=0.0, max=100.0, soft_max=2.0, precision=2, update=changed,
    )  # fmt: skip
    seed: IntProperty(
        name="Seed", description="Another number gives another pattern of noise", default=0, min=0, update=changed
    )
    aspect: PointerProperty(type=AspectSettings)
    mask: StringProperty(
        name="Mask", description="Show this layer only where another one is, which is above it in the list",
        update=changed,
    )  # fmt: skip
    image: PointerProperty(
        name="Painted",
        description="Painted image over the whole terrain, north up: the layer is where its red channel is 1",
        type=bpy.types.Image, poll=is_gray, update=changed,
    )  # fmt: skip
    detail: PointerProperty(type=DisplacementSettings)


for _kind, _group in BANDS.items():
    LayerSettings.__annotations__[_kind] = PointerProperty(type=_group)


def set_band(band, low: float, high: float, edge: float) -> None:
    """Switch a band of BANDS on, with these limits; an infinite one is open, and becomes an end of the band's range."""
    ends = band.bl_rna.properties["low"]
    band.use, band.edge = True, edge
    band.low, band.high = max(low, ends.hard_min), min(high, ends.hard_max)


def add_default_layers(settings) -> None:
    """Add the default layers to a terrain that has none, for the user to change: grass, scree, rock and snow."""
    for declared, color in zip(rules.DEFAULT, DEFAULT_COLORS, strict=True):
        layer = settings.layers.add()
        for name in ("name", "strength", "on_top", "noise_size", "ragged", "seed"):
            setattr(layer, name, getattr(declared, name))
        layer.color = color
        for rule in declared.rules:
            set_band(getattr(layer, rule.of), rule.low, rule.high, rule.edge)


MIN_NOISE_M = 0.002  # metres: a property cannot hold the size 0 of no noise


def has_default_layers(settings) -> bool:
    """Return whether the layers of a terrain are those of `add_default_layers`, unchanged.

    Numbers are compared with a tolerance, since properties are float32 and cannot hold a noise size of 0.
    """
    layers = settings.layers
    if len(layers) != len(rules.DEFAULT) or any(layer.mask or layer.detail.amplitude for layer in layers):
        return False
    found = [layer_alone(layer) for layer in layers]
    if [_exact_values(layer) for layer in found] != [_exact_values(layer) for layer in rules.DEFAULT]:
        return False
    colors = np.ravel([layer.color for layer in layers]), np.ravel(DEFAULT_COLORS)
    numbers = (np.concatenate([_numbers(layer) for layer in either]) for either in (found, rules.DEFAULT))
    return np.allclose(*colors, rtol=1e-6) and np.allclose(*numbers, rtol=1e-6, atol=MIN_NOISE_M)


def _exact_values(layer: rules.Layer) -> tuple:
    """Return the values of a splat layer that must be equal for two layers to count as equal: texts, flags and seed."""
    return layer.name, layer.on_top, layer.seed, tuple(rule.of for rule in layer.rules)


def _numbers(layer: rules.Layer) -> list[float]:
    """Return the numbers of a splat layer and its rules, which are compared with a tolerance."""
    limits = (number for rule in layer.rules for number in (rule.low, rule.high, rule.edge))
    return [layer.strength, layer.noise_size, layer.ragged, *limits]


def layers_of(settings) -> tuple[rules.Layer, ...]:
    """Return the layers in the list of a terrain's settings for the engine, () without any.

    Raises TerrainError for an invalid one, as with an image that cannot be read.
    """
    found = tuple(_layer_of(settings.layers, number) for number in range(len(settings.layers)))
    if found:
        rules.check_layers(found)
    return found


def layer_parameters(settings) -> dict[str, object]:
    """Return the parameter "layers" of the splat attributes; {} without any in the list, which means the default ones.

    Raises TerrainError for an invalid layer.
    """
    layers = layers_of(settings)
    return {"layers": layers} if layers else {}


def color_parameters(settings) -> dict[str, object]:
    """Return the parameters "layers" and "colors" of the attribute "color"; {} without layers in the list.

    Raises TerrainError for an invalid layer.
    """
    layers = layer_parameters(settings)
    return layers | {"colors": tuple(color for _, color in colors_of(settings))} if layers else {}


def colors_of(settings) -> list[tuple[str, tuple[float, float, float]]]:
    """Return name and linear RGB of the layers of `layers_of`, or of the default layers if there are none."""
    if not len(settings.layers):
        return list(zip((layer.name for layer in rules.DEFAULT), DEFAULT_COLORS, strict=True))
    return [(layer.name, tuple(layer.color)) for layer in settings.layers]


def _layer_of(layers, number: int) -> rules.Layer:
    """Return the layer at position `number` of the list, with its mask by a layer above it as one rule more.

    Raises TerrainError if that is not above it.
    """
    settings = layers[number]
    alone = layer_alone(settings)
    if not settings.mask:
        return alone
    return replace(alone, rules=(*alone.rules, rules.cover_rule(_mask_position(layers, settings.mask, number))))


def layer_alone(settings) -> rules.Layer:
    """Return the layer of a LayerSettings with its own rules, without its mask by another layer.

    The rule of aspect has the cosine of the largest angle from its direction, which is in radians, as its low limit.
    settings: a LayerSettings, of a layer or a scatter. Raises TerrainError for an image that cannot be read.
    """
    layer_rules = []
    for kind in BANDS:
        band = getattr(settings, kind)
        if band.use:
            layer_rules.append(rule_of(kind, band))
    if settings.aspect.use:
        aspect = settings.aspect
        layer_rules.append(
            rules.Rule(rules.ASPECT, math.cos(aspect.within), edge=aspect.edge, direction=aspect.direction)
        )
    if settings.image is not None:
        layer_rules.append(rules.image_rule(painted_of(settings.image)))
    names = ("name", "strength", "on_top", "noise_size", "ragged", "seed")
    return rules.Layer(rules=tuple(layer_rules), **{name: getattr(settings, name) for name in names})


def rule_of(kind: str, band) -> rules.Rule:
    """Return the rule of a band of BANDS, whether or not it is switched on; a limit at an end of its range is open."""
    limits = band.bl_rna.properties["low"]
    low = -math.inf if band.low <= limits.hard_min else band.low
    high = math.inf if band.high >= limits.hard_max else band.high
    return rules.Rule(kind, low, high, band.edge)


def empty_layers_note(layers: tuple[rules.Layer, ...]) -> str:
    """Return a sentence that names the layers that cover nothing anywhere and why; "" if there are none."""
    notes = []
    for layer in layers:
        kinds = [rule.of for rule in layer.rules if rules.covers_nothing(rule)]
        labels = [BANDS[kind].bl_rna.properties["use"].name for kind in kinds]
        notes += [f"{layer.name} covers nothing: From is above To in {' and '.join(labels)}"] if kinds else []
    return "; ".join(notes)


def _mask_position(layers, name: str, before: int) -> int:
    """Return the position of the first layer `name`, which masks the layer at `before` and must be above it.

    Raises TerrainError if no such layer is above.
    """
    for number in range(before):
        if layers[number].name == name:
            return number
    raise TerrainError(
        f"The splat layer {layers[before].name!r} is masked by {name!r}",
        expected="a layer above it in the list",
        fix="move that one up, or choose another",
    )
