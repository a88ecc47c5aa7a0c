# SPDX-License-Identifier: GPL-3.0-or-later
"""The snippets of C of light and footprints against the same arithmetic in Python: the same bits.

That of kernels/effects/horizon.py has no twin: its walk by blocks is compared with every crossing, and both with known
geometry, in tests/cbt_terrain/attributes/test_light.py.
"""

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.attributes.sky_layer import sweep
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.run.buffers import flat, shared
from adaptive_terrain.kernels.effects import footprint
from adaptive_terrain.kernels.effects.sweep import Sky, add_sky

F = np.float32


def horizons(heights, steps, azimuth, scale):
    """Compute slopes of horizons line by line with an upper hull, in float64 until they are stored."""
    rows, columns = heights.shape
    east, north = azimuth[0] / steps[0], azimuth[1] / steps[1]
    upright = abs(north) > abs(east)
    h = heights.T if upright else heights  # h[minor, major]
    minor, major = h.shape
    along, across = (north, east) if upright else (east, north)
    slope, metres = across / along, 1.0 / abs(along)
    out = np.zeros_like(h)
    reach = slope * (major - 1)
    first, last = int(np.floor(min(-reach, 0.0))), int(np.floor(minor - 1 + max(-reach, 0.0))) + 1
    before = None
    for line in range(first, last + 1):
        now, hull = np.full(major, F(-1)), []
        for k in range(major) if along < 0 else range(major - 1, -1, -1):
            at = line + slope * k
            if not 0.0 <= at <= minor - 1:
                continue
            j = min(int(at), minor - 2)
            p, q = float(h[j, k]), float(h[j + 1, k])
            own = scale * (p + (q - p) * (at - j))
            while len(hull) > 1:
                (a, za), (b, zb) = hull[-1], hull[-2]
                if (zb - own) * abs(a - k) < (za - own) * abs(b - k):
                    break
                hull.pop()
            rise = (hull[-1][1] - own) / (abs(hull[-1][0] - k) * metres) if hull else 0.0
            now[k] = F(rise) if rise > 0 else F(0)
            hull.append((k, own))
        if before is not None:
            for k in range(major):
                at = line - 1 + slope * k
                j = int(np.ceil(at))
                if at <= -1.0 or j >= minor:
                    continue
                a, b = before[k], now[k]
                between = F(float(a) + (float(b) - float(a)) * (j - at))
                out[j, k] = b if a < 0 else a if b < 0 else between
        before = now
    return out.T if upright else out


@pytest.mark.parametrize("angle", [0.2, 1.3, 2.0, 3.5, 4.4, 5.9])
def test_a_sweep_has_the_bits_of_its_arithmetic_in_python(angle):
    rng = np.random.default_rng(int(10 * angle))
    heights, steps = (rng.standard_normal((23, 31)).cumsum(1) * 4).astype(F), (3.0, 2.0)
    azimuth, out = np.array([np.cos(angle), np.sin(angle)]), np.empty((23, 31), F)
    for scale in (1.0, -1.7):
        sweep(heights, steps, azimuth, scale, 2, out)
        assert out.tobytes() == np.ascontiguousarray(horizons(heights, steps, azimuth, scale)).tobytes()
    assert (out > 0).mean() > 0.3


@pytest.mark.parametrize("angle", [0.2, 1.3])
def test_a_part_with_all_ground_ahead_gives_the_whole_result(angle):
    heights = (np.random.default_rng(3).standard_normal((47, 61)).cumsum(1) * 4).astype(F)
    azimuth, steps = np.array([np.cos(angle), np.sin(angle)]), (3.0, 2.0)
    whole, part, moved = np.empty((47, 61), F), np.empty((30, 40), F), np.empty((30, 40), F)
    sweep(heights, steps, azimuth, 1.0, 1, whole)
    cut = np.ascontiguousarray(heights[17:, 21:])
    sweep(cut, steps, azimuth, 1.0, 1, part, (17, 21))
    sweep(cut, steps, azimuth, 1.0, 1, moved)
    inner = np.s_[1:, 1:]
    assert np.abs(part - whole[17:, 21:])[inner].max() < 1e-6 and np.abs(moved - part)[inner].max() > 1e-2


def open_row(heights, per, azimuth, share, horizon, total):
    """Compute the sky over a row's samples in float32, statement by statement."""
    one, half_turn = F(1), F(1.5707963268)
    gy, gx = np.gradient(heights)
    edge = np.ones(heights.shape[1], F) * F(0.5)
    edge[[0, -1]] = one
    east, west = np.r_[1 : heights.shape[1], -1], np.r_[0, 0 : heights.shape[1] - 1]
    gx = (heights[:, east] - heights[:, west]) * (F(per[0]) * edge)
    north, south = np.r_[1 : len(heights), -1], np.r_[0, 0 : len(heights) - 1]
    count = np.full(len(heights), F(2))
    count[[0, -1]] = one
    gy = (heights[north] - heights[south]) * (F(per[1]) / count)[:, None]
    plane = gx * F(azimuth[0]) + gy * F(azimuth[1])
    slope = np.maximum(horizon, plane)
    size = np.abs(slope)
    up, q = one / np.sqrt(one + gx * gx + gy * gy), one / (one + slope * slope)
    t = np.where(size > 1, one / np.maximum(size, F(1e-30)), size)
    u = t * t
    part = F(0.0028662257)
    for number in (
        -0.0161657367,
        0.0429096138,
        -0.0752896400,
        0.1065626393,
        -0.1420889944,
        0.1999355085,
        -0.3333314528,
    ):
        part = F(number) + u * part
    part = t + t * u * part
    steep = np.where(size > 1, half_turn - part, part)
    over = half_turn - np.where(slope < 0, -steep, steep)
    return total + F(share) * (up * q - plane * up * (over - slope * q))


def test_the_sky_of_a_row_has_the_bits_of_numpy():
    rng = np.random.default_rng(5)
    heights = (rng.standard_normal((9, 37)) * 5).astype(F)
    horizon, total = rng.exponential(0.6, (9, 37)).astype(F), rng.random((9, 37)).astype(F)
    per, azimuth, out = (0.4, 0.7), (0.6, -0.8), total.copy()
    sky = Sky()
    sky.columns, sky.rows, sky.share = 37, 9, 1 / 16
    sky.per_cell, sky.azimuth = wp.vec2f(*per), wp.vec2f(*azimuth)
    sky.heights, sky.horizons, sky.out = (flat(a, wp.float32) for a in (heights, horizon, out))
    launch.spread(add_sky, 9, [sky], step="test", threads=2)
    wanted = open_row(heights, per, azimuth, 1 / 16, horizon, total)
    assert wanted.dtype == F and out.tobytes() == wanted.tobytes()


def test_footprints_are_the_nearest_eighths_of_their_distances():
    """Of an eye that is turned and sheared: levels of float64 arithmetic, but where rounding decides between two."""
    rng, count = np.random.default_rng(6), 3 * int(footprint.BLOCK) + 17
    positions = (rng.standard_normal((count, 3)) * 10 ** rng.uniform(0, 4, (count, 1))).astype(F)
    eye, linear, shift = footprint.FootprintEye(), rng.standard_normal((3, 3)), rng.standard_normal(3)
    eye.linear, eye.shift, eye.pixel2 = wp.mat33d(linear), wp.vec3d(*shift), 1e-2
    levels, finer_levels = np.full((2, count), np.inf, F)
    inputs = [shared(positions, wp.vec3f), wp.array([eye], dtype=footprint.FootprintEye, device="cpu")]
    blocks = -(-count // int(footprint.BLOCK))
    for least, out in ((0, levels), (-3, finer_levels)):
        arrays = [*inputs, least, 6, flat(out, wp.float32)]
        launch.spread(footprint.footprint_levels, blocks, arrays, step="test", threads=2)
    squared = ((positions.astype(float) @ linear.T + shift) ** 2).sum(1) * 1e-2
    exact = np.clip(0.5 * np.log2(np.maximum(squared, 1.0)), 0.0, 6.0)
    wanted = np.floor(8 * exact + 0.5) / 8
    on_edge = np.abs(8 * exact % 1 - 0.5) < 1e-4
    assert (levels == wanted)[~on_edge].all() and on_edge.mean() < 0.01
    assert (np.abs(levels - wanted) <= 1 / 8).all() and len(set(levels)) > 40
    exact = np.clip(0.5 * np.log2(squared), -3.0, 6.0)
    on_edge = np.abs(8 * exact % 1 - 0.5) < 1e-4
    assert (finer_levels == np.floor(8 * exact + 0.5) / 8)[~on_edge].all() and finer_levels.min() == -3.0
    assert (np.maximum(finer_levels, 0.0) == levels).all()
