# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of water: welded, facing up, and ending at the shore."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.lattice import fit
from adaptive_terrain.cbt_terrain.height_operators.height_operator import OperatorGround
from adaptive_terrain.cbt_terrain.height_operators.water import WATER
from adaptive_terrain.cbt_terrain.height_operators.water_surface import default_sea, sea_depth, water_of, water_surface
from cut_surfaces import areas, assert_welded
from rasters import hills, imported

STEP_X, STEP_Y = 10.0, 7.0


def lattice(heights):
    return fit(heights.shape[1], heights.shape[0], STEP_X, STEP_Y)


def surface_on(heights, *layers, **more):
    return water_surface(lattice(heights), heights, *layers, **more)


def cone(rows, columns):
    """Return an island with slopes of 1 : 5 in a sea of 60 m."""
    y, x = np.mgrid[:rows, :columns].astype(float)
    far = np.hypot((x - columns // 2) * STEP_X, (y - rows // 2) * STEP_Y)
    return (20.0 - 0.2 * far).astype(np.float32)


def test_the_shore_is_where_the_ground_is_at_the_level():
    heights = cone(91, 80)
    surface = surface_on(heights, sea_depth(heights, 0.25))
    border = assert_welded(surface)
    assert abs(surface.positions[:, 2] - 0.25).max() < 1e-5 and surface.normals[:, 2].min() > 1 - 1e-9
    west, south, east, north = lattice(heights).rectangle()
    at = surface.positions[np.unique(border)].astype(np.float64)
    shore = at[(abs(at[:, 0]) < east - 1) & (abs(at[:, 1]) < north - 1)]
    middle = west + 40 * STEP_X, south + 45 * STEP_Y
    radius = np.hypot(shore[:, 0] - middle[0], shore[:, 1] - middle[1])
    assert abs(radius - 98.75).max() < 0.6  # of a circle between samples of 10 m
    sea = (east - west) * (north - south) - math.pi * 98.75**2
    assert areas(surface).sum() == pytest.approx(sea, rel=1e-3)
    assert surface.attributes["water_depth"].array.min() == 0.0
    depth = surface.attributes["water_depth"].array
    assert depth.max() == pytest.approx(0.25 - heights.min(), rel=1e-6)
    assert (depth[np.unique(border)][(abs(at[:, 0]) < east - 1) & (abs(at[:, 1]) < north - 1)] < 5e-3).all()


def test_border_vertices_are_on_the_ground():
    """On hills with lakes and rivers they are on the ground's triangles, along the cells' edges."""
    heights = hills(120, 95)
    ground = OperatorGround(heights, STEP_X, STEP_Y, whole=heights.shape)
    layers = WATER.apply(ground, WATER.defaults() | {"rain": 3.0}, None).layers
    surface = surface_on(heights, layers["water_depth"], layers["water_speed"])
    border = np.unique(assert_welded(surface))
    west, south, east, north = lattice(heights).rectangle()
    at = surface.positions[border].astype(np.float64)
    inner = (at[:, 0] > west) & (at[:, 0] < east) & (at[:, 1] > south) & (at[:, 1] < north)
    x, y = (at[inner, 0] - west) / STEP_X, (at[inner, 1] - south) / STEP_Y
    i, j = np.minimum(x.astype(int), 118), np.minimum(y.astype(int), 93)
    u, v = x - i, y - j
    z = heights.astype(float)
    corners = z[j, i], z[j, i + 1], z[j + 1, i], z[j + 1, i + 1]
    rising = np.where(u > v, corners[0] + u * (corners[1] - corners[0]) + v * (corners[3] - corners[1]), 0)
    rising = np.where(u > v, rising, corners[0] + v * (corners[2] - corners[0]) + u * (corners[3] - corners[2]))
    falling = corners[0] + u * (corners[1] - corners[0]) + v * (corners[2] - corners[0])
    beyond = corners[3] + (1 - u) * (corners[2] - corners[3]) + (1 - v) * (corners[1] - corners[3])
    falling = np.where(u + v < 1, falling, beyond)
    off = np.minimum(abs(at[inner, 2] - rising), abs(at[inner, 2] - falling))
    assert inner.sum() > 1000 and off.max() < 0.05
    assert surface.attributes["water_speed"].array.max() > 0.1


def test_a_stream_across_the_cells_is_one_piece():
    """A stream of one sample along a diagonal gives triangles that edges connect."""
    heights = np.add.outer(np.arange(30.0), np.zeros(30)).astype(np.float32)
    heights += 3.0 * abs(np.subtract.outer(np.arange(30), np.arange(30))).astype(np.float32)
    for flipped in (heights, heights[:, ::-1].copy()):
        depth = np.where(flipped == np.minimum.reduce(flipped, axis=1)[:, None], np.float32(0.3), np.float32(0.0))
        surface = surface_on(flipped, depth)
        assert_welded(surface)
        piece = np.arange(len(surface.positions))
        for _ in range(len(piece)):
            a, b = surface.edges.T
            least = np.minimum(piece[a], piece[b])
            before = piece.copy()
            np.minimum.at(piece, a, least)
            np.minimum.at(piece, b, least)
            if np.array_equal(before, piece):
                break
        assert (piece == 0).all()


def test_streams_go_on_where_they_are_fast_and_shallow():
    heights = np.tile(np.arange(24.0, 0.0, -1.0, dtype=np.float32), (9, 1))
    depth, discharge = np.zeros((2, 9, 24), np.float32)
    depth[4], discharge[4] = 0.1, 0.03
    depth[4, 10:14] = 0.02
    parts = [surface_on(heights, depth, discharge=q) for q in (None, discharge)]
    assert [np.ptp(p.positions[:, 0]) > 150.0 for p in parts] == [True, True]
    middle = [(abs(p.positions[:, 0]) < 5.0).any() for p in parts]
    assert middle == [False, True]


def wet_samples(surface, heights):
    """Return at which samples a surface has a vertex with water below it, bool."""
    west, south, _, _ = lattice(heights).rectangle()
    deep = surface.positions[surface.attributes["water_depth"].array > 0.0]
    found = np.zeros(heights.shape, bool)
    found[tuple(np.rint((deep[:, 1::-1] - [south, west]) / [STEP_Y, STEP_X]).astype(int).T)] = True
    return found


def piece_at(wet, row, column):
    """Return the samples that a wet sample is connected with, over sides and corners of cells."""
    piece, found = [(row, column)], {(row, column)}
    while piece:
        y, x = piece.pop()
        for at in np.argwhere(wet[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]) + [max(y - 1, 0), max(x - 1, 0)]:
            if tuple(at) not in found:
                found.add(tuple(at))
                piece.append(tuple(at))
    return found


@pytest.mark.parametrize("share", [0.1, 0.25, 0.35])
def test_pieces_of_fewer_than_nine_samples_are_not_shown(share):
    wet = np.random.default_rng(int(100 * share)).random((61, 43)) < share
    wet[50, 2:40] = True  # a long stream, whose samples have far more than nine steps between them
    heights = np.where(wet, np.float32(4.0), np.float32(5.0))
    found = wet_samples(surface_on(heights, np.where(wet, np.float32(0.5), np.float32(0.0))), heights)
    large = np.zeros_like(wet)
    for row, column in np.argwhere(wet):
        large[row, column] = len(piece_at(wet, row, column)) >= 9
    assert np.array_equal(found, large) and large.sum() < wet.sum()


def test_pits_of_noise_on_a_slope_show_no_lakes():
    """A slope of 1 : 20 with noise of 2 m has pits everywhere, and a lake in its one hollow."""
    heights = np.tile(50.0 - 0.5 * np.arange(90.0), (80, 1)) + np.random.default_rng(3).normal(0.0, 2.0, (80, 90))
    heights[30:42, 40:54] -= 20.0
    heights = np.round(heights).astype(np.float32)
    surface = water_of(from_array(heights, STEP_X, STEP_Y), sea=-100.0)
    wet = wet_samples(surface, heights)
    lake = np.zeros_like(wet)
    lake[30:42, 40:54] = True
    inner = heights[1:-1, 1:-1]
    around = [heights[1 + j : 79 + j, 1 + i : 89 + i] for j in (-1, 0, 1) for i in (-1, 0, 1) if i or j]
    pits = (inner < np.minimum.reduce(around)) & ~lake[1:-1, 1:-1]
    assert pits.sum() > 300 and (wet[1:-1, 1:-1] & pits).sum() < 0.05 * pits.sum()
    assert wet[lake].all()
    level = surface.positions[:, 2]
    assert (abs(level - np.median(level)) < 0.05).sum() > lake.sum()


def test_shallow_water_that_is_no_stream_shows_where_it_stands():
    slope = np.tile(np.arange(20.0, 0.0, -1.0, dtype=np.float32), (9, 1))
    depth, discharge = np.full((9, 20), np.float32(0.06)), np.full((9, 20), np.float32(0.01))
    assert not len(surface_on(slope, depth, discharge=discharge).triangles)
    for shown in (
        surface_on(0.0 * slope, depth, discharge=discharge),
        surface_on(slope, depth, discharge=2 * discharge),
    ):
        assert areas(shown).sum() >= 19 * STEP_X * 8 * STEP_Y * (1 - 1e-6)


def test_a_canal_of_one_sample_shows_the_water_of_the_sea():
    heights = np.full((30, 40), np.float32(3.0))
    heights[:, :8] = heights[15, 8:30] = -4.0
    heights[15, 30:33], heights[12:15, 32] = -1.0, -1.0
    depth, no_stream = sea_depth(heights, 0.0), np.full(heights.shape, np.float32(1e-4))
    assert np.array_equal(wet_samples(surface_on(heights, depth, discharge=no_stream), heights), heights < 0.0)


def test_no_triangle_touches_a_hole_and_nothing_is_empty():
    heights = cone(40, 40)
    missing = np.zeros(heights.shape, bool)
    missing[3:6, 4:9] = True
    surface = surface_on(heights, sea_depth(heights, 0.0), missing=missing)
    assert_welded(surface)
    west, south, _, _ = lattice(heights).rectangle()
    middle = surface.positions[surface.triangles].mean(axis=1)
    x, y = (middle[:, 0] - west) / STEP_X, (middle[:, 1] - south) / STEP_Y
    assert not ((x > 3) & (x < 9) & (y > 2) & (y < 6)).any()
    empty = surface_on(heights, np.zeros_like(heights))
    assert len(empty.positions) == len(empty.triangles) == len(empty.edges) == 0


@pytest.mark.parametrize("side", [300, 1400])
def test_a_large_field_is_thinned_from_its_south_western_corner(side):
    heights = cone(side // 4, side)
    found = water_of(from_array(heights, 3.0, 4.0).with_raster(layers={"water_depth": sea_depth(heights, 0.0)}))
    west = (side - 1) * 1.5
    assert_welded(found)
    assert found.positions[:, 0].min() == -west and west - 3.0 <= found.positions[:, 0].max() <= west
    assert abs(found.positions[:, 2]).max() < 1e-4 and found.attributes["water_depth"].array.max() > 10.0


def test_a_field_without_water_layers_gets_default_water():
    """There is a sea at 0 m and a full hollow on the cone's flank."""
    heights = cone(60, 50)
    row, column = np.argwhere((heights > 15.0) & (heights < 20.0))[0]
    heights[row - 1 : row + 2, column - 1 : column + 2] = 5.0
    found = water_of(from_array(heights, STEP_X, STEP_Y))
    assert_welded(found)
    z, deep = found.positions[:, 2], found.attributes["water_depth"].array
    sea = abs(z) < 1e-4
    assert sea.sum() > 100 and deep[sea].max() == pytest.approx(-heights.min(), rel=1e-5)
    lake = deep[~sea].argmax()
    assert 5.0 < z[~sea][lake] < 20.0 and z[~sea][lake] - deep[~sea][lake] == pytest.approx(5.0, abs=1e-3)


def test_the_water_of_a_field_comes_from_its_layers():
    heights = cone(60, 50)
    depth = np.where(heights < -10.0, np.float32(-10.0) - heights, np.float32(0.0))
    found = water_of(from_array(heights, STEP_X, STEP_Y).with_raster(layers={"water_depth": depth}))
    assert abs(found.positions[:, 2] + 10.0).max() < 1e-4


def test_inland_the_lowest_ground_is_under_water():
    """A coast has its sea at 0 m; a valley of 500 to 990 m gets a lake on a twentieth of its ground."""
    rows = np.linspace(500.0, 990.0, 99, dtype=np.float32)
    valley = from_array(np.tile(rows, (80, 1)), step_x=STEP_X, step_y=STEP_Y)
    level = default_sea(valley)
    assert level == pytest.approx(524.5, abs=5.0)
    surface = water_of(valley, sea=level)
    flat = np.abs(surface.positions[:, 2] - level) < 1e-3
    share = (level - 500.0) / 490.0
    west, south, east, north = valley.lattice.rectangle()
    lake = surface.positions[flat]
    assert np.ptp(lake[:, 0]) == pytest.approx(share * (east - west), rel=0.05)
    assert np.ptp(lake[:, 1]) == pytest.approx(north - south)
    assert default_sea(from_array(np.tile(rows - 600.0, (80, 1)), step_x=STEP_X, step_y=STEP_Y)) == 0.0


def test_a_lowest_lake_stored_as_level_gets_water():
    """A lake that covers a tenth of a valley, at its lowest, is dry at its own level."""
    rows = np.maximum(np.linspace(400.0, 900.0, 101, dtype=np.float32), 450.0)
    valley = from_array(np.tile(rows, (80, 1)), step_x=STEP_X, step_y=STEP_Y)
    level = default_sea(valley)
    assert 450.05 < level < 451.0
    surface = water_of(valley, sea=level)
    lake = surface.positions[np.abs(surface.positions[:, 2] - level) < 1e-3]
    west, _, east, _ = valley.lattice.rectangle()
    assert np.ptp(lake[:, 0]) == pytest.approx(0.1 * (east - west), rel=0.1)


def test_the_default_sea_of_a_raster_with_holes_is_of_its_ground(tmp_path):
    """The samples that fill holes do not count; neither do bands of rows, nor the store's 16-bit numbers."""
    heights = np.random.default_rng(8).integers(500, 900, (700, 60)).astype(np.int16)
    heights[10:400, 5:50] = -1
    np.save(tmp_path / "a.npy", heights)
    field, _ = imported(tmp_path, tmp_path / "a.npy", no_data=-1.0, holes=True)
    assert field.steps is not None
    assert default_sea(field) == pytest.approx(np.quantile(heights[heights >= 0].astype(float), 0.05), abs=1e-3)


def test_a_sea_stored_as_exactly_0_gets_water():
    """Many elevation models store the sea as 0, where water of a level of 0 m has no depth."""
    rows = np.maximum(np.linspace(-100.0, 300.0, 81, dtype=np.float32), 0.0)
    coast = from_array(np.tile(rows, (80, 1)), step_x=STEP_X, step_y=STEP_Y)
    level = default_sea(coast)
    assert 0.0 < level < 0.5
    west, _, east, _ = coast.lattice.rectangle()
    surface = water_of(coast, sea=level)
    sea = surface.positions[np.abs(surface.positions[:, 2] - level) < 1e-3]
    assert np.ptp(sea[:, 0]) == pytest.approx(0.25 * (east - west), rel=0.05)
    assert len(water_of(coast, sea=0.0).triangles) < len(surface.triangles)
