# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of heights, normals and slopes at points, against heights alone in numpy."""

import numpy as np

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.island import SIDE
from ...cbt_terrain.query.ground import ground_at
from ..rig import scenes
from ..rig.measure import BenchmarkRow, alternate, time_ms

POINTS = 1_000_000


def query_heights_row() -> BenchmarkRow:
    """Measure points of the built-in island in rows and, as a figure, in random order; one thread."""
    field = scenes.island_of(scenes.SAMPLES)
    line = np.linspace(-0.1, 0.1, int(POINTS**0.5)) * SIDE
    points = np.stack(np.meshgrid(line, line), -1).reshape(-1, 2)
    mixed = np.random.default_rng(0).uniform(-0.5, 0.5, points.shape) * SIDE
    timed = alternate(
        lambda: {"total": time_ms(lambda: ground_at(field, points, threads=1))},
        lambda: time_ms(lambda: _bilinear(field, points)),
    )
    ms = timed.ms["total"]
    random_ms = min(time_ms(lambda: ground_at(field, mixed, threads=1)) for _ in range(3))
    figures = {"ns_point": 1e6 * ms / len(points), "ns_random": 1e6 * random_ms / len(points)}
    return BenchmarkRow("query_heights", len(points), ms, "numpy", timed.baseline_ms, figures=figures)


def _bilinear(field: HeightField, points: np.ndarray) -> np.ndarray:
    """Return bilinear heights, NaN outside the terrain."""
    lattice, h = field.lattice, field.samples
    cells = points / (lattice.step_x, lattice.step_y) + np.array([lattice.cells_x, lattice.cells_y]) / 2
    inside = ((cells >= 0) & (cells <= (lattice.cells_x, lattice.cells_y))).all(axis=1)
    i, j = np.clip(cells.astype(np.int64), 0, (lattice.cells_x - 1, lattice.cells_y - 1)).T
    s, t = cells[:, 0] - i, cells[:, 1] - j
    low, high = h[j, i] * (1 - s) + h[j, i + 1] * s, h[j + 1, i] * (1 - s) + h[j + 1, i + 1] * s
    return np.where(inside, low * (1 - t) + high * t, np.nan)
