# SPDX-License-Identifier: GPL-3.0-or-later
"""Queries of a height field without a mesh: `.venv/bin/python examples/07_queries.py [FOLDER]`."""

# The script puts a tower on the ground, computes its viewshed and checks one visible sample by a ray. It prints the
# climb of a path and the heights in a box. The vertices of a mesh confirm that queries refer to the surface itself.

import math
import sys
from pathlib import Path

import numpy as np
from adaptive_terrain import (
    ImportSettings,
    bake,
    box_range,
    ground_at,
    import_source,
    open_store,
    pick,
    profile,
    viewshed,
)

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "example")
import_source(ImportSettings("island", size=513), folder / "island.store")
field = open_store(folder / "island.store")

foot = np.array([1200.0, -800.0])  # x, y in metres from the terrain's middle
ground = ground_at(field, foot)
print(f"the foot stands at {ground.heights[0]:.1f} m on a slope of {math.degrees(ground.slopes[0]):.0f} degrees")

top = np.array([*foot, ground.heights[0] + 30.0])
seen = viewshed(field, top, radius=2000.0)
print(f"from 30 m above it one sees {seen.sum():,} samples within 2 km")

row, column = np.argwhere(seen)[0]
west, south, east, north = field.lattice.rectangle()
place = np.array([west + column * field.lattice.step_x, south + row * field.lattice.step_y])
sample = np.array([*place, ground_at(field, place).heights[0]])
hit = pick(field, top, sample - top)
print(f"a ray to one of them meets the ground {np.linalg.norm(hit.points[0] - sample):.6f} m from it")

path = profile(field, [foot, (0.0, 0.0), (west, north)])
climbs = np.diff(path.heights)
print(f"a path of {path.along[-1]:,.0f} m climbs {climbs[climbs > 0].sum():,.0f} m")
low, high = box_range(field, -500, -500, 500, 500)
print(f"a square kilometre in the middle has {low:.1f} to {high:.1f} m")

update = bake(field, 5.0)
x, y, z = update.surface.positions.T
off = abs(ground_at(field, np.stack([x, y], 1)).heights - z).max()
print(f"vertices of a mesh with an error of 5 m are {off:.4f} m off the surface")
