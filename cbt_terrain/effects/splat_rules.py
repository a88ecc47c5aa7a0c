# SPDX-License-Identifier: GPL-3.0-or-later
"""Splat layers as data: what covers the ground where, by rules. Hashable, so that they are part of keys.

A rule is a band of one quantity, with soft edges; a layer covers a place by its strength times all its rules. Layers of
a list share the ground in proportion; one that is `on_top` takes its part from those before it. Where nothing covers
the ground the first layer does.
"""

import math
from dataclasses import dataclass

import numpy as np

from ..errors import TerrainError
from ..field.painted import Painted
from ..plain_numbers import keep_plain_numbers
from .effect import Parameter
from .layers import NAMES as LAYER_NAMES

MOST_LAYERS = 12
# Of a layer's own numbers, and of an edge in any unit.
MOST, MOST_EDGE = 1e6, 1e30
# What a rule is about. RELIEF: height, 0 at the lowest and 1 at the highest place of the terrain. ASPECT: the cosine of
# the angle between downhill and `direction`, 0 on level ground. NOISE: of the layer. LAYER: how much of the ground
# `other` covers, by its own rules alone. IMAGE: `image`, over the raster's extent. The layers (layers.py) come last.
HEIGHT, RELIEF, SLOPE, ASPECT, CURVATURE, FLOW, WETNESS, NOISE, LAYER, IMAGE = KINDS = (
    *("height", "relief", "slope", "aspect", "curvature", "flow", "wetness", "noise", "layer", "image"),
)
KINDS += LAYER_NAMES
# The effect that each is read from; the others are read from none.
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
    """1 from `low` to `high` of the quantity `of`, 0 beyond; over `edge`, half on each side of a limit, in between.

    Units: height m, slope rad, curvature 1 / m (positive on ridges), flow m^2 with an edge in powers of ten, relief,
    aspect, noise (-1 .. 1), layer and image (0 .. 1) none; layers.py has those of layers. `direction`: rad,
    clockwise from north. `other`: the number of a layer before this one.
    """

    of: str
    low: float = -math.inf
    high: float = math.inf
    edge: float = 0.0
    direction: float = 0.0
    other: int = -1
    image: Painted | None = None

    def __post_init__(self):
        keep_plain_numbers(self, "A splat rule's")


@dataclass(frozen=True)
class Layer:
    """`noise_size`: metres of the largest waves of its noise, 0 for none, which is then 0. `ragged`: by how many of
    their edges noise moves the limits of rules, at most."""

    name: str
    rules: tuple[Rule, ...] = ()
    strength: float = 1.0
    on_top: bool = False
    noise_size: float = 0.0
    ragged: float = 0.0
    seed: int = 0

    def __post_init__(self):
        keep_plain_numbers(self, "A splat layer's")


# What the ground is without other layers: grass, scree and rock by slope, snow above two thirds of the relief.
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


LAYERS = Parameter("layers", DEFAULT, 1, MOST_LAYERS, "layers", "The layers and their rules: a tuple of Layer")


def covering(other: int) -> Rule:
    """Where another layer covers the ground, and as much."""
    return Rule(LAYER, low=0.5, edge=1.0, other=other)


def painted(image: np.ndarray | Painted) -> Rule:
    """Where an image is 1, and as much."""
    return Rule(IMAGE, low=0.5, edge=1.0, image=image if isinstance(image, Painted) else Painted(image))


def reads(layers: tuple[Layer, ...]) -> tuple[str, ...]:
    """Names of the effects that the rules of these layers are about."""
    return tuple(sorted({READ_FROM[rule.of] for layer in layers for rule in layer.rules if rule.of in READ_FROM}))


def covers_nothing(rule: Rule) -> bool:
    """Whether its low limit is so far above its high one that not even their edges meet."""
    if not rule.low > rule.high:
        return False
    if rule.of != FLOW:
        return rule.low - rule.high >= rule.edge
    return rule.high <= 0.0 or math.log10(rule.low) - math.log10(rule.high) >= rule.edge


def check(layers: tuple[Layer, ...]) -> None:
    """Raise TerrainError for layers that cannot be."""
    if not 1 <= len(layers) <= MOST_LAYERS:
        raise TerrainError(
            f"There are {len(layers)} splat layers; expected 1 to {MOST_LAYERS}: remove some, or add one."
        )
    for number, layer in enumerate(layers):
        where = f"The splat layer {layer.name!r}"
        numbers = layer.strength, layer.noise_size, layer.ragged
        if not all(0.0 <= value <= MOST for value in numbers):
            raise TerrainError(
                f"{where} has a strength, noise size and ragged edge of {numbers}; expected 0 to {MOST:g}."
            )
        for rule in layer.rules:
            if rule.of not in KINDS:
                raise TerrainError(f"{where} has a rule about {rule.of!r}; expected one of: {', '.join(KINDS)}.")
            band = rule.low, rule.high, rule.edge, rule.direction
            if any(map(math.isnan, band)) or not 0.0 <= rule.edge <= MOST_EDGE or math.isinf(rule.direction):
                raise TerrainError(
                    f"{where} has a rule about {rule.of} from {rule.low} to {rule.high} with an edge of {rule.edge}; "
                    f"expected numbers, and an edge of 0 to {MOST_EDGE:g}."
                )
            if rule.of == LAYER and not 0 <= rule.other < number:
                raise TerrainError(
                    f"{where} is layer {number} and asks for layer {rule.other}; expected one before it: move it down."
                )
            if rule.of == IMAGE and rule.image is None:
                raise TerrainError(f"{where} has a painted rule without an image; choose one, or switch the rule off.")
