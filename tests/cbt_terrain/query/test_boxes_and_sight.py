# SPDX-License-Identifier: GPL-3.0-or-later
"""Ranges of heights in boxes, and samples that an eye sees, against brute force in numpy."""

import math

import numpy as np
import pytest
from adaptive_terrain import box_range, ground_at, viewshed
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from fields import reference_heights, rough
from query_fields import ROUGH, SHAPE, STEP, SURFACES, with_holes
from sight_lines import least_clearance, pieces

WEST, SOUTH, EAST, NORTH = ROUGH.lattice.rectangle()
BOXES = [
    (-101.3, -55.5, 33.1, 78.2),
    (10.2, 11.3, 10.9, 12.0),  # inside one cell
    (-21.0, -35.0, 14.0, 7.0),  # along lines of samples
    (5.5, -1e9, 5.5, 1e9),  # a line across
    (EAST, NORTH, 1e9, 1e9),  # a corner
]


def grid_in(field, box, count=40):
    """Return points in a box: its corners, crossings of lines of samples with it and in it, and even ones between."""
    lines = []
    for low, high, end, cells in ((box[0], box[2], EAST, SHAPE[1] - 1), (box[1], box[3], NORTH, SHAPE[0] - 1)):
        low, high = max(low, -end), min(high, end)
        sample_lines = (np.arange(cells + 1) - cells / 2) * STEP
        lines.append(np.r_[sample_lines[(sample_lines >= low) & (sample_lines <= high)], np.linspace(low, high, count)])
    return np.stack(np.meshgrid(*lines), -1).reshape(-1, 2)


@pytest.mark.parametrize("box", BOXES)
@pytest.mark.parametrize("name", SURFACES)
def test_a_box_encloses_the_surface_exactly_if_bilinear(name, box):
    field = SURFACES[name]
    truth = -2 * reference_heights(field, grid_in(field, box)) + 5
    low, high = box_range(field, *box, vertical_scale=-2.0, vertical_offset=5.0)
    assert low <= truth.min() + 1e-9 and high >= truth.max() - 1e-9
    if name in ("bilinear", "numbers"):
        assert abs(low - truth.min()) < 1e-9 and abs(high - truth.max()) < 1e-9
    else:  # no further than the patches that it touches reach
        wide = -2 * reference_heights(field, grid_in(field, np.add(box, (-STEP, -STEP, STEP, STEP)))) + 5
        more = 0.3 * np.ptp(wide) + 2 * 3.1
        assert low > wide.min() - more and high < wide.max() + more


def test_the_whole_raster_has_its_lowest_and_highest_sample():
    assert box_range(ROUGH, -1e9, -1e9, 1e9, 1e9) == (ROUGH.samples.min(), ROUGH.samples.max())
    assert box_range(ROUGH, -1e9, -1e9, 1e9, 1e9, threads=7) == (ROUGH.samples.min(), ROUGH.samples.max())


def test_holes_and_places_beyond_the_border_do_not_count():
    field = with_holes()
    x, y = WEST + 50 * STEP, SOUTH + 25 * STEP
    assert all(map(math.isnan, box_range(field, x - 20, y - 20, x + 20, y + 20)))
    assert all(map(math.isnan, box_range(field, EAST + 1, SOUTH, EAST + 9, NORTH)))
    # the border of a hole belongs to the neighbouring ground, on every side
    for column, row in ((39, 25), (60, 25), (50, 19), (50, 31)):
        x, y = WEST + column * STEP, SOUTH + row * STEP
        assert box_range(field, x, y, x, y) == (field.samples[row, column],) * 2
    spike = ROUGH.samples.copy()
    spike[0, 0] = np.nan
    beside = ROUGH.samples[[0, 1, 1], [1, 1, 0]]  # the sides of the cell that are others' too
    box = WEST, SOUTH, WEST + STEP, SOUTH + STEP
    assert box_range(from_array(spike, STEP, holes=True), *box) == (beside.min(), beside.max())


@pytest.mark.parametrize("box", [(1, 0, 0, 1), (0, 0, np.nan, 1), (0, 0, 1, np.inf)])
def test_bad_boxes_are_refused(box):
    with pytest.raises(TerrainError, match="The box goes from"):
        box_range(ROUGH, *box)


SMALL = rough(21, 31, seed=3, step=5.0)


def with_hole():
    heights = SMALL.samples.copy()
    heights[5:14, 10:13] = np.nan
    return from_array(heights, 5.0, holes=True)


@pytest.mark.parametrize("name", ["plain", "holes", "from a sample"])
@pytest.mark.parametrize(("target", "scale"), [pytest.param(0.0, 1.0, marks=pytest.mark.thorough), (3.0, -0.7)])
def test_an_eye_sees_the_samples_that_nothing_rises_before(name, target, scale):
    field = with_hole() if name == "holes" else SMALL
    x, y = (12.0, -7.5) if name == "plain" else (-35.0, 10.0)
    eye = np.array([x, y, ground_at(field, [[x, y]], scale, 4.0).heights[0] + 6.0])
    seen = viewshed(field, eye, target, vertical_scale=scale, vertical_offset=4.0)
    j, i = np.indices(seen.shape).reshape(2, -1)[:, ::2]  # every other sample, as on a chessboard
    places = np.stack([(i - 15) * 5.0, (j - 10) * 5.0], 1)
    ground = ground_at(field, places, scale, 4.0)
    points = np.c_[places, field.samples[j, i].astype(float) * scale + 4.0 + target]
    clear = np.array([least_clearance(field, point, eye, scale, 4.0) for point in points])
    sure = np.abs(clear) > 1e-6
    assert np.array_equal(seen[j, i][sure], ((clear > 0) & ground.inside)[sure]) and sure.mean() > 0.95
    assert 0.1 < seen.mean() < 0.9


def test_an_eye_over_curved_ground():
    field = SURFACES["masked"]
    eye = np.array([20.0, -30.0, ground_at(field, [[20.0, -30.0]]).heights[0] + 4.0])
    seen = viewshed(field, eye, 0.5, radius=170.0)
    rng = np.random.default_rng(0)
    for j, i in zip(rng.integers(SHAPE[0], size=60), rng.integers(SHAPE[1], size=60), strict=True):
        place = np.array([(i - 56) * STEP, (j - 35) * STEP])
        point = np.array([*place, ground_at(field, place).heights[0] + 0.5])
        _, e, _ = pieces(field, point, eye - point, 1.0, places=15)
        near = np.linalg.norm(place - eye[:2]) <= 170.0
        assert seen[j, i] == (near and e.min() > 0) or abs(e.min()) < 0.05
    assert 0.005 < seen.mean() < 0.9


def test_a_radius_limits_the_view_and_threads_do_not_change_it():
    eye = np.array([3.0, 4.0, 150.0])
    seen = viewshed(ROUGH, eye, threads=1)
    near = viewshed(ROUGH, eye, radius=100.0, threads=4)
    j, i = np.indices(SHAPE)
    within = np.hypot((i - 56) * STEP - 3.0, (j - 35) * STEP - 4.0) <= 100.0
    assert np.array_equal(near, seen & within) and 0 < near.sum() < seen.sum()
    assert np.array_equal(viewshed(ROUGH, eye, threads=4), seen)


def test_an_eye_below_sees_no_ground_and_one_on_a_sample_does():
    assert not viewshed(ROUGH, (0.0, 0.0, -1e4)).any()
    flat = from_array(np.full((5, 6), 2.0))
    assert viewshed(flat, (0.5, 0.0, 2.0)).all() and viewshed(flat, (0.5, 0.0, 5.0), radius=0.0).sum() == 1


@pytest.mark.parametrize("more", [{"radius": -1.0}, {"target_height": np.nan}, {"radius": np.nan}])
def test_bad_views_are_refused(more):
    with pytest.raises(TerrainError, match="height of targets"):
        viewshed(ROUGH, (0, 0, 9), **more)
    with pytest.raises(TerrainError, match="The eye came as 2 points"):
        viewshed(ROUGH, [(0, 0, 9), (0, 0, 8)])
