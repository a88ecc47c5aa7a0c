# SPDX-License-Identifier: GPL-3.0-or-later
"""The largest part of a terrain's ground: its rectangle, its heights and its gaps."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.query.largest_part import largest_box, sample_largest_part

STEP, COUNT = 4.0, 33


def hills(rows, columns):
    return np.random.default_rng(1).normal(size=(rows, columns)).cumsum(axis=0).astype(np.float32)


def positions_of(samples):
    """Return the positions of a row of samples, metres from its middle."""
    return (np.arange(samples) - (samples - 1) / 2) * STEP


def test_a_terrain_without_holes_is_one_part():
    heights = hills(97, 65)
    part = sample_largest_part(from_array(heights.copy(), STEP), COUNT)
    assert part.is_ground.all() and part.heights.shape == (33, 33)
    np.testing.assert_array_equal(part.heights, heights[::3, ::2])
    np.testing.assert_array_equal(part.x, positions_of(65)[::2])
    np.testing.assert_array_equal(part.y, positions_of(97)[::3])


def test_the_larger_of_two_islands_is_sampled():
    heights = hills(200, 300)
    land = np.zeros(heights.shape, bool)
    land[20:50, 10:70] = land[120:180, 150:290] = True
    part = sample_largest_part(from_array(np.where(land, heights, np.nan), STEP, holes=True), COUNT)
    x, y = positions_of(300), positions_of(200)
    spacing = 300 / (COUNT - 1) * STEP  # of the first samples, between which a border may be
    for found, (first, last) in ((part.x, x[[150, 289]]), (part.y, y[[120, 179]])):
        assert first - 2 * spacing <= found[0] <= first and last <= found[-1] <= last + 2 * spacing
        assert len(found) > 20
    rows, columns = (np.searchsorted(all_, some) for all_, some in ((y, part.y), (x, part.x)))
    np.testing.assert_array_equal(part.is_ground, land[np.ix_(rows, columns)])
    np.testing.assert_array_equal(part.heights[part.is_ground], heights[np.ix_(rows, columns)][part.is_ground])


def test_a_hole_inside_leaves_the_rectangle_of_the_terrain():
    heights = hills(129, 129)
    heights[40:90, 40:90] = np.nan
    part = sample_largest_part(from_array(heights, STEP, holes=True), COUNT)
    assert len(part.x) == len(part.y) == COUNT and part.x[0] == positions_of(129)[0]
    assert np.isfinite(part.heights).all() and 0.8 < part.is_ground.mean() < 0.9


def test_ground_between_the_samples_does_not_fail():
    heights = np.full((400, 400), np.nan, np.float32)
    heights[5:8, 5:8] = 1.0
    part = sample_largest_part(from_array(heights, STEP, holes=True), COUNT)
    assert part.is_ground.all() and part.heights.shape == (COUNT, COUNT)


@pytest.mark.parametrize("seed", range(5))
def test_the_largest_box_is_that_of_a_flood(seed):
    """Cells that meet at a corner are one part."""
    mask = np.random.default_rng(seed).random((24, 31)) < 0.25
    number = np.where(mask, np.arange(mask.size).reshape(mask.shape) + 1, 0)
    for _ in range(mask.size):  # each cell takes the largest number around it
        around = [np.roll(np.pad(number, 1), (i, j), (0, 1))[1:-1, 1:-1] for i in (-1, 0, 1) for j in (-1, 0, 1)]
        number = np.where(mask, np.max(around, axis=0), 0)
    counts = np.bincount(number[mask])
    boxes = []
    for part in np.flatnonzero(counts == counts.max()):
        rows, columns = np.nonzero(number == part)
        boxes.append([[rows.min(), rows.max() + 1], [columns.min(), columns.max() + 1]])
    assert largest_box(mask).tolist() in boxes
