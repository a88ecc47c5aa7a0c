# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of height operators on the built-in island on one thread: rivers, scree and water."""

import time

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.island import SIDE, island
from ...cbt_terrain.height_operators import flood, fluvial, thermal
from ...cbt_terrain.height_operators.height_operator import OperatorGround
from ...cbt_terrain.height_operators.levels import apply_by_levels
from ...cbt_terrain.height_operators.rivers import RIVERS
from ...cbt_terrain.height_operators.water import WATER
from ..rig import plain_scree
from ..rig.measure import BenchmarkRow, alternate, stopwatch, time_ms

SAMPLES, WATER_SAMPLES = 1025, 257
YEARS = 20e3  # of a step of rivers
SOIL_M = 30.0  # thickness of the rock that can break into scree
# Seconds of shallow water that are measured, of the HOUR that is reported.
MARCHED_S, HOUR = 60.0, 3600.0


def _ground(heights: np.ndarray) -> OperatorGround:
    step = SIDE / (len(heights) - 1)
    return OperatorGround(heights, step, step, whole=heights.shape)


def rivers_row() -> BenchmarkRow:
    """Measure a step of rivers against fastscapelib, without creep and deposition, which that library lacks."""
    import fastscapelib

    ground = _ground(island(SAMPLES))
    heights, step, n = ground.heights, ground.step_x, ground.heights.size
    grid = fastscapelib.RasterGrid([*heights.shape], [step, step], fastscapelib.NodeStatus.FIXED_VALUE)
    sinks = fastscapelib.MSTSinkResolver(fastscapelib.MSTMethod.KRUSKAL, fastscapelib.MSTRouteMethod.CARVE)
    graph = fastscapelib.FlowGraph(grid, [fastscapelib.SingleFlowRouter(), sinks])
    eroder = fastscapelib.SPLEroder(graph, k_coef=4e-6, area_exp=0.5, slope_exp=1.0, tolerance=1e-3)
    elevation, area = np.empty(heights.shape), np.empty(heights.shape)
    values = RIVERS.defaults() | {"creep": 0.0, "deposition": 0.0}
    ones, zeros = np.ones(n, np.float32), np.zeros(n, np.float32)

    def ours() -> dict[str, float]:
        bed = fluvial.Bed(heights.shape, step, step, heights.ravel(), zeros, zeros > 0, ones, ones, zeros, np.ones(n))
        return {"total": time_ms(lambda: fluvial.step(bed, YEARS, values, 0))}

    def theirs() -> float:
        elevation[...] = heights
        with stopwatch() as elapsed:
            graph.update_routes(elevation)
            graph.accumulate(area, 1.0)
            elevation[...] -= eroder.erode(elevation, area, YEARS)
        return elapsed[0]

    timed = alternate(ours, theirs)
    return _row("land_rivers", n, timed.ms["total"], "fastscapelib", timed.baseline_ms)


def scree_row() -> BenchmarkRow:
    """Measure a sweep of scree on slopes twice as steep as the island's, against numpy, which must give equal bytes."""
    ground = _ground(np.maximum(island(SAMPLES), np.float32(0.0)))
    rock = np.full(ground.heights.shape, SOIL_M, np.float32)
    base = 2.0 * ground.heights - rock
    results = {}

    def sweep(name: str) -> float:
        left, scree = rock.copy(), np.zeros_like(rock)
        slope = thermal.pack_slope(ground, thermal.THERMAL.defaults(), base, left, scree)
        with stopwatch() as elapsed:
            if name == "numpy":
                plain_scree.sweep(slope, 0, base, left, scree)
            else:
                list(thermal.sweep(slope, 0, 1))
        results[name] = left.tobytes() + scree.tobytes()
        return elapsed[0]

    timed = alternate(lambda: {"total": sweep("ours")}, lambda: sweep("numpy"))
    if results["ours"] != results["numpy"]:
        raise TerrainError("A sweep of scree has other bytes than the same in numpy")
    return _row("land_scree", base.size, timed.ms["total"], "numpy", timed.baseline_ms)


def water_row() -> BenchmarkRow:
    """Measure maps of steady rain against an hour of rain, marched as shallow water by our own kernels."""
    ground = _ground(island(WATER_SAMPLES))

    def ours() -> dict[str, float]:
        return {"total": time_ms(lambda: apply_by_levels(WATER, ground, WATER.defaults()))}

    def marched() -> float:
        water = flood.still(ground.heights, (ground.step_x, ground.step_y), sea=0.0, rain=0.05 / HOUR)
        start = time.perf_counter()
        flood.march(water, MARCHED_S)
        return (time.perf_counter() - start) * 1e3 * HOUR / MARCHED_S

    timed = alternate(ours, marched)
    return _row("land_water", ground.heights.size, timed.ms["total"], "marched", timed.baseline_ms)


def _row(name: str, samples: int, ms: float, baseline: str, baseline_ms: float) -> BenchmarkRow:
    return BenchmarkRow(name, samples, ms, baseline, baseline_ms, figures={"ns_sample": ms * 1e6 / samples})
