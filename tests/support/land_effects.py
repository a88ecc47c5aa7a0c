# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects on heights of the tests' own, whose results are known: a smoothing, a hill with a layer, one of the whole."""

import numpy as np
from adaptive_terrain.cbt_terrain.effects.effect import Parameter
from adaptive_terrain.cbt_terrain.land.land_effect import Change, LandEffect, Layer

SWEEPS = 4


def diffuse(ground, values, coarser):
    """Explicit diffusion by sweeps of half the stable step: on each level so many, from the coarser change on."""
    start = np.zeros_like(ground.heights) if coarser is None else coarser.heights
    change = start.copy()
    for _ in range(int(values["sweeps"])):
        z = np.pad(ground.heights + change, 1, mode="edge")
        change = change + np.float32(0.125) * (
            z[:-2, 1:-1] + z[2:, 1:-1] + z[1:-1, :-2] + z[1:-1, 2:] - 4 * z[1:-1, 1:-1]
        )
        ground.progress(0.5)
    return Change(change, {"worn": np.maximum(-change, 0)})


def raise_hill(ground, values, coarser):
    """A cone about a place of the raster, in metres from its south-western sample; what it adds is a layer."""
    rows, columns = (np.arange(n) + first for n, first in zip(ground.heights.shape, ground.first, strict=True))
    away = np.sqrt(
        ((rows * ground.step_y - values["north"]) ** 2)[:, None] + (columns * ground.step_x - values["east"]) ** 2
    )
    hill = np.maximum(values["height"] * (1 - away / values["radius"]), 0).astype(np.float32)
    return Change(hill, {"fresh": hill, "mark": np.full_like(hill, values["height"])})


def level_out(ground, values, coarser):
    """Towards the mean of everything: of the whole raster alone."""
    assert ground.heights.shape == ground.whole
    worn = ground.layers["worn"].mean() if "worn" in ground.layers else 0
    return Change(
        (np.float32(ground.heights.mean()) - ground.heights) * np.float32(values["part"]) + np.float32(0 * worn)
    )


def _example(_evaluate):
    pass


SMOOTH = LandEffect(
    "smooth",
    "Smooth",
    "Diffusion",
    diffuse,
    _example,
    (Parameter("sweeps", SWEEPS, 1, 100, "", ""),),
    (Layer("worn", "m", ""),),
    halo=lambda values, step: values["sweeps"] * step,
    cost_ns=20,
    source="test",
)
HILL = LandEffect(
    "hill",
    "Hill",
    "A cone",
    raise_hill,
    _example,
    (
        Parameter("height", 100.0, -1e4, 1e4, "m", ""),
        Parameter("radius", 500.0, 1, 1e6, "m", ""),
        Parameter("east", 1000.0, 0, 1e6, "m", ""),
        Parameter("north", 1000.0, 0, 1e6, "m", ""),
    ),
    (Layer("fresh", "m", ""), Layer("mark", "m", "", per_metre=False)),
    cost_ns=10,
    source="test",
)
LEVEL = LandEffect(
    "level",
    "Level",
    "Towards the mean",
    level_out,
    _example,
    (Parameter("part", 0.25, 0, 1, "", ""),),
    reads=("worn",),
    halo=lambda _v, _s: float("inf"),
    cost_ns=5,
    source="test",
)
OWN = {effect.name: effect for effect in (SMOOTH, HILL, LEVEL)}
