# SPDX-License-Identifier: GPL-3.0-or-later
"""Seas and lakes that a height map stores as level ground: an assumed depth for materials, and few triangles."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.height_operators.water_surface import default_sea, water_of
from cut_surfaces import areas, assert_welded

STEP = 15.0


def water_on(heights, sea=None):
    """Return a field's water with the default sea, or one of this level in metres."""
    field = from_array(np.asarray(heights, np.float32), STEP, STEP)
    return water_of(field, sea=default_sea(field) if sea is None else sea)


def depth_of(surface):
    return surface.attributes["water_depth"].array.astype(np.float64)


def coast(rows, columns, shore):
    """Return a sea stored as 0 m up to the column `shore`, and then a beach of 1 : 10."""
    return np.tile(np.maximum(np.arange(columns) - shore, 0) * STEP / 10.0, (rows, 1))


def test_the_sea_gets_deeper_with_the_distance_from_the_shore():
    """It is 1 m deeper each 10 m, up to 20 m, at every vertex, and within a tenth in triangles."""
    surface = water_on(coast(200, 180, 100))
    assert_welded(surface)
    shore = (100 - 179 / 2) * STEP
    assert abs(surface.positions[:, 2] - 0.1).max() < 1e-6, "the surface is level"

    def expected(x):
        return 0.1 + np.clip((shore - x) / 10.0, 0.0, 20.0)

    x, depth = surface.positions[:, 0].astype(np.float64), depth_of(surface)
    sea = x <= shore
    assert abs(depth - expected(x))[sea].max() < 1e-3 and depth[~sea].max() < 0.1
    middle, mean = x[surface.triangles].mean(axis=1), depth[surface.triangles].mean(axis=1)
    assert (abs(mean - expected(middle)) < 0.1 + 0.1 * expected(middle)).all()
    assert 20.0 < depth.max() < 20.2


def test_a_level_sea_has_few_triangles_and_no_gap():
    heights = coast(311, 260, 150)
    heights[100:140, 30:70] = np.maximum(0.0, 30.0 - np.hypot(*np.mgrid[-20:20, -20:20] * 3.0))  # an island
    surface = water_on(heights)
    border = assert_welded(surface)
    cells = (heights < 0.1)[1:, 1:].sum()
    assert len(surface.triangles) < 0.15 * 2 * cells
    extent = surface.positions[:, :2].max(axis=0) - surface.positions[:, :2].min(axis=0)
    assert extent == pytest.approx([(150 + 0.1 / 1.5) * STEP, 310 * STEP], rel=1e-4)
    island = np.pi * (10.0 * STEP - 0.1 / 3.0 * STEP) ** 2
    assert areas(surface).sum() == pytest.approx(extent.prod() - island, rel=2e-3)
    assert len(border) < 0.1 * cells


@pytest.mark.parametrize("shape", [(65, 65), (64, 129), (66, 200), (9, 300), (5, 5)])
def test_rasters_of_any_size_are_covered(shape):
    surface = water_on(np.zeros(shape))
    assert_welded(surface)
    assert areas(surface).sum() == pytest.approx((shape[0] - 1) * (shape[1] - 1) * STEP**2)
    assert abs(depth_of(surface) - 20.1).max() < 1e-3, "without a shore in sight it is deep everywhere"


def test_a_level_lake_is_deep_in_its_middle():
    """A lake of 300 m with an outlet, stored as level ground, is 15 m deep there; its shore is shallow."""
    y, x = np.mgrid[:90, :90]
    away = np.hypot(x - 45, y - 45) * STEP
    heights = np.where(away <= 150.0, 500.0, 500.3 + (away - 150.0) / 4.0)
    outlet = (x == 45) & (y < 45) & (away > 150.0)
    heights[outlet] = 500.0 - (away[outlet] - 150.0) / 50.0
    surface = water_on(heights, sea=-100.0)
    assert_welded(surface)
    at = np.hypot(*(surface.positions[:, :2].astype(np.float64) - STEP / 2).T)
    depth, lake = depth_of(surface), at < 170.0
    assert 500.0 < surface.positions[at < 125.0, 2].min() and surface.positions[at < 125.0, 2].max() < 500.5
    assert 13.0 < depth[lake].max() < 15.6 and at[depth.argmax()] < 2 * STEP
    assert depth[at > 145.0].max() < 1.5


def test_a_floor_with_heights_keeps_its_depth():
    """A sloping floor and deep level ground are no surfaces of water."""
    slope = np.tile(np.linspace(-9.0, 3.0, 80), (70, 1))
    assert depth_of(water_on(slope)).max() == pytest.approx(9.0)
    terrace = np.where(np.arange(80) < 40, -5.0, 3.0) + np.zeros((70, 1))
    surface = water_on(terrace)
    assert depth_of(surface).max() == pytest.approx(5.0) and len(surface.triangles) >= 2 * 39 * 69


def test_a_floor_in_whole_metres_keeps_its_depth():
    """Its steps are level. So is the surface of a lake at another height."""
    heights = np.tile(np.rint(np.linspace(-6.0, 6.0, 160)), (70, 1))
    heights[20:50, 110:150] = 3.0
    heights[21:49, 111:149] = 2.0
    depth = depth_of(surface := water_on(heights, sea=0.1))
    sea = abs(surface.positions[:, 2] - 0.1) < 1e-3
    lake = surface.positions[:, 2] > 1.9
    assert set(np.rint(depth[sea & (depth > 0.2)] - 0.1)) == {1.0, 2.0, 3.0, 4.0, 5.0, 6.0}
    assert depth[sea].max() < 6.2 and depth[lake].max() > 9.0


def test_a_hole_is_no_shore():
    heights = coast(60, 80, 70)
    field = from_array(np.asarray(heights, np.float32), STEP, STEP)
    valid = np.ones(heights.shape, np.uint8)
    valid[20:40, 10:25] = 0
    surface = water_of(field.with_raster(valid=valid), sea=0.1)
    assert_welded(surface)
    x, y = (surface.positions[:, :2].astype(np.float64) / STEP + [79 / 2, 59 / 2]).T
    assert not ((x > 10) & (x < 24) & (y > 20) & (y < 39)).any()
    beside = abs(x - 25.0) < 1e-3
    assert beside.any() and depth_of(surface)[beside] == pytest.approx(20.1 * np.ones(beside.sum()), rel=1e-3)
