# SPDX-License-Identifier: GPL-3.0-or-later
"""Height fields from arrays: filling, fitting to a lattice, errors for meshlets."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.detail import Detail
from adaptive_terrain.cbt_terrain.field.heightfield import with_detail
from adaptive_terrain.cbt_terrain.field.lattice import fit
from adaptive_terrain.cbt_terrain.field.meshlet_errors import error_for
from rasters import hills


def test_an_array_that_fits_its_lattice_is_kept_as_it_is():
    heights = hills(97, 33)
    field = from_array(heights, 2.0, 3.0, origin=np.array([4e5, 5e6, 0.0]), crs="EPSG:32616")
    assert np.array_equal(field.samples, heights)
    lattice = field.lattice
    assert (lattice.columns, lattice.rows, lattice.levels, lattice.step_x, lattice.step_y) == (3, 1, 5, 2.0, 3.0)
    assert not lattice.is_padded and field.filled == 0
    assert (field.min_height, field.max_height) == (heights.min(), heights.max())
    assert field.crs == "EPSG:32616" and field.origin[1] == 5e6
    assert field.error.shape == (lattice.node_count,) and field.error.dtype == np.uint8
    assert field.ranges.shape == (lattice.range_count, 2) and field.ranges.dtype == np.uint16


def test_an_array_that_does_not_fit_is_kept_as_it_is_too():
    heights = hills(43, 37)
    field = from_array(heights, 10.0, 5.0)
    lattice = field.lattice
    assert np.array_equal(field.samples, heights) and lattice.is_padded
    assert (lattice.width, lattice.height, lattice.span) == (43, 37, (64, 64))
    assert (lattice.step_x, lattice.step_y) == (10.0, 5.0) and lattice.rectangle() == (-210.0, -90.0, 210.0, 90.0)


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


def test_keys_tell_surfaces_apart_and_write_one_text():
    field = from_array(hills(33, 33))
    cubic, detail = interpolated(field, "bicubic"), Detail(0.5, 8.0)
    fields = field, cubic, with_detail(field, detail), with_detail(cubic, detail), with_detail(field, Detail(0.5, 9.0))
    digest = field.raster.digest
    endings = ("", "-bicubic", f"-detail-{detail.key}", f"-bicubic-detail-{detail.key}")
    assert [str(some.key) for some in fields[:4]] == [digest + ending for ending in endings]
    assert len({some.key for some in fields}) == 5 and {some.raster for some in fields} == {field.raster}
    assert field.key is field.key == from_array(hills(33, 33)).key and hash(field.key) == hash(replace(field).key)


def test_another_raster_takes_over_no_cached_surface():
    field = from_array(hills(33, 33))
    surfaces = interpolated(field, "bicubic"), with_detail(field, Detail(0.5)), error_for(field, 1)
    other = field.with_raster(samples=field.samples + np.float32(1.0), digest="other")
    assert not other.cache.surfaces and not other.cache.expanded
    assert interpolated(other, "bicubic").key != surfaces[0].key and interpolated(field, "bicubic") is surfaces[0]
    assert np.allclose(interpolated(other, "bicubic").min_height, surfaces[0].min_height + 1.0)


def test_the_last_eight_surfaces_with_detail_are_cached():
    field = from_array(hills(9, 9))
    details = [Detail(1.0 + k) for k in range(9)]
    first, *others = [with_detail(field, detail) for detail in details]
    assert [with_detail(field, detail) for detail in details[1:]] == others
    assert with_detail(field, details[0]) is not first and with_detail(first, None) is field
    assert sum(spec.detail is not None for spec in field.cache.surfaces) == 8


def test_meshlet_errors_are_made_once_and_are_not_larger():
    field = from_array(hills(33, 33))
    assert error_for(field, 0) is field.error
    finer = error_for(field, 2)
    assert finer is error_for(field, 2)
    assert (finer <= field.error).all() and finer.max() < field.error.max()


# Samples, and columns, rows and levels of the squares.
SIZES = {
    (2, 2): (1, 1, 0),
    (3, 2): (2, 1, 0),
    (1000, 2): (999, 1, 0),
    (512, 512): (1, 1, 9),
    (513, 257): (2, 1, 8),
    (7, 1024): (1, 128, 3),
    (3601, 1801): (2, 1, 11),
    (20_000, 20_000): (1, 1, 15),
    (28_673, 28_673): (1, 1, 15),
    (100_352, 70_000): (1, 1, 17),
    (1 << 29, 2): ((1 << 29) - 1, 1, 0),
    ((1 << 29) + 1, (1 << 29) + 1): (1, 1, 29),
    ((1 << 29) + 2, (1 << 29) + 2): (2, 2, 29),
    ((1 << 30) + 1, (1 << 30) + 1): (2, 2, 29),
    ((1 << 30) + 1, 2): (1 << 30, 1, 0),
}


@pytest.mark.parametrize("size", SIZES)
def test_squares_are_as_large_as_covers_the_short_side_once(size):
    lattice = fit(*size)
    assert (lattice.columns, lattice.rows, lattice.levels) == SIZES[size] and lattice.is_addressable
    assert (lattice.width, lattice.height) == size


def test_arrays_that_are_no_heights_are_refused():
    for bad in (np.zeros((3, 3, 3)), np.zeros(5), np.array([["a"]]), np.zeros((3, 3), complex), np.zeros((0, 4))):
        with pytest.raises(TerrainError):
            from_array(bad)
    for steps in ((0.0, 1.0), (1.0, -1.0), (np.nan, 1.0), (np.inf, 1.0)):
        with pytest.raises(TerrainError, match="positive distances"):
            from_array(np.zeros((3, 3)), *steps)
