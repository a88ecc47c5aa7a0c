# SPDX-License-Identifier: GPL-3.0-or-later
"""The land stack of the demo's island: uplift with rivers, then thermal erosion, relief, streams and snow."""

from ...cbt_terrain.height_operators.mask import GroundRule, HeightMask
from ...cbt_terrain.height_operators.stack import Entry, Stack

# A volcano of this seed, whose coast has bays and islets.
ISLAND_SEED = 5

STACK = Stack(
    (
        Entry(
            "rivers",
            {"years": 2.5e6, "rise": 1.1e-3, "erodibility": 5e-6, "hillslope": 1e4, "creep": 0.001, "steepest": 55.0},
            seed=1,
            name="Uplift",
            mask=HeightMask(rules=(GroundRule("height", low=300.0, edge=600.0),)),
        ),
        Entry(
            "rivers",
            {"years": 1.5e5, "erodibility": 5e-6, "hillslope": 6e3, "creep": 0.001, "steepest": 46.0},
            seed=6,
            name="Rivers",
        ),
        Entry("scree", {"depth": 20.0, "bed": 60.0}, seed=2, name="Scree"),
        Entry(
            "relief",
            {"wave": 80.0, "roughness": 0.22, "plains": 0.0, "gain": 0.45, "beds": 40.0, "ledges": 0.6, "dip": 4.0},
            seed=3,
            name="Rock",
        ),
        Entry("water", {"rain": 1.5}, seed=5, name="Streams"),
        Entry("snow", {"line": 760.0, "fall": 2.5}, seed=4, name="Snow"),
    )
)
