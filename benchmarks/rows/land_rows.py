# SPDX-License-Identifier: GPL-3.0-or-later
"""What effects on heights cost, beside the plain way in numpy or another library."""

import numpy as np

from ...cbt_terrain.effects.routing import route
from ...cbt_terrain.field.build import from_array
from ...cbt_terrain.field.island import SIDE, island
from ...cbt_terrain.land.shape import shape
from ...cbt_terrain.land.stack import Entry, Stack
from ...cbt_terrain.land.tiles import levels_of, whole_land
from ...cbt_terrain.land_effects import fluvial
from ...cbt_terrain.land_effects.land_effect import Ground
from ...cbt_terrain.land_effects.relief import RELIEF
from ...cbt_terrain.land_effects.rivers import RIVERS
from ...cbt_terrain.run import launch
from ...operators.demo.stack import STACK
from ..rig import scenes
from ..rig.measure import Row, alternate, stopwatch

SAMPLES = 1025
WAVE = 128.0  # metres
STACK_SAMPLES = (2049, 4097)


def _island() -> tuple[np.ndarray, float]:
    """Heights of the built-in island, and metres from sample to sample; all rows of it are of one thread."""
    return island(SAMPLES), SIDE / (SAMPLES - 1)


def relief_row() -> Row:
    heights, step = _island()
    ground, values = Ground(heights, step, step, whole=heights.shape), RELIEF.defaults() | {"wave": WAVE}
    octaves = int(np.log2(WAVE / (2.0 * step)))

    def ours() -> dict[str, float]:
        with stopwatch() as elapsed:
            RELIEF.apply(ground, values, None)
        return {"total": elapsed[0]}

    def plain() -> float:
        with stopwatch() as elapsed:
            _octaves(heights.shape, step, octaves)
        return elapsed[0]

    timed = alternate(ours, plain)
    figures = {"ns_sample": timed.ms["total"] * 1e6 / heights.size, "octaves": octaves}
    return Row("land_relief", heights.size, timed.ms["total"], "numpy", timed.baseline_ms, figures=figures)


def demanded_row() -> Row:
    """Relief on one tile of the finest level, with all that it starts from, beside every tile; one thread each."""
    size = 2 * SAMPLES - 1
    field = scenes.island_of(size)
    stack, every = Stack((Entry("relief", {"wave": WAVE}),)), whole_land(field.lattice)
    some = [{levels_of(field.lattice)[0].tile_count // 2: 0.0}, *({} for _ in every[1:])]
    made = []

    def took(wanted) -> float:
        with stopwatch() as elapsed:
            made.append(shape(field, stack, wanted))
        return elapsed[0]

    timed = alternate(lambda: {"total": took(some)}, lambda: took(every))
    tiles = {"tiles": sum(map(len, made[0].tiles)), "of": sum(made[0].tile_counts)}
    return Row("land_demanded", field.samples.size, timed.ms["total"], "every tile", timed.baseline_ms, figures=tiles)


def stack_rows():
    """The demo's stack, from the island's samples to changed heights and layers: all threads, nothing kept before."""
    for size in STACK_SAMPLES:
        field = from_array(island(size), SIDE / (size - 1))
        with stopwatch() as elapsed:
            made = shape(field, STACK, whole_land(field.lattice), threads=launch.default_threads())
        steps = {}
        for added in made.added:
            level = f"{added.effect}_{added.spacing_m:g}m"
            steps[level] = steps.get(level, 0.0) + added.ms
        yield Row("land_stack", size * size, elapsed[0], steps=steps)


def _octaves(shape: tuple[int, int], step: float, count: int) -> np.ndarray:
    """Octaves of gradient noise on whole arrays, with nothing that leads them."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32) * np.float32(step)
    turns, total, wave = np.random.default_rng(7).random((256, 256, 2), np.float32) - np.float32(0.5), 0.0, WAVE
    for _ in range(count):
        u, v = x / np.float32(wave), y / np.float32(wave)
        i, j = np.floor(u).astype(np.int32), np.floor(v).astype(np.int32)
        u, v = u - i, v - j
        planes = []
        for dj in (0, 1):
            for di in (0, 1):
                gradient = turns[(j + dj) & 255, (i + di) & 255]
                planes.append(gradient[..., 0] * (u - di) + gradient[..., 1] * (v - dj))
        a, b = (t * t * t * (t * (t * 6 - 15) + 10) for t in (u, v))
        low, high = planes[0] + (planes[1] - planes[0]) * a, planes[2] + (planes[3] - planes[2]) * a
        total = total + np.float32(0.1 * wave) * (low + (high - low) * b)
        wave /= 2
    return total


def river_rows():
    """Routes and steps of ageing without noise, creep and deposition, which the library does not know; sediment beside
    a step of ours without it. The island with its sea floor, of which only the rim lets water out."""
    import fastscapelib

    heights, step = _island()
    grid = fastscapelib.RasterGrid([*heights.shape], [step, step], fastscapelib.NodeStatus.FIXED_VALUE)
    sinks = fastscapelib.MSTSinkResolver(fastscapelib.MSTMethod.KRUSKAL, fastscapelib.MSTRouteMethod.CARVE)
    graph = fastscapelib.FlowGraph(grid, [fastscapelib.SingleFlowRouter(), sinks])
    eroder = fastscapelib.SPLEroder(graph, k_coef=4e-6, area_exp=0.5, slope_exp=1.0, tolerance=1e-3)
    ground, area = heights.astype(np.float64), np.empty(heights.shape)

    def our_routes() -> dict[str, float]:
        with stopwatch() as elapsed:
            route(heights, step, step)
        return {"total": elapsed[0]}

    def its_routes() -> float:
        with stopwatch() as elapsed:
            graph.update_routes(ground)
            graph.accumulate(area, 1.0)
        return elapsed[0]

    def its_step() -> float:
        ground[...] = heights
        with stopwatch() as elapsed:
            graph.update_routes(ground)
            graph.accumulate(area, 1.0)
            ground[...] -= eroder.erode(ground, area, 20e3)
        return elapsed[0]

    plain = RIVERS.defaults() | {"creep": 0.0, "deposition": 0.0}
    for name, ours, theirs, library in (
        ("land_routing", our_routes, its_routes, "fastscapelib"),
        ("land_rivers", _step_of(heights, step, plain), its_step, "fastscapelib"),
        ("land_sediment", *_with_and_without(heights, step, plain), "without sediment"),
    ):
        timed = alternate(ours, theirs)
        figures = {"ns_sample": timed.ms["total"] * 1e6 / heights.size}
        yield Row(name, heights.size, timed.ms["total"], library, timed.baseline_ms, figures=figures)


def _step_of(heights: np.ndarray, step: float, values: dict[str, float]):
    """What takes one step of 20,000 years from the same heights every time."""
    n = heights.size
    ones, none = np.ones(n, np.float32), np.zeros(n, np.float32)

    def run() -> dict[str, float]:
        bed = fluvial.Bed(heights.shape, step, step, heights.ravel(), none, none > 0, ones, ones, none, np.ones(n))
        with stopwatch() as elapsed:
            fluvial.step(bed, 20e3, values, 0)
        return {"total": elapsed[0]}

    return run


def _with_and_without(heights: np.ndarray, step: float, plain: dict[str, float]):
    without = _step_of(heights, step, plain)
    return _step_of(heights, step, plain | {"deposition": 1.0}), lambda: without()["total"]
