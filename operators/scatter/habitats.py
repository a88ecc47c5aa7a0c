# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules for the ground on which each kind of the starter collection stands."""

import math

from ...cbt_terrain.attributes import splat_rules as rules
from ..importing.imported import imported_of
from ..layers.properties import BANDS

SNOW_M = 1500.0  # land with higher ground has a tree line, below the snow of the default layers
FOREST_M = 800.0  # size of the woods that the noise of trees makes
# Limits that differ from the defaults of the bands: low, high, edge.
STEEP = rules.SLOPE, {"high": math.radians(30), "edge": math.radians(10)}
TREE_LINE = rules.RELIEF, {"high": 0.55, "edge": 0.15}
WOODS = rules.NOISE, {"low": -0.1, "high": 1.0, "edge": 0.3}
PLANTS = (STEEP, TREE_LINE)
HABITATS = {"CONIFERS": (*PLANTS, WOODS), "BROADLEAVES": (*PLANTS, WOODS), "BUSHES": PLANTS, "GRASS": PLANTS}


def set_habitat(scatter, kind: str) -> None:
    """Set the rules of a kind on a scatter, unless it has rules already. kind: key of starter.KINDS.

    Land without ground of SNOW_M or more gets no tree line, nor does a scatter without a terrain.
    """
    where = scatter.adaptive_scatter.where
    if has_habitat(where):
        return
    found = imported_of(scatter.parent.adaptive_terrain) if scatter.parent is not None else None
    for name, limits in HABITATS.get(kind, ()):
        if name == rules.RELIEF and (found is None or found.heights_m[1] < SNOW_M):
            continue  # no tree line
        band = getattr(where, name)
        band.use = True
        for limit, value in limits.items():
            setattr(band, limit, value)
        if name == rules.NOISE:
            where.noise_size = FOREST_M


def has_habitat(where) -> bool:
    """Return whether rules other than that of the water limit the ground of a scatter. where: its LayerSettings."""
    bands = (getattr(where, name) for name in BANDS if name != "water_depth")
    return where.aspect.use or where.image is not None or any(band.use for band in bands)
