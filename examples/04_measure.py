# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bound promises, measured by other code: `python examples/04_measure.py [FOLDER]`."""

# One sees that what was measured is never above the bound: on screen at a ray through every pixel, in height over the
# whole surface. Then a mesh that is spoilt on purpose, and that the measurement finds it.

import sys
from dataclasses import replace
from pathlib import Path

from adaptive_terrain import Criterion, ImportSettings, Terrain, View, import_source, open_store
from adaptive_terrain.cbt_terrain.accuracy import measure

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "example")
import_source(ImportSettings("island", size=513), folder / "island.store")
field = open_store(folder / "island.store")
terrain = Terrain(field)
view = View.look(eye=(0, -3000, 900), target=(0, 0, 200), fov_deg=50, resolution=(480, 270))

for error_px in (2.0, 0.5):
    update = terrain.update(Criterion(error_px=error_px), [view])
    found = measure(field, update.surface, view)
    print(
        f"{error_px:g} px asked: bound {update.bound_px:.3f} px, measured {found.screen_px.max:.3f} px; "
        f"bound {update.bound_m:.1f} m of height, measured {found.vertical_max_m:.1f} m"
    )

positions = update.surface.positions.copy()
positions[:, 2] += 100.0
found = measure(field, replace(update.surface, positions=positions), view)
print(f"100 m too high: measured {found.vertical_max_m:.1f} m")
