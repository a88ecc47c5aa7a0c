# SPDX-License-Identifier: GPL-3.0-or-later
"""The pyramid of prefiltered heights, against sums in numpy."""

import itertools
import os
import tracemalloc

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import layers, pyramid
from adaptive_terrain.cbt_terrain.attributes.pyramid import level_of, scaled_pyramid
from adaptive_terrain.cbt_terrain.field import derived_arrays, store
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import build, from_array
from adaptive_terrain.cbt_terrain.field.codes import Steps
from adaptive_terrain.cbt_terrain.field.derived_arrays import samples_by_level
from adaptive_terrain.cbt_terrain.field.store import Draft, is_intact, open_store
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.importing.build_store import ImportSettings, run_import
from padded import raster

# Rows and columns that fit a lattice, that do not, and that are as few as can be.
SHAPES = [(33, 33), (64, 97), (50, 21), (3, 3), (2, 2), (2, 40), (3, 8)]


def halved(heights: np.ndarray) -> np.ndarray:
    """Compute the next level: extend each axis linearly by two samples on either side, then apply the weights."""
    for axis in (0, 1):
        h = np.moveaxis(heights, axis, 0)
        before = [2 * h[0] - h[1]]
        after = [2 * h[-1] - h[-2], 2 * h[-1] - h[min(2, len(h) - 1) * -1 - 1]]
        h = np.concatenate([before, h, after])
        count = len(heights) if axis == 0 else heights.shape[1]
        at = 1 + 2 * np.arange(-(-(count - 1) // 2) + 1)
        heights = np.moveaxis((h[at - 1] + 2 * h[at] + h[at + 1]) / 4, 0, axis)
    return heights


@pytest.mark.parametrize("shape", SHAPES)
def test_levels_are_means_of_the_level_below(shape):
    field = from_array(raster(*shape[::-1]), 10.0)
    levels = [level_of(field.raster, level) for level in range(len(samples_by_level(field.lattice)))]
    assert [level.shape for level in levels] == samples_by_level(field.lattice)
    for below, level in itertools.pairwise(levels):
        np.testing.assert_allclose(level, halved(below.astype(np.float64)), atol=1e-4)


@pytest.mark.parametrize("shape", SHAPES)
def test_planes_stay_planes_to_the_last_sample(shape):
    y, x = np.mgrid[: shape[0], : shape[1]]
    field = from_array((700.0 + 3.0 * x - 2.0 * y).astype(np.float32), 10.0)
    for level in range(len(samples_by_level(field.lattice))):
        found = level_of(field.raster, level)
        y, x = np.mgrid[: found.shape[0], : found.shape[1]] * 2**level
        assert abs(found - (700.0 + 3.0 * x - 2.0 * y)).max() < 1e-3


def test_a_pyramid_is_computed_once_in_a_third_of_the_memory():
    one, two = from_array(raster(300, 200), 10.0), from_array(raster(300, 200), 10.0)
    scaled_pyramid(one.raster, 1.0, 0.0, 1), scaled_pyramid(two.raster, 1.0, 0.0, 3)
    [made] = one.cache.pyramid
    assert made.tobytes() == two.cache.pyramid[0].tobytes()
    assert made.nbytes < 0.36 * one.samples.nbytes
    scaled_pyramid(interpolated(one, "bicubic").raster, 2.0, 5.0, 1)
    assert one.cache.pyramid[0] is made and interpolated(one, "bicubic").cache.pyramid[0] is made


def test_coded_heights_have_the_levels_of_their_floats():
    numbers, steps = (raster(97, 50) * 8 + 4000).astype(np.uint16), Steps(0, 0.125, -500.0)
    floats = from_array(steps.heights(numbers), 10.0)
    coded = floats.with_raster(samples=numbers, steps=steps)
    for level in range(len(samples_by_level(floats.lattice))):
        assert level_of(floats.raster, level).tobytes() == level_of(coded.raster, level).tobytes()


def test_a_large_raster_has_its_pyramid_in_the_store(tmp_path, monkeypatch):
    run_import(ImportSettings(source="island", size=129), tmp_path / "store")
    expected = pyramid_bytes(open_store(tmp_path / "store"))
    assert not list(tmp_path.rglob("pyramid.npy"))
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 129 * 129)
    assert pyramid_bytes(open_store(tmp_path / "store")) == expected
    [file] = tmp_path.rglob("pyramid.npy")
    monkeypatch.setattr(pyramid.launch, "spread", None)  # nothing is computed again
    field = open_store(tmp_path / "store")
    assert pyramid_bytes(field) == expected and is_intact(field)
    assert verify(tmp_path / "store")["pyramid.npy"] == 1
    os.truncate(file, 5000)
    assert not is_intact(field)


def pyramid_bytes(field) -> bytes:
    """Return the coarser levels of a field's heights."""
    scaled_pyramid(field.raster, 1.0, 0.0, 1)
    return field.cache.pyramid[0].tobytes()


def test_a_damaged_pyramid_is_computed_again(tmp_path, monkeypatch):
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 0)
    run_import(ImportSettings(source="island", size=129), tmp_path / "store")
    expected = pyramid_bytes(open_store(tmp_path / "store"))
    [file] = tmp_path.rglob("pyramid.npy")
    os.truncate(file, 5000)
    assert pyramid_bytes(open_store(tmp_path / "store")) == expected
    run_import(ImportSettings(source="island", size=65), tmp_path / "store")
    assert not list(tmp_path.rglob("pyramid.npy"))  # it goes with the raster that it is of


def test_a_layer_of_a_large_raster_has_its_pyramid_in_the_store(tmp_path, monkeypatch):
    draft = Draft(tmp_path)
    samples, snow = (draft.allocate(name, (90, 70), np.float32) for name in ("samples", "layer_snow"))
    samples[:], snow[:] = raster(70, 90), raster(70, 90)[::-1]
    draft.publish(build(samples, 5.0, 5.0, missing=0, allocate=draft.allocate), "", {}, {"snow": "m"})
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 0)
    field, alone = open_store(tmp_path), from_array(raster(70, 90)[::-1], 5.0)
    assert snow_pyramid(field) == pyramid_bytes(alone) != pyramid_bytes(field)
    with monkeypatch.context() as nothing:  # is computed again
        nothing.setattr(pyramid.launch, "spread", None)
        assert snow_pyramid(open_store(tmp_path)) == pyramid_bytes(alone)
    assert {"pyramid.npy", "pyramid_snow.npy"} < verify(tmp_path).keys() and is_intact(field)
    os.truncate(next(tmp_path.glob("data-*/pyramid_snow.npy")), 5000)
    assert not is_intact(field)


def snow_pyramid(field) -> bytes:
    """Return the coarser levels of the layer snow."""
    layer = layers._as_raster(field, "snow")
    scaled_pyramid(layer, 1.0, 0.0, 1, "pyramid_snow")
    return layer.cache.pyramid[0].tobytes()


def test_a_cached_pyramid_takes_no_memory_of_the_process(tmp_path, monkeypatch):
    monkeypatch.setattr(store, "MAX_JSON_BYTES", 1 << 16)  # a buffer of as many is for reading it
    run_import(ImportSettings(source="island", size=1025), tmp_path / "store")
    field = open_store(tmp_path / "store")
    tracemalloc.start()
    scaled_pyramid(field.raster, 1.0, 0.0, 1)
    assert tracemalloc.get_traced_memory()[1] < 0.1 * field.cache.pyramid[0].nbytes
    tracemalloc.stop()
