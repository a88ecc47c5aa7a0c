# SPDX-License-Identifier: GPL-3.0-or-later
"""Scatter points stay where they are if the raster grows in the west and the south."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.scatter.points import scatter_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.view.view import View
from rasters import hills

STEP = 10.0
EAST, NORTH = 6e5, 5.2e6  # coordinates of the larger raster's south-western corner
HEIGHTS = hills(90, 70)


def field_from(row, column):
    """Return the field of all samples from a row and a column on, with coordinates, and those of its middle."""
    heights = np.ascontiguousarray(HEIGHTS[row:, column:])
    middle = (
        EAST + STEP * (column + (heights.shape[1] - 1) / 2),
        NORTH + STEP * (row + (heights.shape[0] - 1) / 2),
    )
    place = (1.0, 0.0, middle[0], 0.0, 1.0, middle[1])
    field = from_array(heights, STEP).with_raster(crs="EPSG:32632", origin=np.array([*middle, 0.0]), place=place)
    return field, np.array(middle)


def table(points, middle, inside):
    """Return rows of x, y and z, size, variant and rotation, sorted, of points whose coordinates are in a rectangle."""
    at = points.positions.astype(np.float64) + [*middle, 0.0]
    rows = np.column_stack([at, points.size, points.variant, points.rotation])
    rows = rows[(np.abs(at[:, :2] - inside[0]) < inside[1]).all(axis=1)]
    return rows[np.lexsort((rows[:, 1], rows[:, 4]))]  # by variant


@pytest.mark.parametrize(("row", "column"), [(30, 40), (0, 40), (17, 0)])
@pytest.mark.parametrize("is_seen", [False, True])
def test_points_of_a_grown_raster_stay(row, column, is_seen):
    (small, middle), (large, large_middle) = field_from(row, column), field_from(0, 0)
    corner = EAST + STEP * column, NORTH + STEP * row
    eye, target = np.array([EAST + 500.0, NORTH + 400.0]), np.array([EAST + 800.0, NORTH + 600.0])
    half = STEP * (np.array([89 - column, 69 - row]) / 2 - 1)  # without the outermost cells, where other tiles are near
    for seed in (0, 5):
        scatter = Scatter(spacing=3.0, full_until=100.0, seed=seed, corner=corner)
        tables = []
        for field, centre in ((small, middle), (large, large_middle)):
            view = View.look((*(eye - centre), 900.0), (*(target - centre), 500.0), clip=(1.0, 4000.0))
            points = scatter_points(field, scatter, [view] if is_seen else [])
            assert len(np.unique(points.id)) == len(points) and points.id.min() >= 0
            tables.append(table(points, centre, (middle, half)))
        assert len(tables[0]) == len(tables[1]) > (200 if is_seen else 15_000)
        assert np.abs(tables[0] - tables[1]).max() < 2e-2
        moved = scatter_points(large, Scatter(spacing=3.0, full_until=100.0, seed=seed), [view] if is_seen else [])
        assert len(table(moved, large_middle, (middle, half))) != len(tables[0])


def test_a_corner_too_far_away_is_ignored():
    """A corner equal up to rounding, and ones that are no number or too far away, give the points without one."""
    field, _ = field_from(10, 20)
    plain = scatter_points(field, Scatter(spacing=5.0))
    for corner in ((EAST + 200.0 + 1e-6, NORTH + 100.0), (np.nan, 0.0), (1e300, 0.0)):
        other = scatter_points(field, Scatter(spacing=5.0, corner=corner))
        assert np.array_equal(other.positions, plain.positions) and np.array_equal(other.id, plain.id)


def test_a_raster_that_shrinks_keeps_its_points():
    """The corner is outside of the raster, in the south-west."""
    (large, large_middle), (small, middle) = field_from(0, 0), field_from(25, 35)
    half = STEP * (np.array([89 - 35, 69 - 25]) / 2 - 1)
    scatter = Scatter(spacing=4.0, seed=2, corner=(EAST, NORTH))
    before, after = (
        table(scatter_points(field, scatter), centre, (middle, half))
        for field, centre in ((large, large_middle), (small, middle))
    )
    assert len(before) == len(after) > 10_000 and np.abs(before - after).max() < 2e-2
