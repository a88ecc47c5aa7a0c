# SPDX-License-Identifier: GPL-3.0-or-later
"""What water and snow cost: maps of steady rain beside an hour of it marched, snow beside the same in numpy."""

import time

import numpy as np

from ...cbt_terrain.effects.light import azimuths
from ...cbt_terrain.field.island import SIDE, island
from ...cbt_terrain.land_effects import flood
from ...cbt_terrain.land_effects.land_effect import Ground, LandEffect
from ...cbt_terrain.land_effects.levels import apply_by_levels
from ...cbt_terrain.land_effects.snow import AT_FIRST, AZIMUTHS, GUSTS, SNOW, SWEEPS
from ...cbt_terrain.land_effects.water import WATER
from ..rig.measure import Row, alternate, stopwatch

SAMPLES = 257
# Seconds of the hour that are marched: the rest costs the same.
PART, HOUR = 60.0, 3600.0


def water_rows():
    """Of the built-in island, one thread."""
    yield _steady()
    yield _snow()


def _ground() -> Ground:
    heights, step = island(SAMPLES), SIDE / (SAMPLES - 1)
    return Ground(heights, step, step, whole=heights.shape)


def _timed(effect: LandEffect, ground: Ground) -> dict[str, float]:
    with stopwatch() as elapsed:
        apply_by_levels(effect, ground, effect.defaults())
    return {"total": elapsed[0]}


def _steady() -> Row:
    ground, steps = _ground(), 0

    def marched() -> float:
        nonlocal steps
        water = flood.still(ground.heights, (ground.step_x, ground.step_y), sea=0.0, rain=0.05 / HOUR)
        start = time.perf_counter()
        steps = flood.march(water, PART)
        return (time.perf_counter() - start) * 1e3 * HOUR / PART

    timed = alternate(lambda: _timed(WATER, ground), marched)
    samples = ground.heights.size
    ns_step = timed.baseline_ms * 1e6 * PART / HOUR / (steps * samples)
    figures = {"ns_sample": timed.ms["total"] * 1e6 / samples, "ns_sample_and_marched_step": ns_step}
    return Row("land_water", samples, timed.ms["total"], "marched", timed.baseline_ms, figures=figures)


def _snow() -> Row:
    ground = _ground()

    def plain() -> float:
        with stopwatch() as elapsed:
            _plain_snow(ground.heights, ground.step_x)
        return elapsed[0]

    timed = alternate(lambda: _timed(SNOW, ground), plain)
    figures = {"ns_sample": timed.ms["total"] * 1e6 / ground.heights.size}
    return Row("land_snow", ground.heights.size, timed.ms["total"], "numpy", timed.baseline_ms, figures=figures)


def _plain_snow(heights: np.ndarray, step: float) -> np.ndarray:
    """Snow on whole arrays: the same horizons, to the end of the raster, and the same sweeps of slides."""
    sky = np.zeros_like(heights)
    for azimuth in azimuths()[: AZIMUTHS + 2 * len(GUSTS)]:
        sky += 1.0 / (1.0 + _plain_horizon(heights, step, azimuth) ** 2)
    north, east = np.gradient(heights, step)
    sun = (0.7 * north + 0.7) / np.sqrt(1.0 + north * north + east * east)
    fallen = 3.0 * sky / len(azimuths()) / (1.0 + np.exp((600.0 - heights) * 0.008 + 2.0 * sun))
    stuck = np.minimum(fallen, 0.35 * np.clip((2.2 - np.hypot(north, east)) / 1.4, 0, 1)).astype(np.float32)
    loose = np.float32(fallen) - stuck
    for _ in range(SWEEPS * AT_FIRST):
        _plain_slides(heights + stuck, loose, step)
    return stuck + loose


def _plain_horizon(heights: np.ndarray, step: float, azimuth: np.ndarray) -> np.ndarray:
    """Slopes of horizons by the nearest sample at each step of a ray."""
    out, (rows, columns) = np.zeros_like(heights), heights.shape
    for k in range(1, rows):
        dx, dy = (round(float(k * a)) for a in azimuth)
        here = slice(max(-dy, 0), min(rows, rows - dy)), slice(max(-dx, 0), min(columns, columns - dx))
        there = slice(max(dy, 0), min(rows, rows + dy)), slice(max(dx, 0), min(columns, columns + dx))
        np.maximum(out[here], (heights[there] - heights[here]) * np.float32(1.0 / (k * step)), out=out[here])
    return out


def _plain_slides(bed: np.ndarray, loose: np.ndarray, step: float) -> None:
    """One sweep of pairs: along rows, along columns and along both diagonals, even ones and then odd ones."""
    some, west, east = slice(None), slice(None, -1), slice(1, None)
    for odd in (0, 1):
        low, high = slice(odd, -1, 2), slice(odd + 1, None, 2)
        for a, b, metres in (
            ((some, low), (some, high), step),
            ((low, some), (high, some), step),
            ((low, west), (high, east), step * 2**0.5),
            ((low, east), (high, west), step * 2**0.5),
        ):
            p, q = loose[a], loose[b]
            shape = tuple(slice(0, min(n)) for n in zip(p.shape, q.shape, strict=True))
            p, q = p[shape], q[shape]
            drop = (bed[a][shape] + p) - (bed[b][shape] + q)
            over = np.maximum(np.float32(0.5) * (abs(drop) - np.float32(0.9 * metres)), 0)
            moved = np.where(drop >= 0, np.minimum(over, p), -np.minimum(over, q))
            p -= moved
            q += moved
