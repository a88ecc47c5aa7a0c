# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of attributes and splat layers at the vertices of the built-in island, in a flight."""

import statistics

import numpy as np

from ...cbt_terrain.attributes.attribute import AttributeRequest
from ...cbt_terrain.attributes.evaluate import EffectRequest, evaluate
from ...cbt_terrain.attributes.plan import plan
from ...cbt_terrain.attributes.pyramid import scaled_pyramid
from ...cbt_terrain.attributes.splat import SPLATS
from ...cbt_terrain.terrain import Terrain
from ...cbt_terrain.view.view import View
from ..rig import scenes
from ..rig.measure import BLOCKS, BenchmarkRow, count_runs, stopwatch
from ..rig.scenes import MILLION

ATTRIBUTES = ("height", "slope", "aspect", "mean_curvature", "profile_curvature", "plan_curvature", "detail_normal")
EYE, TOWARDS = np.array([1500.0, -2300.0, 420.0]), np.array([-2600.0, 900.0, 700.0])
FLIGHT_M = 8.0  # metres a frame


def view_at(frame: int) -> View:
    """Return the view of a frame of the flight."""
    direction = (TOWARDS - EYE) / np.linalg.norm(TOWARDS - EYE)
    return View.look(EYE + FLIGHT_M * frame * direction, (0, 0, 100.0))


def effects_flight_row() -> BenchmarkRow:
    """Measure attributes and twelve splat layers against the update of the same frames."""
    field = scenes.island_of(scenes.SAMPLES)
    scaled_pyramid(field.raster, 1.0, 0.0, 1)  # computed once for a store
    criterion = scenes.errors(scenes.pixels_for(field, view_at(0), scenes.errors, MILLION))
    terrain = Terrain(field)
    wanted = plan(
        [AttributeRequest(effect, ("benchmark",)) for effect in (*ATTRIBUTES, *(splat.name for splat in SPLATS))]
    )
    updates, effects, computed = [], [], []

    def next_frame() -> None:
        views = [view_at(len(effects))]
        with stopwatch() as update_ms:
            surface = terrain.update(criterion, views).surface
        with stopwatch() as effects_ms:
            result = evaluate(field, EffectRequest(wanted, surface, views), terrain.history, terrain.threads)
        updates.append(update_ms[0])
        effects.append(effects_ms[0])
        computed.append(result.ran["slope"].computed / len(surface.positions))

    next_frame()
    next_frame()
    for _ in range(BLOCKS * count_runs(max(updates[1], effects[1]))):
        next_frame()
    ms, baseline_ms = (statistics.median(times[2:]) for times in (effects, updates))
    row = BenchmarkRow("effects_flight", MILLION, ms, "the update of the same frames", baseline_ms, first_ms=effects[0])
    row.figures = {"computed_fraction": statistics.median(computed[2:])}
    return row
