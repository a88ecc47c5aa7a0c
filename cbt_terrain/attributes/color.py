# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour: the weighted colours of the splat layers, with decals over it."""

import math
from collections.abc import Mapping

import numpy as np

from ..errors import TerrainError
from . import splat
from .attribute import LINEAR_RGB, AttributeDeclaration, Evaluate, Parameter, SamplePoints, Wanted
from .decals import DECALS, cover
from .splat_rules import LAYERS, Layer

# Linear colours of the default layers: grass, scree, rock and snow.
DEFAULT_COLORS = ((0.07, 0.11, 0.03), (0.24, 0.2, 0.16), (0.13, 0.12, 0.115), (0.85, 0.88, 0.93))


def make(points: SamplePoints, wanted: Wanted, read: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Compute the attribute color at points: colours of the splat layers times their weights, decals over it.

    wanted: {"color": parameters: layers, colors (linear RGB of each layer), decals}. read: the attributes that the
    layers' rules read. Returns {"color": float32 [n, 3], linear}. Raises TerrainError unless each layer has a colour.
    """
    values = wanted["color"]
    layers, colors = values["layers"], values["colors"]
    if len(layers) != len(colors):
        raise TerrainError(
            f"There are {len(layers)} splat layers and {len(colors)} colours", expected="a colour for each layer"
        )
    names = splat.NAMES[: -(-len(layers) // 4)]  # each attribute splat_1, splat_2 .. has the weights of four layers
    weights = splat.make(points, {name: {"layers": layers} for name in names}, read)
    blend = np.zeros((len(points), 3), np.float32)
    for number, color in enumerate(colors):
        blend += weights[names[number // 4]][:, number % 4, None] * np.array(color, np.float32)
    cover(blend, values["decals"], points)
    return {"color": blend}


def example(evaluate: Evaluate) -> None:
    """Assert that ground covered by one layer has its colour."""
    green = (0.25, 0.5, 0.125)
    assert (evaluate("color", np.zeros((9, 9)), step=10.0, layers=(Layer("Grass"),), colors=(green,)) == green).all()


COLOR = AttributeDeclaration(
    name="color",
    about="Colour of the ground: the colours of the layers by their shares, with decals on top",
    unit=LINEAR_RGB,
    make=make,
    kernels=("effects.splat",),
    example=example,
    width=3,
    span=(0.0, 1.0),
    reads=splat.SPLATS[0].reads,
    choose=splat.SPLATS[0].choose,
    parameters=(
        LAYERS,
        Parameter("colors", DEFAULT_COLORS, 0, math.inf, "", "Red, green and blue of each layer"),
        DECALS,
    ),
    halo=splat.SPLATS[0].halo,
    cost_ns=150,
    source='The layers\' weights; Porter and Duff 1984, "Compositing digital images" (over)',
)
