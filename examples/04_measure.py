# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds, checked by independent measurements: `.venv/bin/python examples/04_measure.py [FOLDER]`."""

# Measured errors never exceed the bound: in pixels for a camera, by a ray through every pixel, and in metres for a
# baked mesh, over its whole surface. The last lines damage a mesh on purpose, and the measurement finds it.

import sys
from pathlib import Path

from adaptive_terrain import Criterion, ImportSettings, Terrain, View, bake, import_source, measure, open_store

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "example")
import_source(ImportSettings("island", size=513), folder / "island.store")
field = open_store(folder / "island.store")
terrain = Terrain(field)
view = View.look(eye=(0, -3000, 900), target=(0, 0, 200), fov_deg=50, resolution=(480, 270))

for error_px in (2.0, 0.5):
    update = terrain.update(Criterion(error_px=error_px), [view])
    found = measure(field, update.surface, view)
    print(f"asked {error_px:g} px: bound {update.bound_px:.3f} px, measured {found.screen_px.max:.3f} px")

for error_m in (4.0, 1.0):
    update = bake(field, error_m)
    found = measure(field, update.surface)
    print(f"asked {error_m:g} m: bound {update.bound_m:.3f} m, measured {found.vertical_max_m:.3f} m")

spoilt = update.copy().surface  # the arrays of an update are read-only, those of a copy are not
spoilt.positions[:, 2] += 100.0
found = measure(field, spoilt)
print(f"100 m too high: measured {found.vertical_max_m:.1f} m")
