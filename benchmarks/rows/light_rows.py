# SPDX-License-Identifier: GPL-3.0-or-later
"""What light costs: rays that skip blocks beside rays that visit every crossing, a preview beside the whole."""

from dataclasses import replace
from statistics import median

import numpy as np
import warp as wp

from ...cbt_terrain.ask.criterion import Criterion
from ...cbt_terrain.ask.view import View
from ...cbt_terrain.effects import sky, sky_layer
from ...cbt_terrain.effects.effect import Places
from ...cbt_terrain.effects.light import AZIMUTHS, azimuths
from ...cbt_terrain.effects.occluder import every_crossing, occluder_of
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.island import SIDE
from ...cbt_terrain.run import launch
from ...cbt_terrain.run.buffers import flat
from ...cbt_terrain.terrain import Terrain
from ...kernels.effects.light import sky_seen
from ..rig import scenes
from ..rig.measure import Row, alternate, stopwatch

# Rays start from runs of vertices that follow one another, as those of a mesh do.
RUNS, RUN = 10, 30
SWEPT = 4  # of the azimuths, which are spread evenly: the rest costs the same


def light_rows():
    """Of the built-in island, as a camera over its rim sees it at 1 px."""
    field = scenes.built_in_island()
    view = View.look(scenes.eye_over(0, SIDE), (0, 0, 0))
    update = Terrain(field).update(Criterion(error_px=1.0), [view])
    positions = update.surface.positions.copy()
    yield _rays(field, positions, update.triangles)
    yield _preview(field, positions, update.triangles)


def _rays(field: HeightField, positions: np.ndarray, triangles: int) -> Row:
    first = np.linspace(0, len(positions) - RUN, RUNS).astype(int)
    which = np.add.outer(first, np.arange(RUN)).ravel()
    some = Places(field, positions, np.zeros(len(positions), np.float32)).only(which)
    directions = wp.array(azimuths(), dtype=wp.vec2d, device=launch.DEVICE)
    where = wp.array(some.positions, dtype=wp.vec3f, device=launch.DEVICE, copy=False)
    blocks, none, skies = occluder_of(some), every_crossing(field, 1.0), {}

    def seen(ground, name: str) -> float:
        out = skies[name] = np.zeros(len(some), np.float32)
        numbers = [wp.float64(sky.WITHOUT_END), wp.float64(sky.HORIZONTAL), directions, 0, AZIMUTHS]
        with stopwatch() as elapsed:
            launch.spread(sky_seen, len(some), [ground, *numbers, where, flat(out, wp.float32)], step="light")
        return elapsed[0]

    timed = alternate(lambda: {"total": seen(blocks, "skipping")}, lambda: seen(none, "all"))
    if not np.array_equal(skies["skipping"], skies["all"]):
        raise TerrainError("Rays that skip blocks see another sky than rays that visit every crossing.")
    figures = {"ns_ray": timed.ms["total"] * 1e6 / (len(some) * AZIMUTHS), "rays": len(some) * AZIMUTHS}
    return Row("light_rays", triangles, timed.ms["total"], "every crossing", timed.baseline_ms, figures=figures)


def _preview(field: HeightField, positions: np.ndarray, triangles: int) -> Row:
    """The first of either, with nothing known before; the heights' pyramid is, which other effects share."""
    threads = launch.default_threads()

    def first() -> float:
        fresh = replace(field, found={})
        places = Places(fresh, positions, np.zeros(len(positions), np.float32), threads=threads)
        with stopwatch() as elapsed:
            sky.make(places, {"sky": {"quality": sky.PREVIEW}}, {})
        return elapsed[0]

    def in_full() -> float:
        fresh = replace(field, found={})
        with stopwatch() as elapsed:
            for _ in range(SWEPT):
                sky_layer.advance(fresh, 1.0, threads)
        return elapsed[0] * AZIMUTHS / SWEPT

    first()
    full = in_full()
    ms = median(first() for _ in range(5))
    return Row("light_preview", triangles, ms, "in full", full, figures={"vertices": len(positions)})
