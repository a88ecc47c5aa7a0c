# SPDX-License-Identifier: GPL-3.0-or-later
"""Splat layers as data: rules for the cover of the ground. They are hashable and part of keys.

A rule is an interval of one quantity with soft edges; a layer covers a point by its strength times all its rules.
Layers share the ground in proportion; a layer `on_top` takes its share from those before it. The first layer covers
ground without any other.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..errors import TerrainError, check_kind
from ..field.painted import Painted
from ..plain_numbers import keep_plain_numbers, plain_sequence
from .attribute import Parameter
from .layers import NAMES as LAYER_NAMES

MAX_LAYERS = 12
# Limits of a layer's numbers, and of an edge in any unit.
MAX_NUMBER, MAX_EDGE = 1e6, 1e30
# Quantities of rules. RELIEF: height, 0 at the lowest and 1 at the highest point of the terrain. ASPECT: the cosine of
# the angle between downhill and `direction`, 0 on level ground. NOISE: of the layer. LAYER: the cover of `other` by its
# rules. IMAGE: `image` over the raster's extent. Layers of height operators (layers.py) come last.
HEIGHT, RELIEF, SLOPE, ASPECT, CURVATURE = ("height", "relief", "slope", "aspect", "curvature")
FLOW, WETNESS, NOISE, LAYER, IMAGE = ("flow", "wetness", "noise", "layer", "image")
KINDS = (HEIGHT, RELIEF, SLOPE, ASPECT, CURVATURE, FLOW, WETNESS, NOISE, LAYER, IMAGE, *LAYER_NAMES)
# The attribute that each reads; the others read none.
READ_FROM = {
    HEIGHT: "height",
    RELIEF: "height",
    SLOPE: "slope",
    ASPECT: "aspect",
    CURVATURE: "mean_curvature",
    FLOW: "flow",
    WETNESS: "wetness",
    **{name: name for name in LAYER_NAMES},
}


@dataclass(frozen=True)
class Rule:
    """A weight of 1 from `low` to `high`, 0 outside, and a step of width `edge` centred on each limit.

    The step is linear for layer and image, whose values are weights themselves, and smooth for other quantities.
    Units: height m, slope rad, curvature 1 / m (positive on ridges), flow m^2 with an edge in powers of ten, relief,
    aspect, noise (-1 .. 1), layer and image (0 .. 1) none; layers.py has those of layers. `direction`: rad,
    clockwise from north. `other`: index of an earlier layer, for a rule about LAYER. `image`: for one about IMAGE.
    """

    of: str
    low: float = -math.inf
    high: float = math.inf
    edge: float = 0.0
    direction: float = 0.0
    other: int = -1
    image: Painted | None = None

    def __post_init__(self) -> None:
        keep_plain_numbers(self, "A splat rule's")
        check_kind(self.of, str, "A splat rule's of", "the name of a quantity")
        check_kind(self.image, (Painted, type(None)), "A splat rule's image", "one of image_rule, or None")


@dataclass(frozen=True)
class Layer:
    """A layer with its rules.

    `strength`: factor on the product of its rules. `on_top`: it takes its share from the layers before it.
    `noise_size`: longest wave of its noise in metres, 0 for no noise. `ragged`: largest shift of the rules' limits by
    noise, in widths of their edges.
    """

    name: str
    rules: tuple[Rule, ...] = ()
    strength: float = 1.0
    on_top: bool = False
    noise_size: float = 0.0
    ragged: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        keep_plain_numbers(self, "A splat layer's")
        check_kind(self.name, str, "A splat layer's name", "a text")
        object.__setattr__(self, "rules", plain_sequence(self.rules, Rule, "A splat layer's rules", "Rule objects"))


# Default layers: grass, scree and rock by slope, snow above two thirds of the relief.
DEFAULT = (
    Layer("Grass"),
    Layer(
        "Scree", (Rule(SLOPE, low=math.radians(24), edge=math.radians(8)),), on_top=True, noise_size=300.0, ragged=1.0
    ),
    Layer(
        "Rock", (Rule(SLOPE, low=math.radians(36), edge=math.radians(8)),), on_top=True, noise_size=200.0, ragged=0.8
    ),
    Layer(
        "Snow",
        (Rule(RELIEF, low=0.66, edge=0.12), Rule(SLOPE, high=math.radians(48), edge=math.radians(10))),
        on_top=True,
        noise_size=600.0,
        ragged=0.6,
        seed=3,
    ),
)


LAYERS = Parameter("layers", DEFAULT, 1, MAX_LAYERS, "layers", "The layers and their rules: a tuple of Layer")


def cover_rule(other: int) -> Rule:
    """Return a rule whose weight is the cover of the layer with the number `other`."""
    return Rule(LAYER, low=0.5, edge=1.0, other=other)


def image_rule(image: np.ndarray | Painted) -> Rule:
    """Return a rule whose weight is an image's value, float [rows, columns] of 0 to 1, laid over the raster."""
    return Rule(IMAGE, low=0.5, edge=1.0, image=image if isinstance(image, Painted) else Painted(image))


def attributes_of_rules(layers: tuple[Layer, ...]) -> tuple[str, ...]:
    """Return the names of the attributes that the rules of these layers read."""
    return tuple(sorted({READ_FROM[rule.of] for layer in layers for rule in layer.rules if rule.of in READ_FROM}))


def covers_nothing(rule: Rule) -> bool:
    """Return whether a rule's weight is 0 everywhere: its low limit is above the high one, and edges do not overlap."""
    if not rule.low > rule.high:
        return False
    if rule.of != FLOW:
        return rule.low - rule.high >= rule.edge
    # An edge of flow is in powers of ten.
    return rule.high <= 0.0 or math.log10(rule.low) - math.log10(rule.high) >= rule.edge


def check_layers(layers: tuple[Layer, ...]) -> None:
    """Raise TerrainError for too many layers, a number out of range, or a rule that cannot be evaluated."""
    if not 1 <= len(layers) <= MAX_LAYERS:
        raise TerrainError(
            f"There are {len(layers)} splat layers", expected=f"1 to {MAX_LAYERS}", fix="remove some or add one"
        )
    for number, layer in enumerate(layers):
        where = f"The splat layer {layer.name!r}"
        numbers = layer.strength, layer.noise_size, layer.ragged
        if not all(0.0 <= value <= MAX_NUMBER for value in numbers):
            raise TerrainError(
                f"{where} has a strength, noise size and ragged edge of {numbers}", expected=f"0 to {MAX_NUMBER:g}"
            )
        for rule in layer.rules:
            if rule.of not in KINDS:
                raise TerrainError(f"{where} has a rule about {rule.of!r}", expected=f"one of: {', '.join(KINDS)}")
            limits = rule.low, rule.high, rule.edge, rule.direction
            if any(map(math.isnan, limits)) or not 0.0 <= rule.edge <= MAX_EDGE or math.isinf(rule.direction):
                raise TerrainError(
                    f"{where} has a rule about {rule.of} from {rule.low} to {rule.high} with an edge of {rule.edge}",
                    expected=f"numbers, and an edge of 0 to {MAX_EDGE:g}",
                )
            if rule.of == LAYER and not 0 <= rule.other < number:
                raise TerrainError(
                    f"{where} is layer {number} and has a rule about layer {rule.other}",
                    expected="an earlier layer",
                    fix="move it down",
                )
            if rule.of == IMAGE and rule.image is None:
                problem = f"{where} has a painted rule without an image"
                raise TerrainError(problem, fix="choose an image, or switch the rule off")
