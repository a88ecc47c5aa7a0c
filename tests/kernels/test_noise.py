# SPDX-License-Identifier: GPL-3.0-or-later
"""The noise that effects share: its values against plain Python integers, its slopes, and far places."""

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.kernels.field.noise import value_noise

RNG = np.random.default_rng(15)
NEAR = RNG.uniform(-50, 50, (400, 2))
PLACES = np.concatenate([NEAR, RNG.uniform(-3e9, 3e9, (100, 2)), RNG.integers(-9, 9, (20, 2))])


@wp.kernel
def value_noise_at(offset: int, p: wp.array(dtype=wp.vec2d), seed: wp.uint32, out: wp.array(dtype=wp.vec3d)):
    i = offset + wp.tid()
    out[i] = value_noise(p[i][0], p[i][1], seed)


def noise(places, seed):
    """(slope x, slope y, value) at float64[N, 2] places."""
    out = np.zeros((len(places), 3))
    given = wp.array(np.ascontiguousarray(places, np.float64), dtype=wp.vec2d, device="cpu")
    launch.spread(value_noise_at, len(places), [given, seed, wp.array(out, dtype=wp.vec3d, copy=False)], step="noise")
    return out


def scrambled(x):
    x &= 0xFFFFFFFF
    for factor, shift in ((0x7FEB352D, 16), (0x846CA68B, 15)):
        x = ((x ^ (x >> shift)) * factor) & 0xFFFFFFFF
    return x ^ (x >> 16)


def expected(x, y, seed):
    """Value of the noise, by Python's integers."""
    i, j = int(np.floor(x)), int(np.floor(y))

    def corner(di, dj):
        h = scrambled(scrambled(j + dj + seed) + i + di)
        return (h - 2**32 if h >= 2**31 else h) / 2**31

    def fade(t):
        return t**3 * (6 * t * t - 15 * t + 10)

    u, v = fade(x - i), fade(y - j)
    south = corner(0, 0) * (1 - u) + corner(1, 0) * u
    north = corner(0, 1) * (1 - u) + corner(1, 1) * u
    return south * (1 - v) + north * v


@pytest.mark.parametrize("seed", [0, 7, 2**32 - 1])
def test_values_are_those_of_plain_integers(seed):
    want = [expected(x, y, seed) for x, y in PLACES]
    assert np.abs(noise(PLACES, seed)[:, 2] - want).max() < 1e-12


def test_slopes_are_differences_of_values():
    h = 1e-5
    slopes = noise(NEAR, 3)[:, :2]
    for axis in range(2):
        step = np.eye(2)[axis] * h
        measured = (noise(NEAR + step, 3)[:, 2] - noise(NEAR - step, 3)[:, 2]) / (2 * h)
        assert np.abs(slopes[:, axis] - measured).max() < 1e-7
