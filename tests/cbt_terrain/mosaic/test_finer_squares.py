# SPDX-License-Identifier: GPL-3.0-or-later
"""Squares of a quick import with the finest files of a mosaic: a city in a country that is too large to be imported."""

import shutil

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.store import open_store, read_json
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.importing import refining
from adaptive_terrain.cbt_terrain.importing.finer_squares import FINER, finer_squares, square_bits
from adaptive_terrain.cbt_terrain.importing.refining import with_loaded
from adaptive_terrain.cbt_terrain.importing.view_needs import SeenLand, is_fine_enough, missing_squares
from adaptive_terrain.cbt_terrain.mosaic import composite, finer_plan
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from finer_imports import assert_same, make_small
from invariants import assert_invariants
from mosaic_files import EAST, NORTH, UTM32, sheet

CITY = EAST + 4000.0, NORTH - 3000.0  # its corner in the north-west
STEP = 2.0  # metres, of the city
QUICK = 8000  # samples


@pytest.fixture(scope="module", autouse=True)
def small_tiles():
    """Make tiles of 64 x 64 cells, and four cells of one of the first picture along each side."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(finer_plan, "FEWEST", 1 << 20)
        for name, value in (("FEWEST", 1), ("BITS", 6), ("FACTOR", 4)):
            patch.setattr(refining, name, value)
        yield


@pytest.fixture(scope="module")
def country(tmp_path_factory, small_tiles):
    """Return a folder with two stores in which all tiles are loaded, the sheet of the city, and the import settings."""
    folder = tmp_path_factory.mktemp("country")
    coarse = sheet(UTM32, EAST, NORTH, 32.0, 32.0, 400, 300)
    city = sheet(UTM32, *CITY, STEP, STEP, 450, 350, shift=3.0)
    coarse.write(folder / "files" / "a_country.tif")
    city.write(folder / "files" / "b_city.tif")
    settings = ImportSettings(source=str(folder / "files"), quick=QUICK)
    for name in ("tiles", "squares"):
        run_mosaic_import(settings, folder / name)
        tiles = tuple(range(refining.picture_tiles(open_store(folder / name))))
        run_mosaic_import(with_loaded(settings, folder / name, tiles), folder / name)
    return folder, city, settings


def middle_of(field, east, north):
    """Return the point of a terrain, metres from its middle, at coordinates."""
    a, _, c, _, e, f = field.raster.place
    return np.array([(east - c) / a, (north - f) / e])


def above(field, height, **more):
    """Return the land that a camera sees `height` metres above the middle of the city, looking down."""
    x, y = middle_of(field, CITY[0] + 450.0, CITY[1] - 350.0)
    ground = float(ground_at(field, np.array([[x, y]])).heights[0])
    view = View.look((x, y - 1.0, ground + height), (x, y, ground))
    return SeenLand([view], np.eye(4), **more)


def test_a_country_knows_the_squares_of_its_city(country):
    folder, _, _ = country
    field = open_store(folder / "tiles")
    squares = finer_squares(field)
    assert field.raster.finer is None and squares.loaded == frozenset() and squares.is_coarse
    cell = field.lattice.step_x
    assert 16.0 < cell <= 32.0 and cell / 2**squares.bits <= STEP * (1 + 1e-3)
    side = cell * 2 ** square_bits(squares.bits)
    assert (900 // side) * (700 // side) <= len(squares.there) <= (900 // side + 3) * (700 // side + 3)
    assert read_json(folder / "tiles")["version"] == 6


def test_a_view_of_the_city_needs_its_squares(country):
    folder, _, _ = country
    field = open_store(folder / "tiles")
    near, far = above(field, 300.0), above(field, 300.0, error_px=1e4)
    wanted = missing_squares(folder / "tiles", [near])
    assert wanted and set(wanted) <= finer_squares(field).there
    assert missing_squares(folder / "tiles", [far]) == () and len(missing_squares(folder / "tiles", [near], 1)) == 1
    assert not is_fine_enough(folder / "tiles", [near]) and is_fine_enough(folder / "tiles", [far])
    away = near._replace(views=[View.look((-5000.0, -3000.0, 2500.0), (-5000.0, -2999.0, 0.0))])
    assert missing_squares(folder / "tiles", [away]) == ()
    assert is_fine_enough(folder / "tiles", [away]), "there the files have no more detail"


@pytest.fixture(scope="module")
def loaded(country):
    """Return the store in which all squares of the city are loaded, and the report of that import."""
    folder, _, settings = country
    squares = finer_squares(open_store(folder / "squares")).there
    report = run_mosaic_import(with_loaded(settings, folder / "squares", (), squares), folder / "squares")
    return folder / "squares", report


def test_loaded_squares_have_the_heights_of_the_city(country, loaded):
    _, city, _ = country
    store, report = loaded
    field = open_store(store)
    assert verify(store) and report["finer_tiles"] == len(field.raster.finer.heights) > 0
    assert is_fine_enough(store, [above(field, 300.0)]) and missing_squares(store, [above(field, 300.0)]) == ()
    rng = np.random.default_rng(1)
    east, north = CITY[0] + 350 + 200 * rng.random(4000), CITY[1] - 300 - 100 * rng.random(4000)
    points = np.stack([middle_of(field, *place) for place in zip(east, north, strict=True)])
    true = city.at(UTM32, east, north)
    moved = [
        np.abs(city.at(UTM32, east + x, north + y) - true).max() for x, y in ((0.75 * STEP, 0.0), (0.0, 0.75 * STEP))
    ]
    found = ground_at(field, points).heights
    assert np.abs(found - true).max() <= field.source_max + sum(moved), "samples are up to half a step off"
    x, y = middle_of(field, CITY[0] + 450.0, CITY[1] - 350.0)
    assert refining.loaded_at(field, x, y) == pytest.approx(STEP)
    assert refining.loaded_at(field, x - 3000.0, y) == pytest.approx(field.lattice.step_x, rel=1e-3)


def test_a_flight_over_loaded_squares_has_no_cracks(country, loaded):
    store, _ = loaded
    field = open_store(store)
    x, y = middle_of(field, *CITY)
    terrain = Terrain(field)
    for k in range(3):
        view = View.look((x + 200.0 * k, y - 100.0 * k, field.max_height + 300.0), (x + 300.0, y - 300.0, 0.0))
        update = terrain.update(Criterion(error_px=1.0), [view])
        assert_invariants(update.surface, field.lattice)
        assert update.bound_px <= 1.0 + 1e-6


@pytest.mark.thorough
def test_a_bicubic_surface_follows_the_loaded_squares(country, loaded, tmp_path):
    """Each import makes it of new arrays, and removes the old ones."""
    folder, _, settings = country
    store = tmp_path / "store"
    shutil.copytree(folder / "tiles", store)
    assert interpolated(open_store(store), "bicubic").finer is None
    squares = sorted(finer_squares(open_store(store)).there)
    counts = []
    for some in (squares[:1], squares):
        run_mosaic_import(with_loaded(settings, store, (), some), store)
        field = interpolated(open_store(store), "bicubic")
        counts.append(len(field.finer.heights))
        assert len(list(store.glob("data-*"))) == 1 and field.finer.off > 0.0
        assert Terrain(field).update(Criterion(error_px=1.0), above(field, 300.0).views).bound_px <= 1.0 + 1e-6
    whole = interpolated(open_store(loaded[0]), "bicubic")
    assert counts[0] < counts[1] == len(whole.finer.heights) and field.key == whole.key
    assert all(np.array_equal(*pair) for pair in zip(field.finer.arrays, whole.finer.arrays, strict=True))
    assert np.array_equal(field.error, whole.error) and field.finer.entry == whole.finer.entry


@pytest.mark.thorough
def test_some_squares_are_those_of_all(country, loaded, tmp_path):
    """One square alone has the same heights away from its border, where they blend to the coarser raster."""
    folder, _, settings = country
    field = open_store(loaded[0])
    bits = square_bits(field.raster.finer.bits)
    chosen = sorted(finer_squares(field).there)[len(finer_squares(field).there) // 2]
    run_mosaic_import(settings, tmp_path / "one")
    tiles = refining.loaded_tiles(field.provenance)
    run_mosaic_import(with_loaded(settings, tmp_path / "one", tiles, (chosen,)), tmp_path / "one")
    one = open_store(tmp_path / "one")
    grid = refining.TileGrid(field.lattice, bits)
    box = grid.box(chosen)
    cells = np.stack(np.meshgrid(np.linspace(box.x0 + 3, box.x1 - 3, 60), np.linspace(box.y0 + 3, box.y1 - 3, 60)), -1)
    west, south, _, _ = field.lattice.rectangle()
    points = cells.reshape(-1, 2) * (field.lattice.step_x, field.lattice.step_y) + (west, south)
    assert np.array_equal(ground_at(one, points).heights, ground_at(field, points).heights)
    assert len(one.raster.finer.heights) < len(field.raster.finer.heights)


@pytest.mark.parametrize(
    "entry",
    [
        None,
        [],
        [1.0, 5, True],
        ["1", 5, True, []],
        [1.0, 99, True, []],
        [1.0, 5, 1, []],
        [1.0, 5, True, [[5, 3], [4, 2]]],
        [1.0, 5, True, [[0, 1 << 60]]],
        [1.0, 5, True, [[-4, 2]]],
        [1.0, 5, True, ["ab"]],
    ],
)
def test_damaged_entries_are_no_squares(country, entry):
    field = open_store(country[0] / "tiles")
    assert finer_squares(field.with_raster(provenance=field.provenance | {FINER: entry})) is None


@pytest.mark.thorough
def test_files_of_earlier_squares_are_not_opened_again(tmp_path, monkeypatch):
    """Squares of two towns are loaded one town after the other; nothing of the first town is read with the second."""
    make_small(monkeypatch)  # windows of one tile
    sheet(UTM32, EAST, NORTH, 32.0, 32.0, 400, 300).write(tmp_path / "files" / "a_country.tif")
    for name, east in (("b_west", EAST + 2000.0), ("c_east", EAST + 8500.0)):
        sheet(UTM32, east, CITY[1], 1.0, 1.0, 500, 400, shift=3.0).write(tmp_path / "files" / f"{name}.tif")
    settings = ImportSettings(source=str(tmp_path / "files"), quick=QUICK)
    store, whole = tmp_path / "store", tmp_path / "whole"
    run_mosaic_import(settings, store)
    tiles = tuple(range(refining.picture_tiles(open_store(store))))
    run_mosaic_import(with_loaded(settings, store, tiles), store)
    shutil.copytree(store, whole)
    squares = finer_squares(open_store(store))
    columns = refining.TileGrid(open_store(store).lattice, square_bits(squares.bits)).columns
    west = {square for square in squares.there if square % columns < columns // 2}
    assert west and west < squares.there
    run_mosaic_import(with_loaded(settings, store, (), west), store)
    opened, open_tile = [], composite.open_tile

    def opening(file, *options):
        opened.append(file.name)
        return open_tile(file, *options)

    with monkeypatch.context() as patch:
        patch.setattr(composite, "open_tile", opening)
        run_mosaic_import(with_loaded(settings, store, (), squares.there), store)
    assert "c_east.tif" in opened and "b_west.tif" not in opened
    run_mosaic_import(with_loaded(settings, whole, (), squares.there), whole)
    assert_same(store, whole)
