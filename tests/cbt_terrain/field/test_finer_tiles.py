# SPDX-License-Identifier: GPL-3.0-or-later
"""Finer tiles beside a dense grid of the same surface: heights, bounds, cracks, rays, and what they cannot do."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.cell_ranges import rectangle_ranges
from adaptive_terrain.cbt_terrain.field.finer_build import with_finer_tiles
from adaptive_terrain.cbt_terrain.field.finer_tiles import SIDE
from adaptive_terrain.cbt_terrain.query.box import box_range
from adaptive_terrain.cbt_terrain.query.ground import ground_at, profile
from adaptive_terrain.cbt_terrain.query.rays import pick
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import reference_heights
from finer_fields import dense_field, dense_heights, dense_raster, finer_field
from finer_views import (
    assert_an_anchor_moves_the_surface_alone,
    assert_bound_in_metres,
    assert_bounds_in_random_views,
    assert_no_cracks,
    places_on,
)


@pytest.fixture(scope="module")
def field():
    return finer_field()


@pytest.fixture(scope="module")
def dense(field):
    return dense_field(field)


def test_heights_are_those_of_a_dense_grid(field, dense):
    places = places_on(field, 4000, 1)
    ground, expected = ground_at(field, places), ground_at(dense, places)
    assert np.abs(ground.heights - expected.heights).max() < 2e-5
    known = np.abs(reference_heights(field, places) - expected.heights) > 0.1
    assert known.sum() > 300
    inner = known & (np.abs(expected.normals[:, 2]) < 2)
    assert np.degrees(np.arccos(np.clip((ground.normals * expected.normals).sum(axis=1), -1, 1)))[inner].max() < 0.5


@pytest.mark.thorough
@pytest.mark.parametrize("meshlet", [0, 2])
def test_bounds_hold_in_random_views(field, dense, meshlet):
    finest = assert_bounds_in_random_views(field, dense, places_on(field, 6000, 2), 5 + meshlet, meshlet)
    assert finest > field.lattice.cell_depth + 2 * field.raster.finer.bits


def test_bound_in_metres_holds_over_the_whole_mesh(field, dense):
    assert_bound_in_metres(field, dense, places_on(field, 20_000, 3), (3.0, 1.0))


def test_edges_and_areas_have_no_cracks(field):
    at = np.array(field.lattice.rectangle()[:2]) + SIDE * 2.0 * np.array([2.6, 3.4])
    assert_no_cracks(field, at)


def test_triangles_are_not_many_more_than_of_a_dense_grid(field, dense):
    at = np.array(field.lattice.rectangle()[:2]) + SIDE * 2.0 * np.array([2.6, 3.4])
    view = View.look((*at, 160.0), (*(at + 400), 60.0))
    counts = [Terrain(f).update(Criterion(error_px=1.0), [view]).triangles for f in (field, dense)]
    assert counts[1] < counts[0] < 1.2 * counts[1]


def test_rays_and_boxes_agree_with_a_dense_grid(field, dense):
    rng = np.random.default_rng(4)
    places = places_on(field, 1500, 4)
    origins = np.c_[places, np.full(len(places), field.max_height + 20.0)]
    targets = np.c_[places[rng.permutation(len(places))], rng.uniform(-50, 0, len(places))]
    ways = [pick(f, origins, targets - origins).distance for f in (field, dense)]
    assert np.array_equal(np.isfinite(ways[0]), np.isfinite(ways[1])) and np.isfinite(ways[0]).mean() > 0.5
    assert np.nanquantile(np.abs(ways[0] - ways[1]), 0.99) < 1e-3
    for _ in range(20):
        low = places[rng.integers(len(places))]
        box = (*low, *(low + 10 ** rng.uniform(0, 2.5, 2)))
        assert np.allclose(box_range(field, *box), box_range(dense, *box), atol=2e-5, equal_nan=True)


def test_profiles_follow_the_finer_heights(field, dense):
    low = np.array(field.lattice.rectangle()[:2])
    line = low + SIDE * 2.0 * np.array([[1.3, 2.1], [3.9, 3.7]])
    found, expected = (profile(f, line) for f in (field, dense))
    assert len(found.along) == len(expected.along) > 500
    assert np.abs(found.heights - expected.heights).max() < 2e-5


def test_ranges_of_rectangles_enclose_the_finer_heights(field):
    heights, part = dense_heights(field), 16 << field.raster.finer.bits
    sides = [(16 * n, 16 * n + 16) for n in range(8)]
    ranges = rectangle_ranges(field, sides, sides[:6])
    for row, column in np.ndindex(6, 8):
        inside = heights[part * row : part * (row + 1) + 1, part * column : part * (column + 1) + 1]
        assert ranges[row, column, 0] <= inside.min() and inside.max() <= ranges[row, column, 1]


def test_frames_after_each_other_are_those_of_a_new_terrain(field):
    low = np.array(field.lattice.rectangle()[:2])
    kept = Terrain(field)
    for k in range(5):
        at = low + SIDE * 2.0 * (np.array([2.2, 2.8]) + 0.2 * k)
        view = View.look((*at, 140.0), (*(at + 300), 60.0))
        criterion = Criterion(error_px=1.0, morph=1.5 if k > 2 else 1.0)
        update, fresh = (terrain.update(criterion, [view]) for terrain in (kept, Terrain(field)))
        assert update.surface.positions.tobytes() == fresh.surface.positions.tobytes()
        assert np.array_equal(update.surface.corner_verts, fresh.surface.corner_verts)


def test_an_anchor_moves_the_surface_alone(field):
    assert_an_anchor_moves_the_surface_alone(field, places_on(field, 500, 6))


def test_ring_has_the_heights_of_the_raster(field):
    """A tile without known heights changes nothing but the strip beside a known tile."""
    change = dense_heights(field) - dense_raster(field, field.raster.finer.bits)
    tiles = field.raster.finer
    known = {(2, 3), (3, 3), (3, 2)}
    for row, column in np.argwhere(tiles.numbers >= 0):
        if (column, row) not in known:
            inner = change[SIDE * row + 1 : SIDE * (row + 1), SIDE * column + 1 : SIDE * (column + 1)]
            assert not inner.size or np.abs(inner).max() < 1e-5


@pytest.mark.thorough
def test_the_size_of_measured_squares_changes_no_byte():
    one, other = (finer_field(36, 41, 4, ((2, 2), (1, 2), (0, 1)), block=block).raster.finer for block in (3, 5))
    for name in ("heights", "errors", "ranges", "limits"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


def test_the_key_depends_on_the_tiles(field):
    other = finer_field(relief=6.5)
    plain = from_array(field.heights(), 32.0)
    assert len({str(f.key) for f in (field, other, plain)}) == 3


def test_what_finer_tiles_cannot_have_is_refused(field):
    plain = from_array(np.zeros((20, 20), np.float32), 10.0)
    for base, bits, known in (
        (interpolated(plain, "bicubic"), 2, [(0, 0)]),
        (field, 2, [(0, 0)]),
        (plain, 0, [(0, 0)]),
        (plain, 9, [(0, 0)]),
        (plain, 2, [(5, 0)]),
    ):
        with pytest.raises(TerrainError):
            with_finer_tiles(base, bits, known, lambda _box: np.zeros((1, 1), np.float32))
    with pytest.raises(TerrainError, match="shape"):
        with_finer_tiles(plain, 2, [(0, 0)], lambda _box: np.zeros((3, 3), np.float32))
