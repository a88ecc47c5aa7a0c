# SPDX-License-Identifier: GPL-3.0-or-later
"""Flow and wetness at places, and the results over whole rasters that they are read from."""

import math

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import flow, routing, wetness, whole
from adaptive_terrain.cbt_terrain.attributes.attribute import SamplePoints
from adaptive_terrain.cbt_terrain.field import store, store_folder
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.store_arrays import PAGE_BYTES
from adaptive_terrain.cbt_terrain.field.verification import verify
from own_surface import bilinear
from rasters import hills, imported


@pytest.fixture(autouse=True)
def nothing_kept():
    whole.forget_results()
    yield
    whole.forget_results()


def places_of(field, level=0.0, scale=1.0, threads=1, count=500):
    west, south, east, north = field.lattice.rectangle()
    rng = np.random.default_rng(1)
    at = np.column_stack([rng.uniform(west, east, count), rng.uniform(south, north, count), np.zeros(count)])
    return SamplePoints(field, at.astype(np.float32), np.full(count, level, np.float32), scale, 0.0, threads)


def flow_at(places):
    return flow.make(places, {"flow": {}}, {})["flow"]


def reference(field, places):
    """Bilinear in the logarithms of areas, float64."""
    lattice = field.lattice
    holes = None if field.valid is None else field.valid == 0
    drainage = routing.route(field.heights(), lattice.step_x, lattice.step_y, holes)
    filled = drainage.filled()
    area = drainage.areas(filled)
    drainage.level_lakes(filled, area)
    z = np.log(area.reshape(lattice.height, lattice.width) * lattice.step_x * lattice.step_y)
    west, south, _, _ = lattice.rectangle()
    x = (places.positions[:, 0].astype(np.float64) - west) / lattice.step_x
    y = (places.positions[:, 1].astype(np.float64) - south) / lattice.step_y
    return np.exp(bilinear(z, x, y))


@pytest.mark.parametrize("shape", [(65, 65), (64, 64), (100, 70)])
def test_logarithms_are_interpolated_at_points(shape):
    field = from_array(hills(shape[1], shape[0]), 10.0, 8.0)
    places = places_of(field)
    assert np.allclose(flow_at(places), reference(field, places), rtol=1e-5)


def test_a_result_is_independent_of_caches_of_the_heights():
    field = from_array(hills(65, 65), 10.0, 8.0)
    field.cache.results["sun"], field.layers["snow"] = "of the heights", field.samples
    areas = flow.logarithms(field, 1.0, 1)
    assert areas.cache.results == {} and areas.layers == {}
    areas.cache.results["sun"] = "of the areas"
    assert field.cache.results["sun"] == "of the heights"


def test_coarser_levels_are_means_of_logarithms():
    field = from_array(hills(129, 129), 10.0)
    z = flow.logarithms(field, 1.0, 1).samples.astype(np.float64)
    rows = z[:, 1:-1] / 2 + (z[:, :-2] + z[:, 2:]) / 4
    mean = (rows[1:-1] / 2 + (rows[:-2] + rows[2:]) / 4)[1::2, 1::2]
    x = np.arange(-62, 63, 2) * 10.0
    at = np.stack([*np.meshgrid(x, x), np.zeros((63, 63))], -1).reshape(-1, 3).astype(np.float32)
    coarse = flow_at(SamplePoints(field, at, np.full(len(at), 1.0, np.float32)))
    assert np.allclose(np.log(coarse).reshape(63, 63), mean, rtol=1e-6)
    between = np.log(flow_at(places_of(field, 2.5)))
    both = [np.log(flow_at(places_of(field, level))) for level in (2.0, 3.0)]
    assert np.allclose(between, np.mean(both, axis=0), rtol=1e-5)


def test_water_runs_the_other_way_on_inverted_ground():
    heights = hills(65, 65)
    upright, inverted = from_array(heights, 10.0), from_array(-heights, 10.0)
    assert np.array_equal(flow_at(places_of(upright, scale=-3.0)), flow_at(places_of(inverted, scale=2.0)))


def test_a_coded_store_with_holes_is_routed_by_its_heights(tmp_path):
    heights = np.round(hills(80, 60)).astype(np.int16)
    heights[20:24, 30:40] = -999
    np.save(tmp_path / "map.npy", heights)
    field, _ = imported(tmp_path, tmp_path / "map.npy", extent=(800.0, 600.0), no_data=-999.0, holes=True)
    assert field.samples.dtype == np.uint16 and (field.valid == 0).sum() == 40
    places = places_of(field)
    assert np.allclose(flow_at(places), reference(field, places), rtol=1e-5)


def test_a_larger_raster_is_routed_at_a_coarser_level(monkeypatch):
    field = from_array(hills(130, 97), 10.0)
    monkeypatch.setattr(flow, "MAX_SAMPLES", 66 * 49)
    assert flow.routed_level(field) == 1
    found = flow.logarithms(field, 1.0, 1)
    assert found.samples.shape == (49, 66) and found.lattice.step_x == 20.0
    values = flow_at(places_of(field))
    assert np.isfinite(values).all() and values.min() >= 400.0 * (1 - 1e-6)


def test_any_slices_and_threads_give_the_same_bytes():
    field = from_array(hills(400, 300), 10.0)
    whole_run = flow_at(places_of(field, 0.625, threads=1, count=60_000))
    whole.forget_results()
    places = places_of(field, 0.625, threads=3, count=60_000)
    assert np.array_equal(flow_at(places), whole_run)
    part = np.arange(3, 60_000, 7)
    assert np.array_equal(flow_at(places.only(part)), whole_run[part])


def test_wetness_is_that_of_its_definition():
    count, lattice = 50, from_array(hills(65, 65), 10.0).lattice
    rng = np.random.default_rng(0)
    normal = rng.standard_normal((count, 3)) * (1, 1, 0.2) + (0, 0, 3)
    normal[0] = 0, 0, 1
    normal = (normal / np.linalg.norm(normal, axis=1)[:, None]).astype(np.float32)
    area = (10 ** rng.uniform(1, 8, count)).astype(np.float32)
    places = places_of(from_array(hills(65, 65), lattice.step_x), count=count)
    made = wetness.make(places, {"wetness": {}}, {"flow": area, "detail_normal": normal})["wetness"]
    tangent = np.hypot(*normal[:, :2].T.astype(np.float64)) / normal[:, 2]
    expected = np.log(area / 10.0 / np.maximum(tangent, 1e-3))
    assert np.allclose(made, expected, rtol=1e-6) and made[0] == pytest.approx(math.log(area[0] / 10.0 / 1e-3))


@pytest.fixture
def stored(tmp_path):
    np.save(tmp_path / "map.npy", hills(80, 60))
    return imported(tmp_path, tmp_path / "map.npy", extent=(800.0, 600.0))[0]


def test_a_result_is_computed_once(stored, monkeypatch):
    runs = []
    route = routing.route
    monkeypatch.setattr(routing, "route", lambda *given, **named: runs.append(1) or route(*given, **named))
    first = flow_at(places_of(stored))
    assert np.array_equal(flow_at(places_of(stored, scale=2.5)), first) and len(runs) == 1, "in memory"
    whole.forget_results()
    again = open_store(stored.path)
    assert np.array_equal(flow_at(places_of(again)), first) and len(runs) == 1, "in the store"
    other = from_array(hills(64, 64), 10.0)
    flow_at(places_of(other))
    flow_at(places_of(stored))
    assert len(runs) == 2


@pytest.mark.parametrize("damage", ["byte", "short", "shape", "nan", "folder"])
def test_a_damaged_file_is_computed_again(stored, damage):
    first = flow_at(places_of(stored))
    file = next(store.data_folder(stored.raster).glob("effect_flow_*.npy"))
    content = bytearray(file.read_bytes())
    if damage == "byte":
        content[PAGE_BYTES + 777] ^= 8
    elif damage == "short":
        content = content[:-5]
    elif damage == "shape":
        content[:PAGE_BYTES] = content[:PAGE_BYTES].replace(b"(60, 80)", b"(80, 60)")
    if damage in ("nan", "folder"):
        file.unlink()
    if damage == "nan":
        whole.write_result(stored, file.stem, np.full((60, 80), np.nan, np.float32))
    elif damage == "folder":
        file.mkdir()
    else:
        file.write_bytes(content)
    whole.forget_results()
    assert np.array_equal(flow_at(places_of(stored)), first)
    if damage != "folder":
        whole.forget_results()
        assert np.isfinite(np.load(file)).all()


def test_a_store_with_results_is_still_one(stored):
    flow_at(places_of(stored))
    verify(stored.path)
    (stored.path / store.JSON_NAME).unlink()
    store_folder.check_target(stored.path)


def test_memory_has_a_limit(monkeypatch):
    fields = [from_array(hills(64 + k, 64), 10.0) for k in range(4)]
    monkeypatch.setattr(whole, "MAX_BYTES", int(2.5 * 64 * 70 * 4 * 4 / 3))
    for field in fields:
        flow.logarithms(field, 1.0, 1)
    assert len(whole._results) == 2 and list(whole._results)[-1].startswith(fields[-1].raster.digest)
