# SPDX-License-Identifier: GPL-3.0-or-later
"""Height fields from arrays: filling, fitting to a lattice, errors for meshlets."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.lattice import fit
from adaptive_terrain.cbt_terrain.field.meshlet_errors import error_for
from fields import errors_of
from rasters import hills, jacksboro


def test_an_array_that_fits_its_lattice_is_kept_as_it_is():
    heights = hills(97, 33)
    field = from_array(heights, 2.0, 3.0, origin=np.array([4e5, 5e6, 0.0]), crs="EPSG:32616")
    assert np.array_equal(field.samples, heights)
    lattice = field.lattice
    assert (lattice.columns, lattice.rows, lattice.levels, lattice.step_x, lattice.step_y) == (3, 1, 5, 2.0, 3.0)
    assert (field.resample_max, field.resample_rms, field.filled) == (0.0, 0.0, 0)
    assert (field.min_height, field.max_height) == (heights.min(), heights.max())
    assert field.crs == "EPSG:32616" and field.origin[1] == 5e6
    assert field.error.shape == (lattice.node_count,) and field.error.dtype == np.uint8
    assert field.ranges.shape == (lattice.range_count, 2) and field.ranges.dtype == np.uint16


def test_an_array_that_does_not_fit_keeps_its_rectangle_and_says_what_moved():
    heights = hills(43, 37)
    field = from_array(heights, 10.0, 5.0)
    lattice = field.lattice
    assert lattice.width >= 43 and lattice.height >= 37
    assert lattice.step_x * (lattice.width - 1) == pytest.approx(420.0)
    assert lattice.step_y * (lattice.height - 1) == pytest.approx(180.0)
    x = np.arange(43) * (lattice.width - 1) / 42
    y = np.arange(37) * (lattice.height - 1) / 36
    moved = np.abs(sample(field.samples, x, y) - heights)
    assert moved.max() == pytest.approx(field.resample_max, rel=1e-6)
    assert np.sqrt((moved**2).mean()) == pytest.approx(field.resample_rms, rel=1e-6)
    assert field.samples.min() >= heights.min() and field.samples.max() <= heights.max()


def sample(samples, x, y):
    """Bilinear heights at the grid of columns x and rows y."""
    i = np.minimum(x.astype(int), samples.shape[1] - 2)
    j = np.minimum(y.astype(int), samples.shape[0] - 2)
    u, v, h = x - i, (y - j)[:, None], samples.astype(np.float64)
    south = h[j][:, i] * (1 - u) + h[j][:, i + 1] * u
    north = h[j + 1][:, i] * (1 - u) + h[j + 1][:, i + 1] * u
    return south * (1 - v) + north * v


def test_bringing_onto_a_lattice_moves_much_less_than_plain_bilinear():
    heights = jacksboro().astype(np.float32)
    rows, columns = heights.shape
    field = from_array(heights)
    across, up = field.lattice.width - 1, field.lattice.height - 1
    plain = sample(heights, np.arange(across + 1) * (columns - 1) / across, np.arange(up + 1) * (rows - 1) / up)
    back = sample(plain, np.arange(columns) * across / (columns - 1), np.arange(rows) * up / (rows - 1))
    moved = back - heights
    assert field.resample_rms < 0.1 * np.sqrt((moved**2).mean())
    assert field.resample_max < 0.2 * np.abs(moved).max()


def test_a_plane_stays_a_plane_on_any_lattice():
    y, x = np.indices((37, 43))
    field = from_array((3.0 * x - 7.0 * y).astype(np.float32))
    assert field.resample_max < 1e-4
    assert errors_of(field).max() < 1e-3


def test_missing_samples_take_the_nearest_valid_height():
    heights = hills(65, 33)
    holes = heights.copy()
    random = np.random.default_rng(2)
    missing = random.random(holes.shape) < 0.6
    missing[10:20, 20:50] = True
    missing[:, 60:] = True
    holes[missing] = np.nan
    field = from_array(holes, threads=2)
    assert field.filled == missing.sum()
    assert np.array_equal(field.samples[~missing], heights[~missing])
    valid = np.argwhere(~missing)
    for y, x in np.argwhere(missing):
        distances = ((valid - (y, x)) ** 2).sum(1)
        nearest = valid[distances == distances.min()]
        assert field.samples[y, x] in heights[nearest[:, 0], nearest[:, 1]]


def test_filling_does_not_depend_on_threads():
    holes = hills(130, 70)
    holes[np.random.default_rng(4).random(holes.shape) < 0.9] = np.nan
    one, two = from_array(holes, threads=1), from_array(holes, threads=2)
    assert one.key == two.key and one.samples.tobytes() == two.samples.tobytes()
    assert one.error.tobytes() == two.error.tobytes()


def test_keys_tell_terrains_apart():
    heights = hills(33, 33)
    other = heights.copy()
    other[5, 5] += 1e-3
    keys = {from_array(heights).key, from_array(other).key, from_array(heights, 2.0).key}
    keys.add(from_array(heights, source_max=0.5).key)
    assert len(keys) == 4 and from_array(heights.copy()).key in keys


def test_meshlet_errors_are_made_once_and_are_not_larger():
    field = from_array(hills(33, 33))
    assert error_for(field, 0) is field.error
    finer = error_for(field, 2)
    assert finer is error_for(field, 2)
    assert (finer <= field.error).all() and finer.max() < field.error.max()


SIZES = [(2, 2), (3, 2), (1000, 2), (1001, 3), (513, 257), (1201, 1201), (3601, 1801), (403, 344)]


@pytest.mark.parametrize("size", SIZES)
def test_the_lattice_is_at_least_as_fine(size):
    columns, rows, levels = fit(*size)
    assert (columns << levels) + 1 >= size[0] and (rows << levels) + 1 >= size[1]
    assert min(columns, rows) <= 16


def test_arrays_that_are_no_heights_are_refused():
    for bad in (np.zeros((3, 3, 3)), np.zeros(5), np.array([["a"]]), np.zeros((3, 3), complex), np.zeros((0, 4))):
        with pytest.raises(TerrainError):
            from_array(bad)
    for steps in ((0.0, 1.0), (1.0, -1.0), (np.nan, 1.0), (np.inf, 1.0)):
        with pytest.raises(TerrainError, match="positive distances"):
            from_array(np.zeros((3, 3)), *steps)
