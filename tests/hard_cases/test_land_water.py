# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard cases 50 to 55 and 58 for water and snow: rest, fronts, limits, symmetry, mass, bytes."""

import hashlib

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.height_operators import flood
from adaptive_terrain.cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.levels import apply_by_levels
from rasters import hills


def rough_bed(rows, columns, seed, low=-30.0, high=20.0):
    return np.random.default_rng(seed).uniform(low, high, (rows, columns)).astype(np.float32)


@pytest.mark.parametrize(
    ("seed", "sea"),
    [(1, 1.37), (3, 8611.1), *(pytest.param(*lake, marks=pytest.mark.thorough) for lake in ((0, 0.0), (2, -3.3)))],
)
def test_case_50_a_lake_at_rest_stays_at_rest(seed, sea):
    """A sea with islands over a random bed is still after ten minutes: no bit of depth changes and no water leaves."""
    bed = rough_bed(50, 67, seed) + np.float32(sea)
    bed[20] = np.float32(sea) + 1e-6 * bed[20]
    water = flood.still(bed, (9.0, 4.0), sea=sea)
    before = water.water.copy()
    assert 0.3 < (before > 0.0).mean() < 0.9
    assert flood.march(water, 600.0) > 1000
    assert np.array_equal(water.water, before)
    assert not water.fluxes.any() and water.left == 0.0 and not flood.speeds(water).any()


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in (2, 3))])
def test_case_51_depth_is_never_below_zero(seed):
    """A dam of 20 m that breaks over dry ground under rain gives finite depths of at least 0 in all 400 steps."""
    rng = np.random.default_rng(seed)
    bed = rough_bed(37, 52, seed, 0.0, 3.0)
    rain = (rng.random(bed.shape) < 0.1).astype(np.float32) * np.float32(1e-3)
    water = flood.still(bed, (5.0, 8.0), rain=rain, rough=0.03 * (seed % 2))
    water.water[5:30, 3:12] = 20.0
    for _ in range(400):
        flood.step_once(water, flood.longest_step(water))
        assert water.water.min() >= 0.0 and np.isfinite(water.water).all()
    assert (water.water > 0.0).mean() > 0.5


@pytest.mark.parametrize("rough", [0.0, 0.05])
def test_case_52_a_step_at_its_limit_and_above(rough):
    """Noise of 1 mm on a lake does not grow over 600 steps of 0.99 of the limit; a step of 1.05 is refused."""
    rng = np.random.default_rng(1)
    bed = (-10 + rng.random((66, 61))).astype(np.float32)
    water = flood.still(bed, (8.0, 5.0), sea=0.0, rough=rough)
    water.water += 1e-3 * rng.random(bed.shape)
    noise = np.std(bed + water.water)
    for _ in range(600):
        flood.step_once(water, 0.99 * flood.longest_step(water))
    assert np.std(bed + water.water) < noise
    with pytest.raises(TerrainError, match="expected at most"):
        flood.step_once(water, 1.05 * flood.longest_step(water))
    assert flood.march(water, 60.0) >= 60.0 / flood.longest_step(water)


def test_case_53_rain_on_one_cell_spreads_fourfold_symmetric():
    """Rain on one cell of level ground or of a bowl gives depths with all eight symmetries of a square, to the bit."""
    rain = np.zeros((41, 41), np.float32)
    rain[20, 20] = 1e-3
    y, x = np.mgrid[-20:21, -20:21].astype(np.float32)
    for bed in (np.full((41, 41), 3.0, np.float32), np.float32(0.004) * (x * x + y * y)):
        water = flood.still(bed, (5.0, 5.0), rain=rain)
        flood.march(water, 600.0)
        w = water.water
        assert (w > 0.0).sum() > 20
        for turned in (w[::-1], w[:, ::-1], w.T, np.rot90(w), np.rot90(w, 2)):
            assert np.array_equal(w, turned)


def test_case_55_water_is_neither_made_nor_lost():
    """Ten minutes of rain on hills with a sea and holes keep the volume of water to 1e-12."""
    bed = hills(90, 70)
    missing = np.zeros(bed.shape, bool)
    missing[30:35, 40:60] = True
    rain = np.float32(50.0 / 1000 / 3600)
    water = flood.still(bed, (10.0, 13.0), sea=400.0, rain=rain, missing=missing)
    before = water.volume
    flood.march(water, 600.0)
    fallen = 600.0 * float(rain) * bed.size * 130.0
    assert water.volume - before == pytest.approx(fallen, rel=1e-9)  # rain alone: the sea is 1e4 times larger
    assert water.volume == pytest.approx(before + fallen, rel=1e-12)


def test_case_55_slides_keep_the_snow():
    """Slides on hills of up to 60 degrees keep the snow to 1e-7 of the slides, over three levels."""
    heights = 3.0 * hills(700, 530)
    snow = HEIGHT_OPERATORS["snow"]
    for wind in (0.0, 137.0):
        change = apply_by_levels(
            snow, OperatorGround(heights, 30.0, 25.0), snow.defaults() | {"wind": wind, "line": 900.0}
        )
        slides = change.layers["slides"].astype(np.float64)
        assert abs(slides).sum() > 0.05 * change.layers["snow"].sum(dtype=np.float64)
        assert abs(slides.sum()) < 1e-7 * abs(slides).sum()
        assert change.layers["snow"].min() >= 0.0


@pytest.mark.parametrize("name", ["water", "flood", "snow"])
def test_case_58_the_same_bytes_for_any_number_of_threads(name):
    """1, 2 and 3 threads give the same bytes of heights and layers."""
    effect, heights = HEIGHT_OPERATORS[name], hills(411, 333)
    values = effect.defaults() | ({"minutes": 0.5} if name == "flood" else {})
    sums = set()
    for threads in (1, 2, 3):
        change = apply_by_levels(effect, OperatorGround(heights, 20.0, 17.0, threads=threads), values)
        arrays = [change.heights, *change.layers.values()]
        sums.add(hashlib.sha256(b"".join(a.tobytes() for a in arrays)).hexdigest())
    assert len(sums) == 1
