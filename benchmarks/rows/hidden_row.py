# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles that horizon culling saves on the built-in island, in the demo's flight and low over the ground."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from statistics import median

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.terrain import Terrain
from ...cbt_terrain.view.camera_path import read_camera_path
from ...cbt_terrain.view.criterion import Criterion
from ...cbt_terrain.view.view import View
from ...operators.demo.demo import FLIGHT, FRAMES
from ..rig import scenes
from ..rig.measure import BenchmarkRow

FACTOR = 8.0
RESOLUTION = (1920, 1080)
SHOWN = FRAMES[::3]
LOW_M, RADIUS_M = 20.0, 1500.0  # height above the ground, and distance from the centre, of the low flight


def hidden_row(folder: Path) -> BenchmarkRow:
    """Measure triangles at 1 px on all threads."""
    field = scenes.island_of(scenes.SAMPLES)
    file = folder / "flight.json"
    file.write_text(json.dumps(FLIGHT), encoding="utf-8")
    path = read_camera_path(file)
    plain, plain_ms, _ = _fly(field, lambda frame: path.view(frame, RESOLUTION), 1.0)
    culled, ms, map_ms = _fly(field, lambda frame: path.view(frame, RESOLUTION), FACTOR)
    low = [_fly(field, lambda frame: _low_view(field, frame), factor)[0] for factor in (FACTOR, 1.0)]
    figures = {"plain_ms": plain_ms, "map_ms": map_ms, "low_ratio": low[0] / low[1]}
    size = plain // len(SHOWN)
    return BenchmarkRow("hidden", size, ms, "triangles of a factor of 1", ratio=culled / plain, figures=figures)


def _fly(field: HeightField, view: Callable[[int], View], factor: float) -> tuple[int, float, float]:
    """Return triangles of all frames, and median milliseconds of an update and of its horizon map."""
    terrain, triangles, times = Terrain(field), 0, []
    for frame in SHOWN:
        update = terrain.update(Criterion(error_px=1.0, hidden_factor=factor), [view(frame)])
        triangles += update.triangles
        times.append((update.ms["total"], update.ms.get("horizon", 0.0)))
    return triangles, *(median(each) for each in zip(*times[1:], strict=True))


def _low_view(field: HeightField, frame: int) -> View:
    """Return a view towards the centre from just above the ground."""
    angle, lattice = math.tau * frame / len(FRAMES), field.lattice
    x, y = RADIUS_M * math.cos(angle), RADIUS_M * math.sin(angle)
    row, column = round(y / lattice.step_y + lattice.height // 2), round(x / lattice.step_x + lattice.width // 2)
    eye = (x, y, float(field.samples[row, column]) + LOW_M)
    return View.look(eye, (-x, -y, eye[2]), resolution=RESOLUTION)
