# SPDX-License-Identifier: GPL-3.0-or-later
"""Scree: the bits of plain numpy, conservation, angles, artefacts and threads."""

import math

import numpy as np
import pytest
from adaptive_terrain.benchmarks.rig import plain_scree
from adaptive_terrain.cbt_terrain.field.island import SIDE, island
from adaptive_terrain.cbt_terrain.height_operators import thermal
from adaptive_terrain.cbt_terrain.height_operators.height_operator import Change, OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.levels import apply_by_levels
from adaptive_terrain.cbt_terrain.run import launch

REPOSE = math.tan(math.radians(34.0))


def values(**other: float) -> dict[str, float]:
    return thermal.THERMAL.defaults() | other


def applied(heights: np.ndarray, step: float, other: dict[str, float] | None = None, **ground) -> Change:
    return apply_by_levels(thermal.THERMAL, OperatorGround(heights, step, step, **ground), values(**(other or {})))


def mountain(size: int) -> np.ndarray:
    """Return the island's land, twice as high, float32 [size, size] m."""
    every = 1024 // (size - 1)
    return np.ascontiguousarray(2.0 * np.maximum(island(1025), 0.0)[::every, ::every])


def cone(size: int, step: float, slope: float) -> np.ndarray:
    x = (np.arange(size) - (size - 1) / 2) * step
    return np.maximum(0.8 * slope * x[-1] - slope * np.hypot(x[:, None], x), 0.0).astype(np.float32)


def along_circles(surface: np.ndarray, radii: np.ndarray) -> list[np.ndarray]:
    """Return heights on circles around the centre, a sample apart, by Catmull and Rom's spline."""
    middle, found = (len(surface) - 1) / 2, []
    for radius in radii:
        angle = np.arange(int(2 * math.pi * radius)) / int(2 * math.pi * radius) * 2 * math.pi
        y, x = middle + radius * np.sin(angle), middle + radius * np.cos(angle)
        j, i = y.astype(int), x.astype(int)
        found.append(sum(w * surface[j + b - 1, i + a - 1] for b, a, w in _spline(y - j, x - i)))
    return found


def _spline(v, u):
    def weights(t):
        return (
            ((-t + 2) * t - 1) * t / 2,
            ((3 * t - 5) * t * t + 2) / 2,
            ((-3 * t + 4) * t + 1) * t / 2,
            (t - 1) * t * t / 2,
        )

    return [(b, a, p * q) for b, p in enumerate(weights(v)) for a, q in enumerate(weights(u))]


def comb(surface: np.ndarray, radii: np.ndarray) -> float:
    """Return the rms of second differences along contour lines of a cone in metres."""
    rings = along_circles(surface.astype(np.float64), radii)
    return math.sqrt(np.mean(np.concatenate([np.roll(z, 1) - 2 * z + np.roll(z, -1) for z in rings]) ** 2))


@pytest.mark.parametrize(
    ("shape", "first"), [((37, 50), (3, 8)), ((24, 33), (0, 1)), ((1, 9), (0, 0)), ((9, 1), (1, 1))]
)
@pytest.mark.parametrize("threads", [1, 3])
def test_sweeps_have_the_bits_of_plain_numpy(shape, first, threads, monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 5)
    rng = np.random.default_rng(5)
    ground = OperatorGround((300.0 * rng.random(shape)).astype(np.float32), 7.0, 11.0, first, (99, 99), seed=77)
    room = np.full(shape, 20.0, np.float32)
    base = ground.heights - room
    base[shape[0] // 2, shape[1] // 2] = np.nan
    scree = (3.0 * rng.random(shape)).astype(np.float32)
    left, plain_left, plain = room.copy(), room.copy(), scree.copy()
    slope = thermal.pack_slope(ground, values(), base, left, scree)
    for number in range(6):
        list(thermal.sweep(slope, number, threads))
        plain_scree.sweep(slope, number, base, plain_left, plain)
        assert scree.tobytes() == plain.tobytes() and left.tobytes() == plain_left.tobytes()
    assert (room - left).max() > 1.0


def test_loose_mountains_come_to_rest_and_the_next_size_agrees():
    """No slope of scree 2,900 m high is 1.6 times its angle, and twice the samples change less than 1 m."""
    after = {}
    for size in (257, 513):
        heights, step = mountain(size), SIDE / (size - 1)
        change = applied(heights, step, {"depth": 0.0}, layers={"scree": heights}, threads=2).heights
        after[size] = heights + change
        steepest = max(np.abs(np.diff(after[size], axis=axis)).max() for axis in (0, 1)) / step
        assert steepest < 1.6 * REPOSE
        assert abs(change.sum(dtype=np.float64)) < 1e-7 * np.abs(change).sum(dtype=np.float64)
    assert math.sqrt(np.mean((after[513][::2, ::2] - after[257]) ** 2)) < 1.0


def test_a_steep_cone_has_no_comb(monkeypatch):
    """Second differences along contour lines are 0.18 m in rock, less in scree; 0.6 if a pair gave all of its scree at
    once and wear were not smoothed."""
    heights, radii = cone(161, 8.0, 2.0), np.arange(15.0, 55.0)
    one_bed = {"soft_angle": 45.0, "hard_angle": 45.0, "depth": 60.0, "uneven": 0.0}
    monkeypatch.setattr(thermal, "AT_FIRST", 3)
    change = applied(heights, 8.0, one_bed)
    assert change.layers["wear"].max() > 15.0
    rock = comb(heights - change.layers["wear"], radii)
    assert rock < 0.25 and comb(change.layers["scree"], radii) < 0.05
    monkeypatch.setattr(thermal, "MAX_FRACTION", 1.0)
    monkeypatch.setattr(thermal, "smooth_wear", lambda left, breakable: None)
    assert comb(heights - applied(heights, 8.0, one_bed).layers["wear"], radii) > 2.0 * rock


def test_a_heap_lies_at_its_angle_in_every_direction():
    """Within 1.5 % of 34 degrees; with limits along eight directions alone it would be 8 % steeper between them."""
    heights = np.zeros((129, 129), np.float32)
    heights[60:69, 60:69] = 900.0
    change = applied(heights, 8.0, {"depth": 0.0, "uneven": 0.0}, layers={"scree": heights})
    slope = np.hypot(*np.gradient(heights + change.heights, 8.0)) / REPOSE
    y, x = np.mgrid[:129, :129] - 64
    side, away = np.round(np.arctan2(y, x) * 12 / math.pi), np.hypot(x, y)
    on_side = [slope[(side == n) & (away > 6) & (away < 18)].mean() for n in range(-11, 13)]
    assert 0.985 < min(on_side) and max(on_side) < 1.015


def test_nothing_is_lost_with_a_mask_and_holes():
    """Mass is conserved to 1e-7 over three levels; masked rock and holes do not change."""
    heights = np.ascontiguousarray(mountain(1025)[250:850, 201:502])
    rng = np.random.default_rng(2)
    mask = np.clip(np.linspace(-0.5, 1.5, 301, dtype=np.float32) + np.zeros((600, 1), np.float32), 0.0, 1.0)
    missing = rng.random(heights.shape) < 0.01
    missing[300:320, 200:230] = True
    change = applied(heights, 8.0, mask=mask, missing=missing, threads=2, seed=3)
    worn, scree = change.layers["wear"], change.layers["scree"]
    assert worn.max() > 20.0 and scree.max() > 5.0 and np.isfinite(change.heights).all()
    assert not worn[:, :70].any() and not change.heights[missing].any()
    assert worn.min() >= 0.0 and (worn <= 30.0 * mask + 1e-4).all() and scree.min() >= 0.0
    assert abs(worn.sum(dtype=np.float64) - scree.sum(dtype=np.float64)) < 1e-7 * worn.sum(dtype=np.float64)


def test_threads_do_not_change_a_byte(monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 100)
    heights = np.ascontiguousarray(mountain(1025)[300:490, 300:431])
    made = [applied(heights, 8.0, threads=threads) for threads in (1, 2, 5)]
    assert made[0].heights.any()
    assert len({change.heights.tobytes() + change.layers["scree"].tobytes() for change in made}) == 1


def test_at_the_limit_nothing_grows(monkeypatch):
    """A pair that gave all of its excess would oscillate; at 0.99 of that heights stay in their range."""
    monkeypatch.setattr(thermal, "SHARE", 0.99)
    rng = np.random.default_rng(1)
    heights = (500.0 * rng.random((65, 65))).astype(np.float32)
    change = applied(heights, 1.0, {"depth": 0.0, "uneven": 0.0}, layers={"scree": heights})
    after = heights + change.heights
    assert after.min() >= 0.0 and after.max() <= 500.0
    assert max(np.abs(np.diff(after, axis=axis)).max() for axis in (0, 1)) < 30.0
