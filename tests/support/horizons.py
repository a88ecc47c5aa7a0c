# SPDX-License-Identifier: GPL-3.0-or-later
"""Horizons from cell to cell in plain Python, and the engine's for the same rays."""

import math
from dataclasses import replace

import numpy as np
import warp as wp
from adaptive_terrain.cbt_terrain.attributes.attribute import SamplePoints
from adaptive_terrain.cbt_terrain.attributes.occluder import occluder_of, occluder_without_blocks
from adaptive_terrain.cbt_terrain.field.codes import Steps
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.kernels.effects.horizon import Occluder, cells_of, horizon, surface

NEVER = math.inf


@wp.kernel
def horizons(
    offset: int,
    g: Occluder,
    far: wp.float64,
    least: wp.float64,
    places: wp.array(dtype=wp.vec3f),
    azimuths: wp.array(dtype=wp.vec2d),
    out: wp.array(dtype=wp.float64),
):
    i = offset + wp.tid()
    x = cells_of(wp.float64(places[i][0]), g.west, g.step_x, g.samples.columns - 1)
    y = cells_of(wp.float64(places[i][1]), g.south, g.step_y, g.samples.rows - 1)
    out[i] = horizon(g, x, y, surface(g, x, y), azimuths[i], far, least, wp.float64(1.0e300))


def engines(places: SamplePoints, azimuths: np.ndarray, far=1e300, least=0.0, blocks=True) -> np.ndarray:
    """float64 [n]: the slope of each place's horizon along its azimuth (float64 [n, 2]); without blocks every crossing
    is visited."""
    ground = occluder_of(places) if blocks else occluder_without_blocks(places.field, places.vertical_scale)
    out = np.zeros(len(places))
    where = wp.array(np.ascontiguousarray(places.positions), dtype=wp.vec3f, device="cpu", copy=False)
    along = wp.array(np.ascontiguousarray(azimuths), dtype=wp.vec2d, device="cpu", copy=False)
    inputs = [ground, wp.float64(far), wp.float64(least), where, along]
    launch.spread(horizons, len(places), [*inputs, wp.array(out, device="cpu", copy=False)], step="test")
    return out


def from_cell_to_cell(field: HeightField, scale: float, place, azimuth, far=1e300, least=0.0) -> float:
    """Return the horizon of one ray in float64, cell by cell."""
    lattice, h = field.lattice, field.heights()
    west, south, _, _ = lattice.rectangle()
    x0 = min(max((float(place[0]) - west) / lattice.step_x, 0.0), float(lattice.cells_x))
    y0 = min(max((float(place[1]) - south) / lattice.step_y, 0.0), float(lattice.cells_y))
    dx, dy = azimuth[0] / lattice.step_x, azimuth[1] / lattice.step_y
    z0 = _on_surface(h, scale, x0, y0)
    near = min(lattice.step_x, lattice.step_y) / 1024.0
    i, j = _first_cell(x0, dx, lattice.cells_x), _first_cell(y0, dy, lattice.cells_y)
    best = least
    while 0 <= i < lattice.cells_x and 0 <= j < lattice.cells_y:
        to_x = (i + (dx > 0) - x0) * (1.0 / dx) if dx else NEVER
        to_y = (j + (dy > 0) - y0) * (1.0 / dy) if dy else NEVER
        if to_x <= to_y:
            way, line, part = to_x, i + (dx > 0), y0 + to_x * dy - j
            a, b = h[j, line], h[j + 1, line]
            i += 1 if dx > 0 else -1
        else:
            way, line, part = to_y, j + (dy > 0), x0 + to_y * dx - i
            a, b = h[line, i], h[line, i + 1]
            j += 1 if dy > 0 else -1
        a, b = scale * float(a), scale * float(b)
        if near < way <= far:
            best = max(best, (a + (b - a) * part - z0) / way)
    return best


def _first_cell(at: float, direction: float, cells: int) -> int:
    cell = int(at)
    cell -= direction < 0 and cell == at
    return min(cell, cells - 1)


def _on_surface(h: np.ndarray, scale: float, x: float, y: float) -> float:
    i, j = min(int(x), h.shape[1] - 2), min(int(y), h.shape[0] - 2)
    (a, b), (c, d) = h[j : j + 2, i : i + 2].astype(float).tolist()
    a += (b - a) * (x - i)
    c += (d - c) * (x - i)
    return scale * (a + (c - a) * (y - j))


def places_on(field: HeightField, count: int, seed: int = 0, scale: float = 1.0) -> SamplePoints:
    """Return places: a third on samples, between them, and on the border and its corners; heights are arbitrary."""
    lattice, rng = field.lattice, np.random.default_rng(seed)
    west, south, _, _ = lattice.rectangle()
    cells = rng.uniform(0, 1, (count, 2)) * (lattice.cells_x, lattice.cells_y)
    cells[::3] = np.rint(cells[::3])
    cells[1::3] = np.where(
        rng.uniform(size=cells[1::3].shape) < 0.6,
        np.rint(rng.uniform(size=cells[1::3].shape)) * (lattice.cells_x, lattice.cells_y),
        cells[1::3],
    )
    positions = np.zeros((count, 3), np.float32)
    positions[:, 0], positions[:, 1] = west + cells[:, 0] * lattice.step_x, south + cells[:, 1] * lattice.step_y
    return SamplePoints(field, positions, np.zeros(count, np.float32), scale)


def every_sample(field: HeightField, scale: float = 1.0, threads: int = 1) -> SamplePoints:
    """Return the samples of a raster row by row."""
    lattice = field.lattice
    west, south, _, _ = lattice.rectangle()
    x, y = west + np.arange(lattice.width) * lattice.step_x, south + np.arange(lattice.height) * lattice.step_y
    positions = np.stack([*np.meshgrid(x, y), field.heights() * scale], -1).astype(np.float32).reshape(-1, 3)
    return SamplePoints(field, positions, np.zeros(len(positions), np.float32), scale, threads=threads)


def directions(count: int, seed: int = 0) -> np.ndarray:
    """float64 [count, 2]: half at random, a quarter along the axes, a quarter along the diagonals."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, count)
    found = np.stack([np.cos(angle), np.sin(angle)], -1)
    axes = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)], float)
    diagonals = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)], float) / math.sqrt(2.0)
    found[::4], found[1::4] = axes[rng.integers(0, 4, len(found[::4]))], diagonals[rng.integers(0, 4, len(found[1::4]))]
    return found


def coded(field: HeightField, scale: float = 0.25) -> tuple[HeightField, HeightField]:
    """Return a field of heights that are multiples of `scale`, as floats and as 16-bit numbers."""
    numbers = np.clip(np.rint(field.samples / scale), -32768, 32767)
    steps = Steps(-32768, scale, 0.0)
    stored = (numbers + 32768).astype(np.uint16)
    heights = steps.heights(stored)
    low, high = float(heights.min()), float(heights.max())
    floats = replace(field.with_raster(samples=heights), min_height=low, max_height=high)
    return floats, floats.with_raster(samples=stored, steps=steps)
