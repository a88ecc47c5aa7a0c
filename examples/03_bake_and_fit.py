# SPDX-License-Identifier: GPL-3.0-or-later
"""A static mesh within an error in metres: `.venv/bin/python examples/03_bake_and_fit.py [FOLDER]`."""

# Both meshes have an error of at most 2 m of height. The vertices of the second may leave the surface within that
# error, so it needs fewer triangles. Both are written as .npz files for numpy.

import sys
from pathlib import Path

import numpy as np
from adaptive_terrain import ImportSettings, bake, import_source, open_store, write_npz

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "example")
import_source(ImportSettings("island", size=513), folder / "island.store")
field = open_store(folder / "island.store")

for name, fitted in (("baked", False), ("fitted", True)):
    update = bake(field, 2.0, fitted=fitted)
    write_npz(folder / f"{name}.npz", update.surface, field.origin, {"bound_m": update.bound_m})
    with np.load(folder / f"{name}.npz") as file:
        heights = file["positions"][:, 2]
    print(
        f"{name}: {update.triangles:,} triangles, at most {update.bound_m:.3f} m off, {np.ptp(heights):.0f} m of relief"
    )
