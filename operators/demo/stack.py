# SPDX-License-Identifier: GPL-3.0-or-later
"""What shapes the demo's island: rivers, frost, snow and water."""

from ...cbt_terrain.land.stack import Entry, Stack

STACK = Stack(
    (
        Entry(
            "rivers",
            {"years": 2.5e5, "erodibility": 4e-6, "hillslope": 1.5e4, "creep": 0.001, "steepest": 42.0},
            seed=1,
            name="Rivers",
        ),
        Entry("thermal", {"depth": 18.0, "bed": 45.0}, seed=2, name="Frost"),
        Entry("relief", {"wave": 60.0, "roughness": 0.22, "plains": 0.0, "gain": 0.42}, seed=3, name="Rock"),
        Entry("snow", {"line": 720.0, "fall": 2.5}, seed=4, name="Snow"),
        Entry("water", {"rain": 1.5}, seed=5, name="Streams"),
    )
)
