# SPDX-License-Identifier: GPL-3.0-or-later
"""How far ground that nearer ground hides jumps where it may be coarser, with geomorph and without."""

from adaptive_terrain.cbt_terrain.accuracy.measure import MeasuredMesh, look
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.field.island import SIDE, island
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.morph import SMOOTH
from adaptive_terrain.cbt_terrain.view.view import View
from adaptive_terrain.operators.text.page_blocks import Table, Text

SAMPLES = 1025
FRAMES = 8  # of a flight at each speed
STEPS = (4.0, 2.0, 1.0, 0.5)  # metres of the camera between frames
FACTOR = 8.0
WEST, NORTH, ABOVE = -1500.0, 200.0, 40.0  # where the flights begin, metres; above the ground


def fly(field: HeightField, step: float, criterion: Criterion) -> tuple[float, float]:
    """Return the largest jump of a hidden point, in pixels as if it were visible, and the triangles of a frame."""
    terrain, before, max_px, triangles = Terrain(field), None, 0.0, 0
    lattice = field.lattice
    column, row = round(WEST / lattice.step_x + SAMPLES // 2), round(NORTH / lattice.step_y + SAMPLES // 2)
    z = float(field.samples[row, column]) + ABOVE
    for number in range(FRAMES):
        x = WEST + step * number
        view = View.look((x, NORTH, z), (x + 1000, NORTH + 100, z - 60), fov_deg=50, resolution=(960, 540))
        update = terrain.update(criterion, [view])
        after, triangles = update.surface.copy(), triangles + update.triangles
        if before is not None:
            sight = look(field, view)
            meshes = [MeasuredMesh(sight.ground, surface) for surface in (before, after)]
            there = [mesh.differences_at(sight.visible_points())[0] for mesh in meshes]
            max_px = max(max_px, sight.errors(*(mesh.differences()[0] for mesh in meshes), there)[1].max)
        before = after
    return max_px, triangles / FRAMES


def hidden_section() -> list:
    """Return the section about jumps of hidden points."""
    field, rows = from_array(island(SAMPLES), SIDE / (SAMPLES - 1)), []
    for how, morph in (("without", 1.0), ("smooth", SMOOTH)):
        found = [fly(field, step, Criterion(morph=morph, hidden_factor=FACTOR)) for step in STEPS]
        whole = fly(field, STEPS[0], Criterion(morph=morph))[1]
        rows.append([how, *(f"{max_px:.3g}" for max_px, _ in found), f"{found[0][1] / whole:.2f}"])
        print(rows[-1], flush=True)
    return [
        Text(
            "Ground that nearer ground hides may be coarser (*Hidden ×*). Nobody sees it jump but in mirrors and by "
            "its shadows. With *Geomorph* it gets coarser by degrees, the deeper it is hidden. In flights "
            f"{ABOVE:g} m above the island at *Hidden ×* {FACTOR:g}, {FRAMES} frames each, the largest jump of a "
            "hidden point, in pixels as if nothing hid it:"
        ),
        Table(["", *(f"{step:g} m a frame" for step in STEPS), "triangles of *Hidden ×* 1"], rows),
    ]
