# SPDX-License-Identifier: GPL-3.0-or-later
"""The bicubic surface with finer tiles, against point-by-point code: heights, bounds, cracks, rays and boxes."""

from unittest import mock

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.bicubic import bicubic, interpolated
from adaptive_terrain.cbt_terrain.field.finer_tiles import SIDE
from adaptive_terrain.cbt_terrain.query.box import box_range
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.query.rays import pick
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import reference_heights
from finer_fields import finer_field
from finer_views import (
    assert_an_anchor_moves_the_surface_alone,
    assert_bound_in_metres,
    assert_bounds_in_random_views,
    assert_no_cracks,
    places_on,
)


@pytest.fixture(
    scope="module", params=[4, pytest.param(1, marks=pytest.mark.thorough)], ids=["2 m in 32 m", "16 m in 32 m"]
)
def field(request):
    if request.param == 4:
        return interpolated(finer_field(), "bicubic")
    return interpolated(finer_field(150, 290, 1, ((0, 0),), relief=20.0), "bicubic")


def test_heights_are_those_of_the_patches_and_the_differences(field):
    places = places_on(field, 4000, 1)
    assert np.abs(ground_at(field, places).heights - reference_heights(field, places)).max() < 3e-5


def test_finer_samples_keep_their_heights_inside_the_tiles(field):
    tiles, step = field.raster.finer, field.lattice.step_x / (1 << field.raster.finer.bits)
    column, row = min(tiles.known)
    inner = np.stack(np.meshgrid(*[np.arange(40, 217, 8)] * 2), -1).reshape(-1, 2)
    places = np.array(field.lattice.rectangle()[:2]) + (inner + SIDE * np.array([column, row])) * step
    stored = tiles.heights[tiles.numbers[row, column]][1 + inner[:, 1], 1 + inner[:, 0]]
    assert np.array_equal(ground_at(field, places).heights.astype(np.float32), stored)


@pytest.mark.thorough
@pytest.mark.parametrize("meshlet", [0, 2])
def test_bounds_hold_in_random_views(field, meshlet):
    finest = assert_bounds_in_random_views(field, field, places_on(field, 6000, 2), 5 + meshlet, meshlet)
    assert finest > field.lattice.cell_depth + 2 * field.raster.finer.bits


def test_bound_in_metres_holds_over_the_whole_mesh(field):
    assert_bound_in_metres(field, field, places_on(field, 20_000, 3), (8.0, 4.0))


def test_a_view_of_tiles_takes_few_more_triangles_than_bilinear():
    """Bounds of the raster's bicubic surface and of the differences would add up to 1.7 times as many."""
    plain = finer_field()
    x, y = np.array(plain.lattice.rectangle()[:2]) + SIDE * 2.0 * 3.3  # in a known tile, with others around
    view = View.look((x, y, 320.0), (x, y + 1.0, 0.0), fov_deg=60.0)
    counts = [
        Terrain(interpolated(plain, name)).update(Criterion(error_px=1.0), [view]).triangles
        for name in ("bilinear", "bicubic")
    ]
    assert counts[0] > 5000 and counts[1] < 1.15 * counts[0], counts


def test_edges_and_areas_have_no_cracks(field):
    step = field.lattice.step_x / (1 << field.raster.finer.bits)
    at = np.array(field.lattice.rectangle()[:2]) + SIDE * step * np.array([0.6, 0.9])
    assert_no_cracks(field, at)


def test_rays_meet_the_surface_and_boxes_enclose_it(field):
    rng = np.random.default_rng(4)
    places = places_on(field, 1500, 4)
    origins = np.c_[places, np.full(len(places), field.max_height + 20.0)]
    targets = np.c_[places[rng.permutation(len(places))], rng.uniform(-50, 0, len(places))]
    ways = (targets - origins) / np.linalg.norm(targets - origins, axis=1)[:, None]
    distance = pick(field, origins, ways).distance
    hit = np.isfinite(distance)
    assert hit.mean() > 0.5
    points = origins[hit] + distance[hit, None] * ways[hit]
    assert np.abs(points[:, 2] - reference_heights(field, points[:, :2])).max() < 1e-3
    for part in (0.2, 0.5, 0.9, 0.99):  # the ray is above the surface before
        before = origins[hit] + part * distance[hit, None] * ways[hit]
        assert (before[:, 2] > reference_heights(field, before[:, :2]) - 1e-3).all()
    for _ in range(20):
        low = places[rng.integers(len(places))]
        high = low + 10 ** rng.uniform(0, 2.5, 2)
        inside = places[((places >= low) & (places <= high)).all(axis=1)]
        inside = np.concatenate([inside, low + rng.random((500, 2)) * (high - low)])
        inside = inside[(inside <= np.array(field.lattice.rectangle()[2:])).all(axis=1)]
        heights, ends = reference_heights(field, inside), box_range(field, *low, *high)
        assert ends[0] - 3e-5 <= heights.min() and heights.max() <= ends[1] + 3e-5


def test_frames_after_each_other_are_those_of_a_new_terrain(field):
    low, step = np.array(field.lattice.rectangle()[:2]), field.lattice.step_x / (1 << field.raster.finer.bits)
    cached = Terrain(field, 3)
    for k in range(4):
        at = low + SIDE * step * (np.array([0.6, 0.9]) + 0.05 * k)
        view = View.look((*at, 140.0), (*(at + 300), 60.0))
        criterion = Criterion(error_px=3.0, morph=1.5 if k > 1 else 1.0, hidden_factor=4.0 if k == 3 else 1.0)
        update, fresh = (terrain.update(criterion, [view]) for terrain in (cached, Terrain(field, 1)))
        assert update.surface.positions.tobytes() == fresh.surface.positions.tobytes()
        assert update.surface.normals.tobytes() == fresh.surface.normals.tobytes()
        assert np.array_equal(update.surface.corner_verts, fresh.surface.corner_verts)


def test_an_anchor_moves_the_surface_alone(field):
    assert_an_anchor_moves_the_surface_alone(field, places_on(field, 500, 6))


def test_normals_are_those_of_the_slopes(field):
    """Inside finer cells they are interpolated, so they differ from those of the heights by the step of the slopes."""
    places, h = places_on(field, 2000, 7), 1e-3
    inside = (np.abs(places) < np.array(field.lattice.rectangle()[2:]) - 64.0).all(axis=1)
    places = places[inside]
    low, part = np.array(field.lattice.rectangle()[:2]), field.lattice.step_x / (1 << field.raster.finer.bits)
    tiles = np.floor((places - low) / part).astype(int) // SIDE
    outside = field.raster.finer.numbers[tiles[:, 1], tiles[:, 0]] < 0
    slopes = [
        (reference_heights(field, places + way) - reference_heights(field, places - way)) / (2 * h)
        for way in (np.array([h, 0.0]), np.array([0.0, h]))
    ]
    normals = np.stack([-slopes[0], -slopes[1], np.ones(len(places))], 1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    found = ground_at(field, places).normals
    off = np.degrees(np.arccos(np.clip((found * normals).sum(axis=1), -1.0, 1.0)))
    assert off[outside].max() < 0.05 and np.median(off[~outside]) < 3.0 and off.max() < 30.0


def test_threads_change_no_byte_of_the_tiles():
    plain = finer_field(33, 40, 4, ((0, 0),), relief=20.0)
    with mock.patch.object(launch, "default_threads", return_value=1):
        one = bicubic(plain.with_raster(path=None))
    with mock.patch.object(launch, "default_threads", return_value=3):
        three = bicubic(plain.with_raster(path=None))
    for name in ("heights", "errors", "bounds", "ranges", "limits"):
        assert getattr(one.finer, name).tobytes() == getattr(three.finer, name).tobytes()
    assert one.finer.entry == three.finer.entry and one.finer.off == three.finer.off
