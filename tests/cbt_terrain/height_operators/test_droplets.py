# SPDX-License-Identifier: GPL-3.0-or-later
"""Droplets: mass is conserved, and spacing, tiles and threads do not change the result."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.island import SIDE, island
from adaptive_terrain.cbt_terrain.height_operators import droplets
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.levels import apply_by_levels, finer
from adaptive_terrain.cbt_terrain.run import launch
from fields import rough


def values(**other: float) -> dict[str, float]:
    return droplets.DROPLETS.defaults() | other


def land(size: int, every: int) -> np.ndarray:
    return np.ascontiguousarray(np.maximum(island(size), 0.0)[::every, ::every])


def hills(rows: int, columns: int, seed: int = 0) -> np.ndarray:
    """Return heights above the sea, float32 m."""
    return rough(rows, columns, seed).samples[:rows, :columns].astype(np.float32) + 500.0


@pytest.mark.parametrize("steps", [(10.0, 10.0), (9.0, 14.0)])
def test_eroded_material_is_deposited_or_leaves_at_the_border(steps):
    """To 1e-12 of the moved volume, for odd sides, holes and uneven steps; holes do not change."""
    heights = hills(90, 141)
    missing = np.random.default_rng(4).random(heights.shape) < 0.02
    ground = OperatorGround(heights, *steps, whole=heights.shape, missing=missing, seed=5)
    change, carried = droplets.rain_on(ground, values(droplets=5000.0))
    moved = np.abs(change).sum() * steps[0] * steps[1]
    assert moved > 1e5 and carried > 0.0 and not change[missing].any()
    assert abs(change.sum() * steps[0] * steps[1] + carried) < 1e-12 * moved
    made = droplets.apply(ground, values(droplets=5000.0), None)
    assert np.array_equal(made.layers["sediment"] - made.layers["wear"], made.heights)
    assert abs(made.heights.sum(dtype=np.float64) * steps[0] * steps[1] + carried) < 1e-6 * moved


def test_mass_is_lost_only_at_the_border():
    """With a wall along the border nothing is lost."""
    heights = hills(90, 141)
    y, x = np.indices(heights.shape)
    walled = heights + 2000.0 * np.maximum(3 - np.minimum.reduce([y, x, 89 - y, 140 - x]), 0).astype(np.float32)
    lost = []
    for ground in (heights, walled):
        made = droplets.apply(
            OperatorGround(ground, 10.0, 10.0, whole=ground.shape, seed=5), values(droplets=5000.0), None
        )
        moved = np.abs(made.heights).sum(dtype=np.float64)
        lost.append(-made.heights.sum(dtype=np.float64) / moved)
        displaced, taken = (made.layers[name].sum(dtype=np.float64) for name in ("sediment", "wear"))
        assert moved > 1e3 and abs(taken - displaced - lost[-1] * moved) < 1e-6 * moved
    assert lost[0] > 1e-3 and abs(lost[1]) < 1e-6


def test_the_amount_does_not_depend_on_the_spacing():
    """The rms of metres agrees within a quarter at 16 and 8 m; lengths in samples would give three times as much."""
    found = []
    for every in (2, 1):
        heights, step = land(1025, every)[: 500 // every, : 400 // every], SIDE / 1024 * every
        heights = np.ascontiguousarray(heights)
        made = droplets.apply(
            OperatorGround(heights, step, step, whole=heights.shape, threads=2), values(droplets=4000.0), None
        )
        found.append(math.sqrt(np.mean(made.heights**2)))
    assert abs(found[0] / found[1] - 1.0) < 0.25 and found[1] > 0.2, found


def test_levels_below_8_m_only_smooth_the_coarser_change():
    """The sum does not change."""
    ground = OperatorGround(hills(151, 120), 4.0, 4.0, whole=(151, 120))
    coarse = droplets.apply(OperatorGround(ground.heights[::2, ::2].copy(), 8.0, 8.0, whole=(76, 60)), values(), None)
    coarse = type(coarse)(finer(coarse.heights, (151, 120)))
    made = droplets.apply(ground, values(), coarse)
    assert abs(made.heights.sum(dtype=np.float64) - coarse.heights.sum(dtype=np.float64)) < 1e-2
    assert 0.0 < np.abs(made.heights - coarse.heights).max() < 0.5 * np.abs(coarse.heights).max()


def test_threads_do_not_change_a_byte(monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 1)
    heights = hills(300, 410, seed=2)
    made = [
        droplets.apply(
            OperatorGround(heights, 16.0, 16.0, whole=heights.shape, threads=threads), values(droplets=300.0), None
        )
        for threads in (1, 2, 3)
    ]
    assert made[0].heights.any() and len({change.heights.tobytes() for change in made}) == 1


EVEN, UNEVEN = (32.0, 32.0), (31.0, 40.0)


@pytest.mark.parametrize(
    ("corner", "steps"),
    [
        ((155, 171), UNEVEN),
        ((0, 203), EVEN),
        *(pytest.param(*case, marks=pytest.mark.thorough) for case in (((155, 171), EVEN), ((0, 203), UNEVEN))),
        *(pytest.param((300, 380), steps, marks=pytest.mark.thorough) for steps in (EVEN, UNEVEN)),
    ],
)
def test_a_tile_with_its_halo_has_the_bytes_of_the_whole(steps, corner):
    """At odd offsets and borders, with cuts through droplet tiles, of which only some run."""
    heights, wide = 10.0 * hills(420, 453, seed=1), 96
    numbers = values(droplets=2000.0, reach=200.0)
    halo = droplets.DROPLETS.halo(numbers, max(steps))
    around = [math.ceil(halo / step) for step in reversed(steps)]
    whole_ground = OperatorGround(heights, *steps, whole=heights.shape, threads=2)
    whole = droplets.apply(whole_ground, numbers, None).heights
    core = [slice(at, min(at + wide, n)) for at, n in zip(corner, heights.shape, strict=True)]
    window = tuple(slice(max(c.start - n, 0), c.stop + n) for c, n in zip(core, around, strict=True))
    first = tuple(part.start for part in window)
    asked = tuple(slice(c.start - f, c.stop - f) for c, f in zip(core, first, strict=True))
    ground = OperatorGround(heights[window].copy(), *steps, first, heights.shape, target=asked)
    tile = droplets.apply(ground, numbers, None).heights[asked]
    assert np.abs(tile).max() > 0.2 and tile.tobytes() == whole[tuple(core)].tobytes()
    runs, there = (sum(map(len, droplets._tiles(droplets._rain(g, numbers), g))) for g in (ground, whole_ground))
    assert runs < 0.6 * there


def test_no_rock_is_eroded_where_the_mask_is_0():
    heights = hills(129, 129, seed=3)
    mask = np.zeros(heights.shape, np.float32)
    mask[:, 64:] = 1.0
    made = droplets.apply(OperatorGround(heights, 10.0, 10.0, whole=heights.shape, mask=mask), values(), None)
    assert made.layers["wear"][:, :60].max() == 0.0 and made.layers["wear"][:, 66:].max() > 1.0
    assert made.layers["sediment"][:, :60].max() > 0.01


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (2, 2), (2, 700), (300, 3)])
def test_narrow_rasters_are_finite(shape):
    heights = (100.0 * np.random.default_rng(1).random(shape)).astype(np.float32)
    made = apply_by_levels(droplets.DROPLETS, OperatorGround(heights, 30.0, 30.0), values())
    assert made.heights.shape == shape and np.isfinite(made.heights).all()


def test_coarse_rasters_have_at_most_4_droplets_for_a_sample():
    """A droplet then stands for several; beyond a quarter of the reach there are none."""
    far, near = (OperatorGround(hills(60, 61), step, step, whole=(60, 61)) for step in (100.0, 10.0))
    numbers = [droplets._rain(ground, values()) for ground in (far, near)]
    on_sample = [rain.drops / (rain.rows * rain.columns) for rain in numbers]
    assert on_sample[0] == 4.0 and abs(on_sample[1] - 2.0) < 1e-3
    assert abs(numbers[0].capacity / numbers[1].capacity - 200.0 / 4.0) < 1e-6
    assert droplets.apply(far, values(), None).heights.any()
    assert not droplets.apply(OperatorGround(hills(60, 61), 121.0, 121.0, whole=(60, 61)), values(), None).heights.any()
