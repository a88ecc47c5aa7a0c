# SPDX-License-Identifier: GPL-3.0-or-later
"""Snow: a plain reference with horizons by brute force, slides, tiles and levels."""

import itertools
import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.height_operators import levels, snow
from adaptive_terrain.cbt_terrain.height_operators.height_operator import Change, OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.levels import apply_by_levels
from own_surface import bilinear
from rasters import hills

VALUES = snow.SNOW.defaults() | {"line": 500.0}


def smooth_hills(columns, rows, seed=3, relief=2.0):
    """Return hills without noise of single samples."""
    y, x = np.indices((rows, columns)) / 14.0
    turn = np.random.default_rng(seed).uniform(0, 7, 4)
    waves = np.sin(x + turn[0]) * np.cos(y + turn[1]) + 0.3 * np.sin(2.7 * x + 1.9 * y + turn[2])
    return (500.0 + 100.0 * relief * waves).astype(np.float32)


def horizons(heights, step_x, step_y, azimuth):
    """Return slopes of horizons, at least 0, from points half a sample apart along a ray, bilinear."""
    rows, columns = heights.shape
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    z, out = heights.astype(float), np.zeros(heights.shape)
    for metres in np.arange(0.5, math.hypot(rows * step_y, columns * step_x) / step_x, 0.5) * step_x:
        u, v = x + azimuth[0] * metres / step_x, y + azimuth[1] * metres / step_y
        inside = (u >= 0) & (u <= columns - 1) & (v >= 0) & (v <= rows - 1)
        rise = (bilinear(z, u, v) - z) / metres
        out = np.where(inside, np.maximum(out, rise), out)
    return out


def towards(degrees):
    return math.sin(math.radians(degrees)), math.cos(math.radians(degrees))


def reference(heights, step_x, step_y, v):
    """Return the depth of snow before slides by the formulas of kernels/land/snow.py, float64."""
    sky = sum(1 / (1 + horizons(heights, step_x, step_y, towards(33.75 + 45 * k)) ** 2) for k in range(8)) / 8
    sine = {}
    for turn in (0, 180):
        found = [horizons(heights, step_x, step_y, towards(v["wind"] + turn + gust)) for gust in (-20, 0, 20)]
        sine[turn] = sum(np.sin(np.arctan(h)) for h in found) / 3
    lee = 2.5 * (sine[0] - sine[180])
    north, east = np.gradient(heights.astype(float), step_y, step_x)
    elevation = math.pi / 2 - math.radians(v["latitude"])
    facing = north * math.cos(elevation) + math.sin(elevation)
    sun = np.clip(facing / np.sqrt(1 + north**2 + east**2), 0, 1)
    warm = (v["line"] - heights) * 0.0065 + v["aspect"] * (sun - math.sin(elevation))
    cold = np.maximum(1 / (1 + np.exp(warm / 0.8)) - 0.02, 0) / 0.98
    return v["fall"] * cold * (0.4 + 0.6 * sky) * np.clip(1 + 0.8 * lee / np.sqrt(1 + lee * lee), 0.1, 2.0)


@pytest.mark.parametrize("wind", [225.0, 70.0])
def test_the_depth_of_snow_follows_the_formulas(wind):
    heights, steps, values = smooth_hills(60, 45), (20.0, 26.0), VALUES | {"wind": wind}
    layers = snow.SNOW.apply(OperatorGround(heights, *steps, whole=heights.shape), values, None).layers
    fallen = layers["snow"] - layers["slides"]
    expected = reference(heights, *steps, values)
    off = abs(fallen - expected)[2:-2, 2:-2]  # at the rim horizons are those of one line alone
    assert expected.max() > 1.5 and expected.min() < 0.2
    assert np.sqrt((off**2).mean()) < 0.02 and off.max() < 0.15  # between lines horizons are interpolated


def test_snow_is_deeper_in_shade_in_both_hemispheres():
    y = np.abs(np.arange(61) - 30.0)
    ridge = np.tile((500.0 - 8.0 * y)[:, None], (1, 50)).astype(np.float32)
    for latitude, north_is_deeper in ((46.0, True), (-46.0, False)):
        values = VALUES | {"latitude": latitude, "line": 400.0, "wind": 90.0}
        found = snow.SNOW.apply(OperatorGround(ridge, 20.0, 20.0, whole=ridge.shape), values, None).layers["snow"]
        assert (found[45, 25] > 1.2 * found[15, 25]) == north_is_deeper
        assert (found[15, 25] > 1.2 * found[45, 25]) != north_is_deeper


def test_the_lee_holds_more_than_the_windward_side():
    x = np.abs(np.arange(61) - 30.0)
    ridge = np.tile(500.0 - 8.0 * x, (50, 1)).astype(np.float32)
    found = snow.SNOW.apply(
        OperatorGround(ridge, 20.0, 20.0, whole=ridge.shape), VALUES | {"wind": 270.0}, None
    ).layers["snow"]
    assert found[25, 40] > 1.3 * found[25, 20]


def test_loose_snow_rests_at_its_angle_and_cliffs_are_bare():
    heights = np.full((60, 70), 1500.0, np.float32)
    heights[20:40, 25:45] += 300.0
    layers = apply_by_levels(snow.SNOW, OperatorGround(heights, 10.0, 10.0), VALUES).layers
    found = layers["snow"]
    assert (layers["slides"] > 0.5).any()
    surface = heights + found
    for axis, step in ((0, 10.0), (1, 10.0)):
        drop, upper = np.diff(surface, axis=axis), None
        upper = np.where(drop > 0, np.take(found, range(1, found.shape[axis]), axis), np.delete(found, -1, axis))
        loose = upper > 0.36
        assert abs(drop)[loose].max() < 1.1 * step * math.tan(math.radians(42.0))
    steep = np.hypot(*np.gradient(heights, 10.0)) > 2.2
    assert found[steep & (heights > 1700)].max() < 1e-6  # the edge of the tower has shed all


def test_no_snow_on_water_in_holes_or_where_the_mask_is_0():
    heights = smooth_hills(61, 53)
    missing, mask, depth = np.zeros(heights.shape, bool), np.ones(heights.shape, np.float32), np.zeros(heights.shape)
    missing[5:9, 7:20], mask[30:, :20], depth[20:25, 30:50] = True, 0.0, 1.0
    ground = OperatorGround(heights, 40.0, 40.0, missing=missing, mask=mask, layers={"water_depth": np.float32(depth)})
    change = apply_by_levels(snow.SNOW, ground, VALUES | {"line": 0.0, "slides": 60.0})
    for nothing in (missing, mask == 0.0, depth > 0.0):
        assert not change.heights[nothing].any() and not change.layers["snow"][nothing].any()
    rest = ~missing & (mask > 0.0) & (depth == 0.0)
    assert change.layers["snow"][rest].min() > 0.3


def test_no_snow_in_a_hole_at_any_level():
    """Snow that slid to the border of the hole at the coarser level is not interpolated into it."""
    heights = 4.0 * smooth_hills(270, 261)
    missing = np.zeros(heights.shape, bool)
    missing[60:101, 131:180] = missing[200, 77] = True
    layers = apply_by_levels(
        snow.SNOW, OperatorGround(heights, 10.0, 10.0, missing=missing), VALUES | {"line": 0.0}
    ).layers
    assert (layers["slides"] > 0.5).any()
    assert not layers["snow"][missing].any() and not layers["slides"][missing].any()
    slid = layers["slides"].astype(np.float64)
    assert abs(slid.sum()) < 1e-7 * abs(slid).sum()


@pytest.mark.parametrize("shape", [(60, 80), (290, 270)])
def test_no_snow_slides_over_a_hole(shape):
    """No snow crosses a wall of holes from south to north, with one level and with two."""
    heights = 4.0 * smooth_hills(*shape[::-1]) + np.float32(5.0) * np.arange(shape[1], dtype=np.float32)[::-1]
    missing = np.zeros(shape, bool)
    missing[:, 30:33] = True
    slides = apply_by_levels(snow.SNOW, OperatorGround(heights, 10.0, 10.0, missing=missing), VALUES).layers["slides"]
    for side in (slides[:, :30].astype(np.float64), slides[:, 33:].astype(np.float64)):
        assert abs(side).max() > 0.3 and abs(side.sum()) < (1e-7 if shape == (60, 80) else 5e-3) * abs(side).sum()


def test_snow_as_a_layer_only_leaves_the_heights():
    ground = OperatorGround(smooth_hills(40, 40), 20.0, 20.0, whole=(40, 40))
    flat, raised = (snow.SNOW.apply(ground, VALUES | {"thickness": t}, None) for t in (0.0, 1.0))
    assert not flat.heights.any() and np.array_equal(flat.layers["snow"], raised.layers["snow"])
    assert np.array_equal(raised.heights, raised.layers["snow"])


def window(ground, coarser, rows, columns):
    """Return a tile and its coarser change."""
    part = rows, columns
    layers = {name: np.ascontiguousarray(a[part]) for name, a in coarser.layers.items()}
    tile = OperatorGround(
        np.ascontiguousarray(ground.heights[part]),
        ground.step_x,
        ground.step_y,
        first=(rows.start, columns.start),
        whole=ground.heights.shape,
    )
    return tile, Change(np.ascontiguousarray(coarser.heights[part]), layers)


@pytest.mark.parametrize("first", [(100, 60), (101, 63)])
def test_a_tile_with_its_halo_is_nearly_the_whole(first):
    """The difference is below 5 % of the finest level's change, rms."""
    heights, step = 2.0 * smooth_hills(321, 300) + hills(321, 300) / 10, 8.0
    ground = OperatorGround(heights, step, step, whole=heights.shape)
    coarse = apply_by_levels(
        snow.SNOW, OperatorGround(levels.coarser(heights), 2 * step, 2 * step), VALUES | {"line": 1000.0}
    )
    up = levels.interpolate_change(coarse, heights.shape)
    values = VALUES | {"line": 1000.0}
    whole = snow.SNOW.apply(ground, values, up).layers["snow"]
    halo, side = math.ceil(snow.SNOW.halo(values, step) / step), 64
    rows, columns = (slice(f - halo, f + side + halo) for f in first)
    tile_ground, tile_change = window(ground, up, rows, columns)
    tile = snow.SNOW.apply(tile_ground, values, tile_change).layers["snow"]
    inner = slice(halo, halo + side)
    place = slice(first[0], first[0] + side), slice(first[1], first[1] + side)
    moved = np.sqrt(((whole - up.layers["snow"])[place] ** 2).mean())
    off = np.sqrt(((tile[inner, inner] - whole[place]) ** 2).mean())
    assert off < 0.05 * moved


@pytest.mark.parametrize("first", [(0, 0), (37, 90)])
def test_what_fills_a_hole_shelters_no_snow(first):
    """A tower in a hole, whose fill no mesh shows, changes no depth two samples away from the hole."""
    y, x = np.mgrid[:70, :90].astype(np.float32)
    heights = 1500.0 + 30.0 * np.sin(x / 9.0) * np.cos(y / 7.0)
    missing = np.hypot(x - 40, y - 33) < 12
    near = np.hypot(x - 40, y - 33) < 15
    depths = {}
    for height, holes in itertools.product((0.0, 900.0), (missing, None)):
        land = np.where(missing, heights + np.float32(height), heights)
        ground = OperatorGround(land, 20.0, 30.0, first=first, missing=holes, whole=(200, 200))
        depths[height, holes is None] = snow.SNOW.apply(ground, VALUES | {"wind": 200.0}, None).layers["snow"][~near]
    assert np.array_equal(depths[0.0, False], depths[900.0, False])
    assert abs(depths[0.0, True] - depths[900.0, True]).max() > 0.05
