# SPDX-License-Identifier: GPL-3.0-or-later
"""A city at 1 m in a country at 30 m: one raster with finer tiles, beside the files' own arrays."""

import json
import shutil

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import store as store_module
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.finer_tiles import SIDE
from adaptive_terrain.cbt_terrain.field.packing import copy_store
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.mosaic import finer_plan
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import mesh_heights
from invariants import assert_invariants
from mosaic_files import EAST, NORTH, UTM32, sheet

CITY = EAST + 4000.0, NORTH - 3000.0  # its corner in the north-west


@pytest.fixture(scope="module")
def country(tmp_path_factory):
    """Return the sheets of a country and of a city on it, and the store of both."""
    folder = tmp_path_factory.mktemp("country")
    coarse = sheet(UTM32, EAST, NORTH, 32.0, 32.0, 400, 300)
    city = sheet(UTM32, *CITY, 1.0, 1.0, 900, 700, shift=3.0)
    coarse.write(folder / "files" / "a_country.tif")
    city.write(folder / "files" / "b_city.tif")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(finer_plan, "FEWEST", 1 << 20)
        settings = ImportSettings(source=str(folder / "files"))
        report = run_mosaic_import(settings, folder / "store")
    return coarse, city, folder / "store", report


def coordinates(field, places):
    """Return x and y in the CRS of points of the terrain."""
    a, b, c, d, e, f = field.raster.place
    return a * places[:, 0] + b * places[:, 1] + c, d * places[:, 0] + e * places[:, 1] + f


def points_of(field, corner, size, count, seed):
    rng = np.random.default_rng(seed)
    a, _, c, _, e, f = field.raster.place
    x = corner[0] + rng.random(count) * size[0]
    y = corner[1] - rng.random(count) * size[1]
    return np.stack([(x - c) / a, (y - f) / e], 1)


@pytest.mark.thorough
def test_a_quick_import_with_few_finer_tiles_is_complete(country, tmp_path, monkeypatch):
    """The finest grid has 120 million samples here; the raster and the tiles are imported in the time of eight."""
    _, _, store, report = country
    monkeypatch.setattr(finer_plan, "FEWEST", 1 << 20)
    files = str(store.parent / "files")
    quick = run_mosaic_import(ImportSettings(source=files, quick=1_000_000), tmp_path / "complete")
    assert "loaded" not in quick and quick["finer_tiles"] == report["finer_tiles"]
    assert store_module.read_json(tmp_path / "complete")["key"] == store_module.read_json(store)["key"]
    quick = run_mosaic_import(ImportSettings(source=files, quick=100_000), tmp_path / "thin")
    assert quick["loaded"] == "to 63.8 m of 1 m" and "finer_tiles" not in quick


def test_the_store_holds_the_coarse_raster_and_the_city(country):
    _, _, store, report = country
    field = open_store(store)
    tiles = field.raster.finer
    assert tiles is not None and tiles.bits == 5
    assert report["finer_tiles"] == len(tiles.heights) < 60
    assert report["finer_step_m"] == [1.0, 1.0] and field.lattice.width * field.lattice.height < 400 * 320
    verify(store)
    size = sum(file.stat().st_size for file in store.rglob("*.npy"))
    assert size < 0.15 * 5 * report["raster"][0] * report["raster"][1] * 1024


def test_heights_of_the_city_are_those_of_its_file(country):
    _, city, store, _ = country
    field = open_store(store)
    inner = points_of(field, (CITY[0] + 350, CITY[1] - 300), (200, 100), 4000, 1)  # inside the ring
    expected = city.at(UTM32, *coordinates(field, inner))
    found = ground_at(field, inner).heights
    assert np.abs(found - expected).max() <= field.source_max + 1e-3


def test_heights_far_from_the_city_are_those_of_the_country(country):
    coarse, _, store, _ = country
    field = open_store(store)
    places = points_of(field, (EAST + 100, NORTH - 4500), (12_000, 4_000), 4000, 2)
    expected = coarse.at(UTM32, *coordinates(field, places))
    assert np.abs(ground_at(field, places).heights - expected).max() < 0.25  # resampled to its own 32 m


def test_the_border_of_the_city_has_no_step(country):
    _, _, store, _ = country
    field = open_store(store)
    a, _, c, _, e, f = field.raster.place
    x = (CITY[0] - 600 + np.arange(0, 2000, 0.5) - c) / a
    for north in (CITY[1] - 350, CITY[1] - 20, CITY[1] + 60):
        heights = ground_at(field, np.stack([x, np.full_like(x, (north - f) / e)], 1)).heights
        assert np.abs(np.diff(heights)).max() < 1.0  # the city is 3 m too high


def test_a_flight_over_the_border_has_no_cracks(country):
    _, _, store, _ = country
    field = open_store(store)
    start = points_of(field, CITY, (1e-9, 1e-9), 1, 3)[0]
    terrain = Terrain(field)
    for k in range(4):
        at = start + [200.0 * k, -100.0 * k]
        view = View.look((*at, 900.0 - 10 * k), (*(at + [300, -200]), 800.0))
        update = terrain.update(Criterion(error_px=1.0), [view])
        assert_invariants(update.surface, field.lattice)
        assert update.bound_px <= 1.0 + 1e-6


@pytest.mark.thorough
def test_a_city_without_blending_has_finer_tiles_and_a_hard_edge(country, tmp_path, monkeypatch):
    """Its heights, also at its border, are those of its file, and the step to the country is within one finer cell."""
    coarse, city, store, report = country
    monkeypatch.setattr(finer_plan, "FEWEST", 1 << 20)
    settings = ImportSettings(source=str(store.parent / "files"), blend=False)
    sharp = run_mosaic_import(settings, tmp_path / "store")
    field = open_store(tmp_path / "store")
    assert sharp["finer_tiles"] == report["finer_tiles"] and sharp["raster"] == report["raster"]
    assert "blend_m" not in sharp and field.raster.finer.bits == 5
    spacing = 1.5  # of the outer samples from the file's border, metres, and a finer cell
    inner = points_of(field, (CITY[0] + spacing, CITY[1] - spacing), (900 - 2 * spacing, 700 - 2 * spacing), 4000, 1)
    off = ground_at(field, inner).heights - city.at(UTM32, *coordinates(field, inner))
    assert np.abs(off).max() <= field.source_max + 1e-3
    east, north = np.meshgrid(CITY[0] - 11.5 + np.arange(12), CITY[1] - 100.5 - np.arange(100))  # samples of the grid
    a, _, c, _, e, f = field.raster.place
    outer = np.stack([(east.ravel() - c) / a, (north.ravel() - f) / e], 1)
    off = ground_at(field, outer).heights - coarse.at(UTM32, *coordinates(field, outer))
    assert np.abs(off).max() <= field.source_max + 1e-3
    # The mesh is compared with the surface on both sides of the edge, and in the cell of the edge.
    update = Terrain(field).update(Criterion(error_px=0.0, error_m=0.5))
    assert_invariants(update.surface, field.lattice)
    near = points_of(field, (CITY[0] - 8, CITY[1] + 8), (916, 16), 6000, 3)
    assert update.bound_m <= 0.5 and not update.limited
    off = mesh_heights(update.surface, near) - ground_at(field, near).heights
    assert np.abs(off).max() <= update.bound_m


def test_an_explicit_step_makes_one_raster(country, tmp_path, monkeypatch):
    _, _, store, _ = country
    monkeypatch.setattr(finer_plan, "FEWEST", 1 << 20)
    settings = ImportSettings(source=str(store.parent / "files"), step=16.0)
    run_mosaic_import(settings, tmp_path / "store")
    assert open_store(tmp_path / "store").raster.finer is None


def test_tiles_around_the_city_are_few(country):
    field = open_store(country[2])
    rows, columns = np.nonzero(field.raster.finer.numbers >= 0)
    across = (columns.max() - columns.min() + 1) * SIDE
    assert across < 900 + 2 * 64 + 4 * SIDE and (rows.max() - rows.min() + 1) * SIDE < 700 + 2 * 64 + 4 * SIDE


def test_a_damaged_store_of_finer_tiles_is_refused(country, tmp_path):
    _, _, store, _ = country
    copy_store(store, tmp_path / "copy")
    assert open_store(tmp_path / "copy").key == open_store(store).key
    for file in sorted((tmp_path / "copy").glob("data-*/finer_*.npy")):
        content = file.read_bytes()
        file.unlink()  # the copy may share its arrays with the store
        file.write_bytes(content[:5000] + bytes([content[5000] ^ 16]) + content[5001:])
        with pytest.raises(TerrainError, match="damaged"):
            verify(tmp_path / "copy")
        file.write_bytes(content)
    verify(tmp_path / "copy")
    described = json.loads((tmp_path / "copy" / "store.json").read_text())
    assert described["version"] == 7
    for change in ({"tiles": described["finer"]["tiles"] + 1}, {"bits": 9}, {"exponent": 2000}, {"range_step": "1"}):
        damaged = described | {"finer": described["finer"] | change}
        damaged["sum"] = store_module._sum_of(damaged)
        (tmp_path / "copy" / "store.json").write_text(json.dumps(damaged))
        with pytest.raises(TerrainError, match="damaged|expected"):
            open_store(tmp_path / "copy")


@pytest.mark.thorough
def test_a_bicubic_surface_is_kept_in_the_store(country, tmp_path):
    _, _, store, _ = country
    shutil.copytree(store, tmp_path / "copy")
    made, again = (interpolated(open_store(tmp_path / "copy"), "bicubic") for _ in range(2))
    assert again.finer.heights.base is not None and len(verify(tmp_path / "copy")) > len(verify(store))
    for one, other in zip(made.finer.arrays, again.finer.arrays, strict=True):
        assert one.tobytes() == other.tobytes()
    assert (made.min_height, made.finer.off) == (again.min_height, again.finer.off)
    (next((tmp_path / "copy").rglob("finer_values_c.npy"))).write_bytes(b"")
    assert interpolated(open_store(tmp_path / "copy"), "bicubic").finer.entry == made.finer.entry
