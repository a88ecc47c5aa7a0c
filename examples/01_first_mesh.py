# SPDX-License-Identifier: GPL-3.0-or-later
"""A height map becomes a store, a camera becomes a mesh: `.venv/bin/python examples/01_first_mesh.py [FOLDER]`."""

# Each line halves the requested error and gets about twice the triangles. No visible point of the height map is further
# from the mesh than the printed bound. The last lines describe the mesh as numpy arrays.

import sys
from pathlib import Path

from adaptive_terrain import Criterion, ImportSettings, Terrain, View, import_source, open_store

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "example")
# The source may also be a GeoTIFF, PNG, EXR, ...; a second import of an unchanged source does nothing.
import_source(ImportSettings("island", size=513), folder / "island.store")

terrain = Terrain(open_store(folder / "island.store"))
view = View.look(eye=(0, -3000, 900), target=(0, 0, 200), fov_deg=50, resolution=(1920, 1080))

for error_px in (8.0, 4.0, 2.0, 1.0):
    update = terrain.update(Criterion(error_px=error_px), [view])
    print(f"{error_px:g} px asked: {update.triangles:,} triangles, bound {update.bound_px:.3f} px")

surface = update.surface
print(f"positions {surface.positions.shape} {surface.positions.dtype}, triangles {surface.triangles.shape}")
for name, attribute in surface.attributes.items():
    print(f"attribute {name}: {attribute.array.dtype} {attribute.array.shape} of the domain {attribute.domain}")
