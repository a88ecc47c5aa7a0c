# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of a preview of sky light at all vertices, against sky light in full."""

from statistics import median

import numpy as np

from ...cbt_terrain.attributes import sky, sky_layer
from ...cbt_terrain.attributes.attribute import SamplePoints
from ...cbt_terrain.attributes.light import AZIMUTHS
from ...cbt_terrain.field.island import SIDE
from ...cbt_terrain.run import launch
from ...cbt_terrain.terrain import Terrain
from ...cbt_terrain.view.criterion import Criterion
from ...cbt_terrain.view.view import View
from ..rig import scenes
from ..rig.measure import BenchmarkRow, stopwatch

SWEPT = 4  # azimuths that are measured; all cost the same
RUNS = 5


def light_preview_row() -> BenchmarkRow:
    """Measure the first request, with only the height pyramid in the cache, for the built-in island at 1 px."""
    field, threads = scenes.island_of(scenes.SAMPLES), launch.default_threads()
    view = View.look(scenes.eye_over(0, SIDE), (0, 0, 0))
    update = Terrain(field).update(Criterion(error_px=1.0), [view])
    positions = update.surface.positions.copy()

    def preview_ms() -> float:
        field.cache.results.clear()
        places = SamplePoints(field, positions, np.zeros(len(positions), np.float32), threads=threads)
        with stopwatch() as elapsed:
            sky.make(places, {"sky": {"quality": sky.PREVIEW}}, {})
        return elapsed[0]

    def full_ms() -> float:
        field.cache.results.clear()
        with stopwatch() as elapsed:
            for _ in range(SWEPT):
                sky_layer.advance(field, 1.0, threads)
        return elapsed[0] * AZIMUTHS / SWEPT

    preview_ms()
    baseline_ms = full_ms()
    ms = median(preview_ms() for _ in range(RUNS))
    figures = {"vertices": len(positions)}
    return BenchmarkRow("light_preview", update.triangles, ms, "in full", baseline_ms, figures=figures)
