# SPDX-License-Identifier: GPL-3.0-or-later
"""Ranges over rectangles of the raster, against its samples."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field import heightfield
from adaptive_terrain.cbt_terrain.field.cell_ranges import rectangle_ranges
from fields import from_array, rough


@pytest.mark.parametrize("size", [64, 50, 33.5, 7, 3])
@pytest.mark.parametrize(
    "shape",
    [*(pytest.param(shape, marks=pytest.mark.thorough) for shape in ((257, 257), (200, 300))), (40, 700), (131, 66)],
)
def test_ranges_enclose_each_rectangle_and_little_more(shape, size):
    """Every sample in a rectangle is in its range, and the range in that of the samples near the rectangle."""
    field, (rows, columns) = rough(*shape), shape
    x, y = ([(s, min(s + size, n - 1)) for s in np.arange(0, n - 1 - size / 2, size)] for n in (columns, rows))
    found = rectangle_ranges(field, x, y)
    assert found.shape == (len(y), len(x), 2)
    heights, reach = field.heights(), max(size / 16, 4.0) * 2 + 4
    for j, (south, north) in enumerate(y):
        for i, (west, east) in enumerate(x):
            part = heights[int(south) : int(np.ceil(north)) + 1, int(west) : int(np.ceil(east)) + 1]
            low, high = found[j, i]
            assert low <= part.min() and part.max() <= high
            near = heights[
                max(int(south - reach), 0) : int(north + reach) + 2, max(int(west - reach), 0) : int(east + reach) + 2
            ]
            more = 2 * field.range_step
            assert near.min() - more <= low and high <= near.max() + more


def test_ranges_read_no_sample(monkeypatch):
    field = rough(200, 300)
    monkeypatch.setattr(heightfield.HeightField, "heights", None)
    field.raster.samples.fill(np.nan)
    assert np.isfinite(rectangle_ranges(field, [(0, 100), (100, 299)], [(0, 199)])).all()


def test_a_raster_without_ranges_has_its_limits():
    field = from_array(np.array([[1.0, 2.0, 4.0], [3.0, 8.0, 5.0]], np.float32), 1.0)
    assert rectangle_ranges(field, [(0, 1), (1, 2)], [(0, 1)]).tolist() == [[[1.0, 8.0], [1.0, 8.0]]]
