# SPDX-License-Identifier: GPL-3.0-or-later
"""Rays against the surface, beside walks through every cell in numpy."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain import ground_at, nearest, pick
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.heightfield import with_detail
from fields import extent, reference_heights
from query_fields import ROUGH, STEP, SURFACES, with_holes
from sight_lines import first_contact, pieces

DOWN, UP = (0.0, 0.0, -1.0), (0.0, 0.0, 1.0)


def random_rays(field, count, seed=0):
    """Return rays from above, below, beside and among the ground, also along lines of samples and through samples."""
    rng, size = np.random.default_rng(seed), extent(field)
    origins = rng.uniform(-1, 1, (count, 3)) * size * (0.7, 0.7, 1.5)
    directions = rng.uniform(-0.7, 0.7, (count, 3)) * size - origins
    aligned = count // 4
    corner = np.array(field.lattice.rectangle()[:2])
    origins[:aligned, :2] = corner + np.rint((origins[:aligned, :2] - corner) / STEP) * STEP
    ways = np.array([(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (2, -1), (0, 0)])
    directions[:aligned, :2] = 200 * ways[rng.integers(len(ways), size=aligned)]
    return origins, directions


@pytest.mark.parametrize("name", ["bilinear", "numbers", "holes"])
@pytest.mark.parametrize("heights", [(1.0, 0.0), (-1.5, 20.0)])
def test_hits_are_the_first_roots_of_all_cells(name, heights):
    field = with_holes() if name == "holes" else SURFACES[name]
    origins, directions = random_rays(field, 80)
    found = pick(field, origins, directions, *heights)
    units = directions / np.linalg.norm(directions, axis=1)[:, None]
    truth = [first_contact(field, *ray, *heights) for ray in zip(origins, units, strict=True)]
    hit = np.isfinite(truth)
    assert 0.3 < hit.mean() < 0.9 and np.array_equal(np.isfinite(found.distance), hit)
    assert np.abs(found.distance[hit] - np.array(truth)[hit]).max() < 1e-7
    below = ground_at(field, found.points[hit, :2], *heights)
    assert np.abs(found.points[hit, 2] - below.heights).max() < 1e-9
    assert np.isnan(found.points[~hit]).all()


@pytest.mark.parametrize("name", ["bicubic", "detail", "masked"])
def test_on_curved_surfaces_nothing_is_met_before_a_hit(name):
    field = SURFACES[name]
    origins, directions = random_rays(field, 60, seed=5)
    found = pick(field, origins, directions)
    units = directions / np.linalg.norm(directions, axis=1)[:, None]
    hit = np.isfinite(found.distance)
    assert 0.3 < hit.mean() < 0.9
    off = reference_heights(field, found.points[hit, :2]) - found.points[hit, 2]
    assert np.abs(off).max() < 1e-8
    for origin, unit, distance in zip(origins, units, found.distance, strict=True):
        t, e, _ = pieces(field, origin, unit, distance - 1e-6, places=17)
        assert (e > 0).all() or (e < 0).all()


def test_vertical_rays_meet_the_ground_below_and_above():
    for field in [*SURFACES.values(), with_holes()]:
        west, south, east, north = field.lattice.rectangle()
        places = np.random.default_rng(2).uniform((west, south), (east, north), (300, 2))
        places[:4] = (west, south), (east, north), (west, north), (0.0, 0.0)
        truth = ground_at(field, places)
        for height, way in ((1000.0, DOWN), (-1000.0, UP)):
            found = pick(field, np.c_[places, np.full(300, height)], np.tile(way, (300, 1)))
            assert np.array_equal(np.isfinite(found.distance), truth.inside)
            assert np.abs(found.points[:, 2] - truth.heights)[truth.inside].max() < 1e-9


def test_grazing_rays_hit_a_saddle_and_those_above_do_not():
    """Along its diagonal the cell 0 1 / 1 0 is an arch 1/2 m high."""
    heights = np.zeros((4, 4))
    heights[1, 2] = heights[2, 1] = 1.0
    field = from_array(heights)
    for surface, top in ((field, 0.5), (with_detail(field, Detail(1e-9)), 0.5), (interpolated(field, "bicubic"), None)):
        top = top or reference_heights(surface, np.zeros((1, 2)))[0]
        origins = np.tile([-1.5, -1.5, 0.0], (2, 1)) + [[0, 0, top - 1e-8], [0, 0, top + 1e-8]]
        found = pick(surface, origins, [[1, 1, 0], [1, 1, 0]])
        assert np.isinf(found.distance[1]) and np.abs(found.points[0, :2]).max() < 2e-4


def test_flat_ground_is_hit_from_both_sides_and_along_it():
    field = from_array(np.full((9, 14), 3.0), 2.0)
    rays = [((0, 0, 9), DOWN), ((0, 0, -9), UP), ((1, 1, 3), (1, 0, 0)), ((-50, 0.3, 3), (1, 0, 0)), ((0, 0, 9), UP)]
    found = pick(field, *np.array(rays, float).transpose(1, 0, 2))
    assert found.distance.tolist() == [6.0, 12.0, 0.0, 37.0, np.inf]
    assert pick(field, [[0, 0, 9]], [[0, 0, -2]], vertical_scale=0.0, vertical_offset=-1.0).distance[0] == 10.0


def test_rays_pass_through_holes():
    field = with_holes()
    (west, south, _, _), z = field.lattice.rectangle(), 400.0
    inside = np.array([west + 50 * STEP, south + 25 * STEP])  # in the middle of the large hole
    below = ground_at(with_detail(field, None), inside[None])
    assert not below.inside[0]
    slanted = np.array([inside[0] - 0.5 * z, inside[1], z])
    found = pick(field, [slanted, [*inside, z]], [[0.5, 0, -1], DOWN])
    assert np.isinf(found.distance).all()
    up = pick(field, [[*inside, -z]], [[0.4, 0, 1]])
    assert np.isfinite(up.distance[0]) and up.points[0, 0] > west + 60 * STEP


def test_nearest_looks_both_ways():
    places = np.random.default_rng(4).uniform(-200, 200, (50, 2))
    ground = ground_at(ROUGH, places).heights
    over = np.where(np.arange(50) % 2, 5.0, -7.0)
    found = nearest(ROUGH, np.c_[places, ground + over], np.tile(UP, (50, 1)))
    assert np.abs(found.distance + over).max() < 1e-9 and np.abs(found.points[:, 2] - ground).max() < 1e-9
    tilted = nearest(ROUGH, np.c_[places, ground + over], np.tile([3.0, 0, 1], (50, 1)))
    ways = [pick(ROUGH, np.c_[places, ground + over], np.tile([3.0 * s, 0, s], (50, 1))).distance for s in (1, -1)]
    assert np.array_equal(np.abs(tilted.distance), np.minimum(*ways)) and (tilted.distance < 0).any()


def test_distance_and_length_of_rays_do_not_change_hits():
    origins, directions = random_rays(ROUGH, 100, seed=8)
    near = pick(ROUGH, origins, directions)
    units = directions / np.linalg.norm(directions, axis=1)[:, None]
    above = np.isfinite(near.distance) & (origins[:, 2] > 200)
    far = pick(ROUGH, (origins - 1e5 * units)[above], 1e-200 * directions[above])
    assert above.sum() > 5 and np.abs(far.points - near.points[above]).max() < 1e-6
    assert np.array_equal(pick(ROUGH, origins, 2.0**600 * directions).distance, near.distance)


def test_any_number_of_threads_gives_the_same_bytes():
    origins, directions = random_rays(ROUGH, 3000)
    one, three = (pick(SURFACES["bicubic"], origins, directions, threads=n) for n in (1, 3))
    assert one.distance.tobytes() == three.distance.tobytes() and one.points.tobytes() == three.points.tobytes()


def test_small_and_narrow_rasters():
    for shape in ((2, 2), (2, 9), (3, 2), (5, 6)):
        field = from_array(np.random.default_rng(1).uniform(0, 3, shape), 1.0)
        origins, directions = random_rays(field, 60)
        units = directions / np.linalg.norm(directions, axis=1)[:, None]
        found = pick(field, origins, directions).distance
        truth = np.array([first_contact(field, *ray) for ray in zip(origins, units, strict=True)])
        assert np.array_equal(np.isfinite(found), np.isfinite(truth)) and np.isfinite(truth).any()
        assert np.abs(found[np.isfinite(truth)] - truth[np.isfinite(truth)]).max() < 1e-7


def test_rays_end_whatever_a_damaged_field_holds():
    rng, origins_directions = np.random.default_rng(0), random_rays(ROUGH, 500)
    noise = replace(ROUGH, ranges=rng.integers(0, 65536, ROUGH.ranges.shape).astype(np.uint16))
    lost = ROUGH.samples.copy()
    lost[::5, ::3], lost[::7, ::4] = np.nan, np.inf
    cubic = replace(SURFACES["bicubic"], error=SURFACES["bicubic"].error[::-1].copy())
    for field in (noise, ROUGH.with_raster(samples=lost), cubic.with_raster(samples=lost)):
        assert len(pick(field, *origins_directions).distance) == 500


@pytest.mark.parametrize(
    ("origins", "directions", "said"),
    [
        ([[0, 0, np.inf]], [DOWN], r"Number 0 of the origins of rays is \(0, 0, inf\)"),
        ([[0, 0, 1]], [[np.nan, 0, 0]], "Number 0 of the directions of rays"),
        ([[0, 0, 1], [0, 0, 2]], [DOWN, (0, 0, 0)], r"Number 1 of the directions of rays is \(0, 0, 0\)"),
        ([[0, 0, 1]], [DOWN, DOWN], "1 origins of rays and 2 directions"),
        ([[0, 0]], [DOWN], r"shape \(1, 2\); expected \[n, 3\] metres"),
    ],
)
def test_bad_rays_are_refused(origins, directions, said):
    with pytest.raises(TerrainError, match=said):
        pick(ROUGH, origins, directions)
    assert pick(ROUGH, [], []).points.shape == (0, 3)
