# SPDX-License-Identifier: GPL-3.0-or-later
"""A scatter of points that do not move: `.venv/bin/python examples/08_scatter.py [FOLDER]`."""

# The script prints the points of three frames of a flight, their motion (0 m) and the number of new points. It writes
# positions, normals, sizes, ids, variants and rotations of the last frame to points.npz.

import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
from adaptive_terrain import ImportSettings, Layer, Rule, Scatter, View, import_source, open_store, scatter_points

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "example")
import_source(ImportSettings("island", size=513), folder / "island.store")
field = open_store(folder / "island.store")
gentle_land = Layer("Gentle land", (Rule("height", low=5.0, edge=5.0), Rule("slope", high=0.6, edge=0.2)))
scatter = Scatter(spacing=20.0, full_until=800.0, where=gentle_land, variation=0.0)

last = None
for frame in range(3):
    view = View.look((-2800 + 2 * frame, -2400 + frame, 420), (0, 200, 380))
    points = scatter_points(field, scatter, [view])
    print(f"frame {frame}: {len(points):,} points")
    if last is not None:
        _, here, before = np.intersect1d(points.id, last.id, return_indices=True)
        new = ~np.isin(points.id, last.id)
        moved = np.abs(points.positions[here] - last.positions[before]).max()
        print(f"  {len(here):,} were there before and moved {moved:g} m; {new.sum()} came, {new.mean():.2%}")
    last = points
np.savez(folder / "points.npz", **asdict(points))
