# SPDX-License-Identifier: GPL-3.0-or-later
"""A camera flies and the mesh follows: `.venv/bin/python examples/02_flight.py [FOLDER]`."""

# A frame of a flight costs less than its first, because unchanged parts are reused. Every frame has the same bytes as
# if it were made alone, and earlier frames stay valid. Threads may share a terrain. A lookup finds the triangle at a
# position without a search.

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from adaptive_terrain import Criterion, ImportSettings, Terrain, View, import_source, open_store

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "example")
import_source(ImportSettings("island", size=513), folder / "island.store")
field = open_store(folder / "island.store")


def view_at(frame: int) -> View:
    """Return a view 300 m above the sea that moves north by 10 m a frame."""
    return View.look(eye=(0, -3000 + 10 * frame, 300), target=(0, 0, 200), fov_deg=50, resolution=(1280, 720))


terrain, criterion = Terrain(field), Criterion(error_px=1.0)
flight = []
for frame in range(1, 9):
    update = terrain.update(criterion, [view_at(frame)])
    print(f"frame {frame}: {update.triangles:,} triangles, bound {update.bound_px:.3f} px, {update.ms['total']:.1f} ms")
    flight.append(update.surface.positions)  # read-only; later updates use other memory

alone = [Terrain(field).update(criterion, [view_at(frame)]).surface.positions for frame in (1, 8)]
print("the same mesh alone:", np.array_equal(alone[0], flight[0]) and np.array_equal(alone[1], flight[-1]))

with ThreadPoolExecutor(4) as pool:  # as in a server; updates run one after the other
    shared = list(pool.map(lambda frame: terrain.update(criterion, [view_at(frame)]).surface.positions, range(1, 9)))
print("the same meshes by four threads:", all(map(np.array_equal, shared, flight)))
update = terrain.update(criterion, [view_at(frame)])

points = np.array([[0.0, 0.0], [250.0, -400.0]])  # x, y in metres
for (x, y), triangle in zip(points, terrain.triangles_at(points), strict=True):
    corners = update.surface.positions[update.surface.triangles[triangle]]
    print(f"({x:g}, {y:g}) m is in triangle {triangle}, {np.ptp(corners[:, 0]):.1f} m wide")
