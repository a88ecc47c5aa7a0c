# SPDX-License-Identifier: GPL-3.0-or-later
"""Floods against solutions in closed form, the limit of their steps, and outlets."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.height_operators import flood
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround
from rasters import hills


def basin(rows, columns, depth):
    """Return level ground within walls."""
    bed = np.full((rows, columns), 100.0, np.float32)
    bed[1:-1, 1:-1] = -depth
    return bed


@pytest.mark.parametrize("axis", [0, 1])
def test_a_standing_wave_has_the_period_of_gravity(axis):
    """The slowest wave of a basin has the period 2 L / sqrt(g h)."""
    cells, shape = 60, [9, 9]
    shape[axis] = cells + 2
    water = flood.still(basin(*shape, 10.0), (4.0, 6.0), sea=0.0, rough=0.0)
    wave = 0.01 * np.cos(np.pi * (np.arange(cells) + 0.5) / cells)
    inner = np.moveaxis(water.water, axis, 0)[1:-1]
    inner[:, 1:-1] += wave[:, None]
    before = water.water.copy()
    metres = (6.0, 4.0)[axis]
    flood.march(water, 2.0 * cells * metres / math.sqrt(9.81 * 10.0))
    moved = abs(water.water - before)
    assert moved.max() < 0.03 * 0.01
    flood.march(water, cells * metres / math.sqrt(9.81 * 10.0))
    assert abs((water.water - 10.0) + (before - 10.0))[1:-1, 1:-1].max() < 0.06 * 0.01


def test_rain_on_a_slope_runs_off_at_mannings_depth():
    slope, rain, rough = 0.02, 100.0 / 1000 / 3600, 0.04
    bed = np.tile(np.float32(slope * 5.0) * np.arange(60, dtype=np.float32), (12, 1))
    bed[[0, -1]] += 50.0  # walls along it, the slope falls to the west
    bed[:, -1] += 50.0
    water = flood.still(bed, (5.0, 5.0), rain=rain, rough=rough)
    flood.march(water, 1800.0)
    x = 5.0 * (58.5 - np.arange(10, 50))  # metres of slope above a sample
    depth = (rough * rain * (x + 2.5) / math.sqrt(slope)) ** 0.6
    assert np.allclose(water.water[5, 10:50], depth, rtol=0.03)
    assert np.allclose(flood.speeds(water)[5, 10:35], (rain * x / depth)[:25], rtol=0.06)


def test_a_step_that_is_too_long_is_refused():
    water = flood.still(basin(9, 12, 5.0), (4.0, 4.0), sea=0.0)
    longest = flood.longest_step(water)
    assert longest == pytest.approx(4.0 / math.sqrt(2 * 9.81 * 5.0), rel=0.06)
    before = water.water.copy()
    for seconds in (1.05 * longest, 0.0, -1.0, math.nan):
        with pytest.raises(TerrainError, match=r"at most 0\.\d+ s where water is 5 m deep"):
            flood.step_once(water, seconds)
    assert np.array_equal(water.water, before)
    flood.step_once(water, longest)


def test_time_is_divided_into_equal_steps_of_at_most_the_limit():
    water = flood.still(basin(9, 12, 5.0), (4.0, 4.0), sea=0.0)
    assert flood.march(water, 100.0) == math.ceil(100.0 / (0.99 * flood.longest_step(water)))
    assert flood.march(water, 0.0) == 0


def test_water_leaves_at_holes_and_at_the_border():
    bed = hills(40, 30)
    missing = np.zeros(bed.shape, bool)
    missing[10:14, 20:25] = True
    water = flood.still(bed, (10.0, 12.0), rain=1e-4, missing=missing)
    flood.march(water, 600.0)
    assert not water.water[missing].any()
    assert not water.water[[0, -1]].any() and not water.water[:, [0, -1]].any()
    assert water.left > 0.0
    fallen = 600.0 * 1e-4 * bed.size * 120.0
    assert water.volume == pytest.approx(fallen, rel=1e-7)  # rain is float32


def test_a_mask_scales_the_rain():
    mask = np.zeros((21, 33), np.float32)
    mask[8:12, 5:9] = 0.5
    ground = OperatorGround(basin(21, 33, 0.0), 5.0, 5.0, whole=(21, 33), mask=mask)
    values = flood.FLOOD.defaults() | {"rain": 36.0, "minutes": 10.0, "sea": -1.0}
    depth = flood.FLOOD.apply(ground, values, None).layers["water_depth"]
    assert depth.sum(dtype=np.float64) == pytest.approx(16 * 0.5 * 0.006, rel=1e-5)


@pytest.mark.thorough
def test_a_surge_runs_ashore_and_back():
    bed = np.tile(np.linspace(-20, 20, 80).astype(np.float32), (81, 1))
    values = flood.FLOOD.defaults() | {"rain": 0.0, "surge": 5.0}
    ground = OperatorGround(bed, 10.0, 10.0, whole=bed.shape)
    wet = []
    for minutes in (0.0, 0.3, 120.0):
        layers = flood.FLOOD.apply(ground, values | {"minutes": minutes}, None).layers
        wet.append(int((layers["water_depth"][40] > 0.05).sum()))
        assert (layers["water_speed"] <= np.sqrt(9.81 * layers["water_depth"]) * (1 + 1e-6)).all()
    assert wet[1] > wet[0] + 2 and wet[2] == wet[0]


def test_a_flood_that_would_take_hours_is_refused():
    """A sea of 5 km has samples a metre apart."""
    ground = OperatorGround(np.full((40, 30), -5000.0, np.float32), 1.0, 1.0)
    values = flood.FLOOD.defaults() | {"minutes": 2880.0}
    with pytest.raises(TerrainError, match=r"would take 57,\d{3},\d{3} steps where water is 5000 m deep.*take \d+ min"):
        flood.apply(ground, values, None)
