# SPDX-License-Identifier: GPL-3.0-or-later
"""Water under steady rain: conservation, Manning's depths, level lakes."""

import heapq

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.water import WATER, YEAR
from rasters import hills

STEP_X, STEP_Y = 10.0, 7.0
SHAPE = (81, 62)


def ground(missing=None, threads=1, heights=None):
    heights = hills(SHAPE[1], SHAPE[0]) if heights is None else heights
    return OperatorGround(heights, STEP_X, STEP_Y, whole=heights.shape, missing=missing, threads=threads)


def layers(ground, **values):
    change = WATER.apply(ground, WATER.defaults() | values, None)
    assert not change.heights.any()
    return change.layers


def filled(heights, base):
    """Fill depressions with a heap, lowest first (Barnes, Lehman and Mulla 2014)."""
    out = np.where(base, heights, np.inf)
    heap = [(heights[at], at) for at in zip(*np.nonzero(base), strict=True)]
    heapq.heapify(heap)
    while heap:
        level, (j, i) = heapq.heappop(heap)
        for y in range(max(j - 1, 0), min(j + 2, heights.shape[0])):
            for x in range(max(i - 1, 0), min(i + 2, heights.shape[1])):
                if np.isinf(out[y, x]):
                    out[y, x] = max(heights[y, x], level)
                    heapq.heappush(heap, (out[y, x], (y, x)))
    return out


def border_mask(shape):
    base = np.ones(shape, bool)
    base[1:-1, 1:-1] = False
    return base


@pytest.mark.parametrize("sea", [-12000.0, 450.0])
def test_all_rain_leaves_at_the_border_or_into_the_sea(sea):
    land = ground()
    out = border_mask(SHAPE) | (land.heights <= sea)
    found = layers(land, rain=1.7, sea=sea)["discharge"][out].sum(dtype=np.float64)
    assert found == pytest.approx(1.7 * land.heights.size * STEP_X * STEP_Y / YEAR, rel=1e-6)


def test_flowing_water_has_mannings_depth_and_speed():
    land = ground()
    found = layers(land, rain=2.0, sea=-12000.0, roughness=0.03)
    surface = filled(land.heights, border_mask(SHAPE)).astype(np.float64)
    north, east = np.gradient(surface, STEP_Y, STEP_X)
    steep = np.maximum(np.hypot(north, east), 1e-3)
    discharge = found["discharge"].astype(np.float64)
    width = 3.0 * np.sqrt(discharge)
    normal = (0.03 * discharge / width / np.sqrt(steep)) ** 0.6
    flowing = surface == land.heights
    depth = found["water_depth"]
    assert (depth[flowing] > normal[flowing] * (1 - 1e-5)).all()
    uniform = flowing & (depth < normal * (1 + 1e-5))
    assert uniform[flowing].mean() > 0.9  # the others are dammed
    speed = depth[uniform] ** (2 / 3) * np.sqrt(steep[uniform]) / 0.03
    assert np.allclose(found["water_speed"][uniform], speed, rtol=1e-4)
    assert (found["water_speed"][flowing] <= (discharge / width / normal)[flowing] * (1 + 1e-4)).all()


def test_lakes_are_level_at_the_height_of_their_outlet():
    land = ground()
    depth = layers(land, sea=-12000.0)["water_depth"]
    surface, level = filled(land.heights, border_mask(SHAPE)), land.heights + depth
    lakes = np.unique(surface[surface > land.heights])
    assert len(lakes) > 20
    for at in lakes:
        lake = (surface == at) & (land.heights < at)
        assert level[lake].max() - level[lake].min() < 2e-4  # float32 at 800 m
        assert -1e-4 < level[lake].min() - at < 1.0


def test_the_sea_is_level():
    land = ground()
    depth = layers(land, sea=520.0)["water_depth"]
    under = land.heights <= 520.0
    assert abs((land.heights + depth)[under] - 520.0).max() < 1e-4
    assert 0.1 < under.mean() < 0.9


def test_water_leaves_at_holes():
    missing = np.zeros(SHAPE, bool)
    missing[30:40, 20:31] = True
    found = layers(ground(missing), sea=-12000.0)
    for layer in found.values():
        assert (layer[missing] == 0.0).all() and np.isfinite(layer).all() and (layer >= 0.0).all()
    whole = layers(ground(), sea=-12000.0)["discharge"]
    out = border_mask(SHAPE)
    assert found["discharge"][out].sum() < whole[out].sum() - 0.9 * missing.sum() * STEP_X * STEP_Y / YEAR


def test_a_stream_stays_in_one_channel_on_a_smooth_slope():
    """A valley of 3.7 km2 ends on a plane of 1 : 4, where its water crosses each row at one sample."""
    y, x = np.mgrid[:140, :61].astype(float)
    heights = (1000.0 - 7.5 * y + np.where(y < 70, 30.0, 0.0) * abs(x - 30)).astype(np.float32)
    found = layers(OperatorGround(heights, 30.0, 30.0, whole=heights.shape), sea=-900.0)["discharge"]
    for row in found[71:135]:
        stream = row.argmax()
        assert row[stream] > 0.8 * 70 * 61 * 900.0 / YEAR and (np.delete(row, stream) < 0.01).all()


def test_no_rain_leaves_lakes_and_no_rivers():
    land = ground()
    found = layers(land, rain=0.0, sea=-12000.0)
    lakes = np.maximum(filled(land.heights, border_mask(SHAPE)) - land.heights, 0.0)
    assert np.array_equal(found["water_depth"], lakes.astype(np.float32))
    assert not found["water_speed"].any() and not found["discharge"].any()


def test_threads_do_not_change_a_byte():
    many = hills(401, 303, 4)
    one = layers(ground(heights=many))
    for threads in (2, 3):
        other = layers(ground(threads=threads, heights=many))
        assert all(np.array_equal(one[name], other[name]) for name in one)
