# SPDX-License-Identifier: GPL-3.0-or-later
"""Intermediate results of flow and sky: mapped from nameless files beside a store, with the same values."""

import errno
import os
import tracemalloc

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import flow, pyramid, sky_layer, whole
from adaptive_terrain.cbt_terrain.field import derived_arrays, store, store_arrays
from adaptive_terrain.cbt_terrain.field.store import open_store
from rasters import hills, imported

WIDTH, HEIGHT = 480, 360
pytestmark = pytest.mark.skipif(os.name != "posix", reason="Windows removes no mapped file")


@pytest.fixture(autouse=True)
def small_arrays_are_mapped(monkeypatch):
    whole.forget_results()
    monkeypatch.setattr(derived_arrays, "MIN_SCRATCH", 1)
    monkeypatch.setattr(derived_arrays, "MIN_CACHED", 1)
    monkeypatch.setattr(pyramid, "ROWS", 16)
    yield
    whole.forget_results()


def imported_hills(tmp_path, holes):
    """Import hills: float heights, or, with holes, coded integers."""
    heights = hills(WIDTH, HEIGHT)
    if holes:
        heights = np.round(heights).astype(np.int16)
        heights[100:250, 200:260] = -999
    np.save(tmp_path / "map.npy", heights)
    options = {"no_data": -999.0, "holes": True} if holes else {}
    return imported(tmp_path, tmp_path / "map.npy", extent=(10.0 * WIDTH, 10.0 * HEIGHT), **options)[0]


def names_in(field):
    return sorted(path.name for path in store.data_folder(field.raster).rglob("*"))


def flow_of(field, scale=1.0):
    whole.forget_results()
    return flow.logarithms(field, scale, 2).samples.copy()


def sky_of(field):
    return sky_layer.sky_layer(field, 1.0, 2).values.numpy().copy()


def bytes_a_sample(compute, field):
    """Return the result and the largest memory in bytes a sample, which does not count mapped files.

    The radix sort of *flow* has tables of 0.5 MB, here 3 bytes a sample.
    """
    tracemalloc.start()
    result = compute(field)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return result, (peak - result.nbytes) / (WIDTH * HEIGHT)


@pytest.mark.parametrize("holes", [False, True])
@pytest.mark.parametrize(("compute", "limit", "in_memory"), [(flow_of, 5.0, 17.0), (sky_of, 4.0, 8.0)])
def test_large_rasters_take_memory_of_files(tmp_path, monkeypatch, compute, limit, in_memory, holes):
    monkeypatch.setattr(store, "MAX_JSON_BYTES", 1 << 16)  # the buffer in which a store's description is read
    field = imported_hills(tmp_path, holes)
    expected, larger = bytes_a_sample(compute, field.with_raster(path=None))
    compute(open_store(field.path))  # fills what is cached beside results
    for result in store.data_folder(field.raster).glob("effect_*"):
        result.unlink()
    names = names_in(field)
    found, peak = bytes_a_sample(compute, open_store(field.path))
    assert found.tobytes() == expected.tobytes()
    assert peak < limit and larger > in_memory
    added = set(names_in(field)) - set(names)
    assert [name.split("_")[0] for name in added] == ["effect"]


def test_inverted_ground_has_the_same_flow_as_in_memory(tmp_path):
    field = imported_hills(tmp_path, holes=True)
    assert flow_of(field, -1.0).tobytes() == flow_of(field.with_raster(path=None), -1.0).tobytes()


def test_an_unfinished_sky_leaves_no_file_in_the_store(tmp_path):
    field = imported_hills(tmp_path, holes=False)
    names = names_in(field)
    assert not sky_layer.advance(field, 1.0, 2)
    assert names_in(field) == names


def test_a_full_disk_leaves_scratch_in_memory(tmp_path, monkeypatch):
    field = imported_hills(tmp_path, holes=False)
    names, expected = names_in(field), sky_of(field.with_raster(path=None))

    def no_space(*_arguments):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", no_space, raising=False)
    assert sky_of(field).tobytes() == expected.tobytes()
    assert names_in(field) == names


def test_an_interrupt_leaves_no_scratch_file(tmp_path, monkeypatch):
    field = imported_hills(tmp_path, holes=False)
    names, allocate = names_in(field), store_arrays.allocate_array

    def stop(*given, **named):
        allocate(*given, **named)
        raise KeyboardInterrupt

    monkeypatch.setattr(store_arrays, "allocate_array", stop)
    with pytest.raises(KeyboardInterrupt):
        flow_of(field)
    assert names_in(field) == names


def test_a_forked_child_leaves_the_sky_of_its_parent(tmp_path):
    field = imported_hills(tmp_path, holes=False)
    expected = sky_of(field.with_raster(path=None))
    for _ in range(3):
        sky_layer.advance(field, 1.0, 1)
    child = os.fork()
    if child == 0:
        try:
            sky_layer.advance(field, 1.0, 1)
            os._exit(field.cache.results[sky_layer.LAYER, 1.0]["azimuths"])
        finally:
            os._exit(99)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 1
    assert sky_of(field).tobytes() == expected.tobytes()
