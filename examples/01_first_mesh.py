# SPDX-License-Identifier: GPL-3.0-or-later
"""A height map becomes a store, a camera becomes a mesh: `python examples/01_first_mesh.py [FOLDER]`."""

# One sees what a pixel of error costs: each line asks for half the error of the one before and gets about twice the
# triangles. The bound is what the mesh guarantees: no visible point of the height map is further from its place.
# The last lines are the mesh itself, as numpy arrays.

import sys
from pathlib import Path

from adaptive_terrain import Criterion, ImportSettings, Terrain, View, import_source, open_store

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "example")
# The source may be a GeoTIFF, PNG, EXR, ...; the second time it is the same, nothing is done.
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
