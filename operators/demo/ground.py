# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers of the demo's island by height, slope, sediment, scree and snow."""

import math
from dataclasses import dataclass, field

from ..layers.properties import set_band

UP_TO_34, FROM_43, FROM_53 = (math.radians(degrees) for degrees in (34.0, 43.0, 53.0))
NARROW = math.radians(7.0)
OPEN = math.inf


@dataclass(frozen=True)
class Cover:
    """A layer of the ground.

    Attributes:
        color: linear RGB.
        noise: size of the noise in metres.
        bands: limits (low, high, edge) by quantity; infinite ones are open.
        ragged: largest shift of the limits by the noise, in widths of their edges.
        strength: factor on the weight that the limits give.
    """

    name: str
    color: tuple[float, float, float]
    noise: float
    bands: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    ragged: float = 1.0
    strength: float = 1.0


# From the lowest to the highest.
COVERS = (
    Cover("Grass", (0.085, 0.098, 0.033), 300.0),
    Cover("Heath", (0.098, 0.078, 0.042), 420.0, {"height": (330.0, OPEN, 220.0)}, 1.4, 0.85),
    Cover(
        "Forest", (0.030, 0.044, 0.017), 260.0, {"height": (14.0, 360.0, 90.0), "slope": (-OPEN, UP_TO_34, NARROW)}, 1.6
    ),
    Cover("Meadow", (0.098, 0.108, 0.034), 150.0, {"sediment": (1.5, OPEN, 1.5), "height": (3.0, OPEN, 3.0)}, 0.8),
    Cover("Scree", (0.135, 0.124, 0.114), 120.0, {"scree": (2.0, OPEN, 3.0)}, 0.8),
    Cover("Rock", (0.086, 0.077, 0.069), 90.0, {"slope": (FROM_43, OPEN, NARROW)}, 1.2),
    Cover("Cliff", (0.050, 0.047, 0.046), 60.0, {"slope": (FROM_53, OPEN, NARROW)}, 1.0),
    Cover("Beach", (0.25, 0.21, 0.155), 80.0, {"height": (-OPEN, 1.1, 1.0), "slope": (-OPEN, UP_TO_34, NARROW)}, 0.6),
    Cover("Snow", (0.84, 0.87, 0.92), 60.0, {"snow": (0.4, OPEN, 0.2)}, 0.6),
)


def set_layers(settings) -> None:
    """Replace the layers of a terrain's settings by COVERS."""
    settings.layers.clear()
    for number, cover in enumerate(COVERS):
        layer = settings.layers.add()
        layer.name, layer.color, layer.noise_size = cover.name, cover.color, cover.noise
        layer.ragged, layer.strength, layer.seed = cover.ragged, cover.strength, number
        for quantity, limits in cover.bands.items():
            set_band(getattr(layer, quantity), *limits)
