# SPDX-License-Identifier: GPL-3.0-or-later
"""Fine relief: the formulas in numpy, tiles, threads, levels and beds."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround

RELIEF = HEIGHT_OPERATORS["relief"]


def hills(rows: int, columns: int, step_x: float, step_y: float) -> np.ndarray:
    """Return smooth ground with slopes up to 0.7, metres."""
    y, x = np.mgrid[0:rows, 0:columns] * np.array([step_y, step_x])[:, None, None]
    return (120 * np.sin(x / 310 + 0.4) * np.cos(y / 270) + 0.2 * x + 500).astype(np.float32)


def ground_of(heights: np.ndarray, step_x: float = 7.0, step_y: float = 5.0, **fields) -> OperatorGround:
    return OperatorGround(heights, step_x, step_y, whole=heights.shape, **fields)


def added(ground: OperatorGround, **parameters) -> np.ndarray:
    return RELIEF.apply(ground, RELIEF.defaults() | parameters, None).heights


def scrambled(x: np.ndarray) -> np.ndarray:
    x = x & 0xFFFFFFFF
    for factor, shift in ((0x7FEB352D, 16), (0x846CA68B, 15)):
        x = ((x ^ (x >> shift)) * factor) & 0xFFFFFFFF
    return x ^ (x >> 16)


def noise(x: np.ndarray, y: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return value and slopes of gradient noise, float64, by corners and differences of the weights."""
    i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    u, v = x - i, y - j
    total = [0.0, 0.0, 0.0]
    for dj in (0, 1):
        for di in (0, 1):
            h = scrambled(scrambled(j + dj + seed) + i + di)
            gx, gy = (h & 0xFFFF) / 32768 - 1, (h >> 16) / 32768 - 1
            a, b = (u if di else 1 - u), (v if dj else 1 - v)
            wa, wb = a**3 * (6 * a * a - 15 * a + 10), b**3 * (6 * b * b - 15 * b + 10)
            da, db = 30 * (a * (1 - a)) ** 2 * (2 * di - 1), 30 * (b * (1 - b)) ** 2 * (2 * dj - 1)
            plane = gx * (u - di) + gy * (v - dj)
            total[0] = total[0] + wa * wb * plane
            total[1] = total[1] + wa * wb * gx + da * wb * plane
            total[2] = total[2] + wa * wb * gy + wa * db * plane
    return total[0], total[1], total[2]


def expected_on_a_plane(x, y, slope, spacing, wave, seed, rough=0.3, gain=0.47) -> np.ndarray:
    """Return the sum of octaves on a plane in metres: half ridges of 0.9, damping of 6."""
    crest, size = 0.45, 0.5 * wave * (0.01 + (rough - 0.01) * slope)
    px, py, gx, gy, sum_ = x / wave, y / wave, 0.0, 0.0, 0.0
    while wave > 2 * spacing:
        n, nx, ny = noise(px, py, seed)
        weight = (1 - crest) - crest * np.clip(8 * n, -1, 1)
        sum_ = sum_ + min(wave / spacing - 2, 1) * size * (n * (1 - crest) + crest * (0.35 - np.abs(n))) / (
            1 + 6 * (gx**2 + gy**2)
        )
        gx, gy = gx + size / wave * nx * weight, gy + size / wave * ny * weight
        px, py = 1.6 * px - 1.2 * py + 0.37109375, 1.2 * px + 1.6 * py + 0.71484375
        size, wave, seed = size * gain, wave / 2, seed + 0x9E3779B9
    return sum_


@pytest.mark.parametrize("column", [0, 9_142_857], ids=["near", "64,000 km away"])
def test_octaves_are_the_formulas_near_and_far(column):
    rows, columns = 90, 131
    plane = (0.5 * 7.0 * np.arange(columns)[None, :] + np.zeros((rows, 1))).astype(np.float32)
    found = added(replace(ground_of(plane, seed=12), first=(17, column)), wave=160.0)
    inner = slice(8, -8), slice(6, -6)
    x, y = (column + np.arange(columns)) * 7.0, (17 + np.arange(rows)) * 5.0
    expected = expected_on_a_plane(*np.meshgrid(x, y), slope=0.5, spacing=7.0, wave=160.0, seed=12)
    assert np.abs(found - expected)[inner].max() < 2e-4
    assert 0.5 < expected.std() < 8.0


def test_a_tile_with_its_halo_is_the_whole():
    heights = hills(203, 310, 7.0, 5.0)
    values = {"wave": 90.0, "beds": 25.0}
    whole = added(ground_of(heights, seed=3), **values)
    halo_x, halo_y = (int(np.ceil(RELIEF.halo(RELIEF.defaults() | values, step) / step)) for step in (7.0, 5.0))
    rows, columns = slice(61, 124), slice(77, 200)
    cut = slice(61 - halo_y, 124 + halo_y), slice(77 - halo_x, 200 + halo_x)
    tile = replace(
        ground_of(np.ascontiguousarray(heights[cut]), seed=3), first=(cut[0].start, cut[1].start), whole=heights.shape
    )
    inner = added(tile, **values)[halo_y:-halo_y, halo_x:-halo_x]
    assert inner.tobytes() == whole[rows, columns].tobytes()


def test_threads_change_no_byte_and_the_seed_all():
    heights = hills(300, 517, 7.0, 5.0)
    made = [added(ground_of(heights, threads=threads), beds=30.0) for threads in (1, 2, 3)]
    assert made[0].tobytes() == made[1].tobytes() == made[2].tobytes()
    other = added(ground_of(heights, seed=1), beds=30.0)
    assert (other != made[0]).mean() > 0.99


def test_a_finer_level_adds_less_and_less():
    finest = hills(513, 769, 2.0, 2.0)
    levels = [added(ground_of(np.ascontiguousarray(finest[::k, ::k]), 2.0 * k, 2.0 * k), wave=128.0) for k in (1, 2, 4)]
    inner = slice(16, -16), slice(16, -16)
    finer, coarser = (
        float(np.sqrt(np.mean((fine[::2, ::2] - coarse)[inner] ** 2)))
        for fine, coarse in zip(levels, levels[1:], strict=False)
    )
    assert finer < 0.6 * coarser < 0.3 * levels[0].std()


def test_level_ground_stays_level_and_steep_ground_is_rough():
    level = np.full((120, 130), 40.0, np.float32)
    assert not added(ground_of(level), plains=0.0, beds=50.0).any()
    steep = (1.2 * 7.0 * np.arange(130)[None, :] + np.zeros((120, 1))).astype(np.float32)
    gentle = (0.1 * steep).astype(np.float32)
    assert added(ground_of(steep)).std() > 5 * added(ground_of(gentle)).std() > 0


def test_half_of_the_beds_form_ledges_that_end():
    slope = (0.8 * 5.0 * np.arange(500)[:, None] + np.zeros((1, 600))).astype(np.float32)
    moved = added(ground_of(slope), roughness=0.0, plains=0.0, wave=20.0, beds=40.0, dip=0.0)
    assert np.abs(moved).max() < 40.0
    still = np.abs(moved) < 0.4
    assert 0.4 < still.mean() < 0.8  # soft beds, and the feet and heads of hard ones
    assert still.any(1).mean() > 0.95  # along a contour of the slope some of it is left as it was
    shaped = slope + moved
    assert (np.diff(shaped, axis=0) > -0.02).all()  # beds keep their order: no step leans over


def test_ground_under_sediment_stays_flat():
    heights = hills(60, 80, 7.0, 5.0)
    sediment = np.zeros((60, 80), np.float32)
    sediment[:, 30:], sediment[:, 50:] = 1.0, 2.5
    bare, covered = added(ground_of(heights)), added(ground_of(heights, layers={"sediment": sediment}))
    assert not covered[:, 50:].any()
    assert np.array_equal(covered[:, :30], bare[:, :30])
    assert np.allclose(covered[:, 30:50], 0.5 * bare[:, 30:50])


def test_holes_do_not_change():
    heights = hills(60, 80, 7.0, 5.0)
    missing = np.zeros((60, 80), bool)
    missing[10:22, 31:60] = True
    moved = added(ground_of(heights, missing=missing))
    assert not moved[missing].any() and moved[~missing].any()
