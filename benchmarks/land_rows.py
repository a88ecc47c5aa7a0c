# SPDX-License-Identifier: GPL-3.0-or-later
"""What effects on heights cost, beside the plain way in numpy or another library."""

import numpy as np

from ..cbt_terrain.field.island import SIDE, island
from ..cbt_terrain.land.land_effect import Ground
from ..cbt_terrain.land.relief import RELIEF
from .measure import Row, alternate, stopwatch

SAMPLES = 1025
WAVE = 128.0  # metres


def land_rows():
    """Of the built-in island, one thread."""
    heights, step = island(SAMPLES), SIDE / (SAMPLES - 1)
    yield _relief(heights, step)


def _relief(heights: np.ndarray, step: float) -> Row:
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
