# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects on heights of the tests' own, whose results are known: a smoothing, a hill with a layer, one of the whole."""

import math

import numpy as np
from adaptive_terrain.cbt_terrain.attributes.attribute import Parameter
from adaptive_terrain.cbt_terrain.height_operators.height_operator import Change, HeightOperator, LandLayer

SWEEPS = 4


def diffuse(ground, values, coarser):
    """Explicit diffusion: sweeps at half the stable step on each level, from the coarser change."""
    change = np.zeros_like(ground.heights) if coarser is None else coarser.heights.copy()
    for _ in range(int(values["sweeps"])):
        z = np.pad(ground.heights + change, 1, mode="edge")
        around = z[:-2, 1:-1] + z[2:, 1:-1] + z[1:-1, :-2] + z[1:-1, 2:]
        change = change + np.float32(0.125) * (around - 4 * z[1:-1, 1:-1])
        ground.progress(0.5)
    return Change(change, {"worn": np.maximum(-change, 0)})


def raise_hill(ground, values, coarser):
    """Raise a cone around a place, in metres from the raster's south-western sample; add a layer of it."""
    rows, columns = (np.arange(n) + first for n, first in zip(ground.heights.shape, ground.first, strict=True))
    north, east = rows * ground.step_y - values["north"], columns * ground.step_x - values["east"]
    away = np.sqrt((north**2)[:, None] + east**2)
    hill = np.maximum(values["height"] * (1 - away / values["radius"]), 0).astype(np.float32)
    return Change(hill, {"fresh": hill, "mark": np.full_like(hill, values["height"])})


def level_out(ground, values, coarser):
    """Move heights towards their mean; pass on twice the layer that was read."""
    assert ground.heights.shape == ground.whole
    worn = ground.layers.get("worn", np.zeros_like(ground.heights))
    change = (np.float32(ground.heights.mean()) - ground.heights) * np.float32(values["part"])
    return Change(change, {"twice": 2 * worn})


def _example(_evaluate):
    pass


SMOOTH = HeightOperator(
    "smooth",
    "Smooth",
    "Diffusion",
    diffuse,
    _example,
    parameters=(Parameter("sweeps", SWEEPS, 1, 100, "", ""),),
    layers=(LandLayer("worn", "m", ""),),
    halo=lambda values, step: values["sweeps"] * step,
    cost_ns=20,
)
HILL = HeightOperator(
    "hill",
    "Hill",
    "A cone",
    raise_hill,
    _example,
    parameters=(
        Parameter("height", 100.0, -1e4, 1e4, "m", ""),
        Parameter("radius", 500.0, 1, 1e6, "m", ""),
        Parameter("east", 1000.0, 0, 1e6, "m", ""),
        Parameter("north", 1000.0, 0, 1e6, "m", ""),
    ),
    layers=(LandLayer("fresh", "m", ""), LandLayer("mark", "m", "", adds_up=False)),
    cost_ns=10,
)
LEVEL = HeightOperator(
    "level",
    "Level",
    "Towards the mean",
    level_out,
    _example,
    parameters=(Parameter("part", 0.25, 0, 1, "", ""),),
    layers=(LandLayer("twice", "m", ""),),
    reads=("worn",),
    halo=lambda _values, _step: math.inf,
    cost_ns=5,
)
OWN = {effect.name: effect for effect in (SMOOTH, HILL, LEVEL)}


def bumpy(rows: int, columns: int, seed: int = 0) -> np.ndarray:
    """float32 [rows, columns] m: a land of some hundred metres with waves of all lengths and a little noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:rows, 0:columns] / 97.0
    land = sum(np.sin(f * x + rng.uniform(0, 6)) * np.cos(f * y + rng.uniform(0, 6)) / f for f in (1, 2, 5, 11, 23))
    return (200 * land + 2 * rng.standard_normal((rows, columns))).astype(np.float32)


def ragged(rows: int, columns: int, seed: int = 5) -> np.ndarray:
    """float32 [rows, columns] m: waves of every length, of random phase, whose slopes grow towards the shortest."""
    away = np.hypot(rows * np.fft.fftfreq(rows)[:, None], columns * np.fft.rfftfreq(columns))
    away[0, 0] = np.inf
    noise = np.fft.rfft2(np.random.default_rng(seed).standard_normal((rows, columns)))
    land = np.fft.irfft2(noise * away**-1.4, s=(rows, columns))
    return (800.0 + 250.0 / land.std() * land).astype(np.float32)
