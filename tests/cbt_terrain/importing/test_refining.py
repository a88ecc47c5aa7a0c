# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores of which some tiles are loaded: their samples, bounds, marks, and the complete import after them."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import hierarchy
from adaptive_terrain.cbt_terrain.field.holes import refine_borders
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.importing import build_store, refining, tile_import
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.thinning import loaded_text
from adaptive_terrain.cbt_terrain.importing.tile_crew import ProcessCrew
from adaptive_terrain.cbt_terrain.importing.tile_tasks import perform
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.tiling.borders import children_of
from adaptive_terrain.cbt_terrain.tiling.tile_grid import LatticeVertices, TileGrid, cell_entries, entries_of, exist
from loaded_stores import QUICK, loaded_store, make_small_tiles, rough
from mosaic_files import EAST, NORTH, UTM32, sheet
from rasterio.transform import Affine
from rasters import hills, write_raster
from tiled_stores import content

PLACES = {
    "north up": Affine(10, 0, 5e5, 0, -10, 5e6),
    "south first": Affine(10, 0, 5e5, 0, 12, 5e6),
    "columns along y": Affine(0, 8, 5e5, 10, 0, 5e6),
}


@pytest.fixture
def small_tiles(monkeypatch):
    make_small_tiles(monkeypatch)


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    """Return the settings and the store of a quick import of rough hills with two loaded tiles."""
    with pytest.MonkeyPatch.context() as patch:
        make_small_tiles(patch)
        return loaded_store(tmp_path_factory.mktemp("loaded"), rough(505, 401), PLACES["north up"], (0, 9))


@pytest.fixture
def again(loaded, small_tiles, tmp_path):
    """Return these settings and a copy of the store."""
    shutil.copytree(loaded[1], tmp_path / "store")
    return loaded[0], tmp_path / "store"


def interpolated(nodes, factor):
    """Return a surface between samples, float32 [rows * factor + 1, columns * factor + 1]."""
    for _ in (0, 1):
        low, high = nodes[:-1].astype(np.float64), nodes[1:].astype(np.float64)
        parts = [low * (1 - k / factor) + high * (k / factor) for k in range(factor)]
        nodes = np.concatenate([np.stack(parts, axis=1).reshape(-1, nodes.shape[1]), nodes[-1:]]).T
    return nodes.astype(np.float32)


@pytest.mark.parametrize(
    "name", [pytest.param("north up", marks=pytest.mark.thorough), "south first", "columns along y"]
)
def test_loaded_tiles_are_true_and_others_the_first_picture(tmp_path, small_tiles, name):
    heights, place = rough(505, 401), PLACES[name]
    settings, store = loaded_store(tmp_path, heights, place, (0, 9))
    run_import(settings, tmp_path / "first")
    first, field = open_store(tmp_path / "first"), open_store(store)
    assert field.lattice.cells_x == 4 * first.lattice.cells_x and verify(store)
    counts = [n + 1 for n in (field.lattice.cells_y, field.lattice.cells_x)]
    counts = counts[::-1] if place.a == 0.0 else counts
    at = [
        np.rint(np.arange(n) * ((count - 1) / (n - 1)) + 1e-9).astype(int)
        for n, count in zip(counts, heights.shape, strict=True)
    ]
    true = heights[np.ix_(*at)]
    true = true.T if place.a == 0.0 else true if place.e > 0 else true[::-1]
    if place.a == 0.0 and place.d < 0:
        true = true[:, ::-1]
    found, expected = field.heights(), interpolated(first.heights(), 4)
    grid = TileGrid(field.lattice, 6)
    for number in (0, 9):
        box = grid.owned(grid.box(number))
        inside = slice(box.y0, box.y1 + 1), slice(box.x0, box.x1 + 1)
        expected[inside] = true[inside]
    assert np.abs(found - expected).max() < 1e-4, "apart from the rounding of the interpolation"
    assert (field.provenance["refined_m"][1], loaded_text(field.provenance)[:3]) == (2, "to ")


def cut_cells(field):
    """Return which cells of a store are cut out."""
    known = field.valid > 0
    return ~(known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:])


def test_holes_have_their_outline_outside_of_loaded_tiles(tmp_path, small_tiles):
    settings, store = loaded_store(tmp_path, holed(505, 401), PLACES["north up"], (9,), holes=True)
    run_import(settings, tmp_path / "first")
    first, field = cut_cells(open_store(tmp_path / "first")), cut_cells(open_store(store))
    box = TileGrid(open_store(store).lattice, 6).box(9)
    inside = slice(box.y0 - 1, box.y1 + 1), slice(box.x0 - 1, box.x1 + 1)
    expected = np.repeat(np.repeat(first, 4, axis=0), 4, axis=1)
    differ = field != expected
    assert differ[inside].any(), "the loaded tile has the true outline"
    differ[inside] = False
    assert not differ.any() and expected.any()


def vertices_of(lattice, level, is_centre):
    """Return all vertices of a depth of a lattice."""
    n = 1 << level
    x, y = (values.ravel() for values in np.meshgrid(*(np.arange(0, s + n, n) for s in lattice.span)))
    odd_x, odd_y = x >> level & 1, y >> level & 1
    vertices = LatticeVertices(x, y, level).chosen((odd_x & odd_y if is_centre else odd_x ^ odd_y) == 1)
    return vertices.chosen(exist(lattice, vertices))


def metres_of(field, vertices):
    return field.table[vertices.level // 2][field.error[entries_of(field.lattice, vertices)]]


def holed(width, height):
    """Return rough hills with a hole in a loaded tile, one outside of it, one across its border and a single one."""
    heights = rough(width, height)
    for row, column in ((300, 100), (40, 180), (90, 245)):
        heights[row : row + 30, column : column + 21] = np.nan
    heights[200, 200] = np.nan
    return heights


@pytest.mark.parametrize(
    ("tiles", "heights"),
    [
        ((0, 6, 7), rough),
        ((6, 9), holed),
        *(pytest.param((tile,), rough, marks=pytest.mark.thorough) for tile in (9, 15)),
    ],
)
def test_bounds_hold_for_the_loaded_surface(tmp_path, small_tiles, tiles, heights):
    holes = heights is holed
    _, store = loaded_store(tmp_path, heights(505, 401), PLACES["north up"], tiles, holes=holes)
    field = open_store(store)
    lattice = field.lattice
    true = np.zeros(lattice.node_count, np.float32)
    measured = np.where(field.valid > 0, field.heights(), np.float32(np.nan)) if holes else None
    hierarchy.build_errors(np.ascontiguousarray(field.heights()), lattice, true, 1, measured=measured)
    if holes:
        assert (field.valid == 0).any()
        refine_borders(field.valid, lattice, true, 1)
    ranges = np.zeros_like(field.ranges)
    hierarchy.build_ranges(
        np.ascontiguousarray(field.heights()), lattice, field.range_base, field.range_step, ranges, 1
    )
    assert np.array_equal(ranges, field.ranges)
    cells = field.table[lattice.groups]
    for level in range(lattice.levels):
        for is_centre in (False, True):
            vertices = vertices_of(lattice, level, is_centre)
            metres = metres_of(field, vertices)
            assert (metres >= true[entries_of(lattice, vertices)]).all()
            for child, there in children_of(lattice, vertices, is_centre):
                below = level if is_centre else level - 1
                values = cells if below < 0 else field.table[below // 2]
                assert (metres[there] >= values[field.error[child[there]]]).all(), "nested"
    wide, high = lattice.extent(lattice.cell_depth)
    at = cell_entries(lattice, *(values.ravel() for values in np.meshgrid(np.arange(wide), np.arange(high))))
    metres = cells[field.error[at]].reshape(high, wide)
    assert (metres >= true[at].reshape(high, wide)).all()
    for axis in (0, 1):
        pair = np.moveaxis(metres, axis, 0)
        assert (4 * pair[1:] >= pair[:-1]).all() and (4 * pair[:-1] >= pair[1:]).all()


@pytest.mark.thorough
def test_processes_load_the_same_bytes(tmp_path, small_tiles, monkeypatch):
    monkeypatch.setattr(refining, "FACTOR", 8)  # as in the processes
    monkeypatch.setitem(globals(), "QUICK", 1000)
    crew = ProcessCrew("cbt_terrain.importing.tile_crew", 2)
    try:
        stores = []
        for name, options in (("one", {}), ("two", {"crew": crew})):
            (tmp_path / name).mkdir()
            stores.append(loaded_store(tmp_path / name, rough(505, 401), PLACES["north up"], (0, 9), **options)[1])
    finally:
        crew.close()
    (arrays, text), (wanted, _) = map(content, stores)
    assert all(np.array_equal(arrays[name], wanted[name]) for name in wanted)
    assert text["provenance"]["refined_m"][1] == 2


def test_a_complete_import_has_no_trace_of_loaded_tiles(tmp_path, again):
    settings, store = again
    for target in (store, tmp_path / "plain"):
        run_import(replace(settings, quick=0), target)
    (arrays, text), (wanted, wanted_text) = content(store), content(tmp_path / "plain")
    assert text == wanted_text and all(np.array_equal(arrays[name], wanted[name]) for name in wanted)
    report = import_source(replace(settings, loaded_tiles=(3,)), store)
    assert report["unchanged"] and "loaded" not in report, "a complete store stays"


def test_tiles_of_a_mosaic_are_loaded(tmp_path, small_tiles):
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 480, 360)
    for row in range(3):
        for column in range(4):
            part = {"first_row": row * 120, "rows": 120, "first_column": column * 120, "columns": 120}
            whole.write(tmp_path / "tiles" / f"t{row}{column}.tif", **part)
    settings = ImportSettings(str(tmp_path / "tiles"), quick=QUICK)
    run_mosaic_import(settings, tmp_path / "store")
    first = run_mosaic_import(replace(settings, loaded_tiles=(0, 20)), tmp_path / "store")
    assert first["loaded"].endswith("in 2 tiles to 20 m") and first["bounds_against"].endswith(first["loaded"])
    run_mosaic_import(replace(settings, quick=0), tmp_path / "whole")
    field, full = open_store(tmp_path / "store"), open_store(tmp_path / "whole")
    shape = zip(full.heights().shape, field.heights().shape, strict=True)
    y, x = (np.rint(np.arange(cells) * ((count - 1) / (cells - 1)) - 1e-9).astype(int) for count, cells in shape)
    assert np.array_equal(field.heights()[:64, :64], full.heights()[np.ix_(y, x)][:64, :64])


def test_other_stores_have_no_tiles_to_load(tmp_path, again):
    settings, store = again
    for folder, wrong in ((tmp_path / "none", settings), (store, replace(settings, quick=300))):
        with pytest.raises(TerrainError, match="has no first picture of"):
            run_import(replace(wrong, loaded_tiles=(1,)), folder)


def test_detail_is_that_of_the_loaded_tile_at_a_point(tmp_path, again):
    settings, store = again
    field = open_store(store)
    west, south, east, _ = field.lattice.rectangle()
    side = 64 * field.lattice.step_x
    fine, coarse = field.provenance["refined_m"][0], field.provenance["loaded_m"][0]
    number = -(-field.lattice.cells_x // 64)
    row, column = divmod(9, number)
    middle = west + (column + 0.5) * side, south + (row + 0.5) * 64 * field.lattice.step_y
    assert refining.loaded_at(field, *middle) == fine and refining.loaded_at(field, east + 1e9, -1e9) == coarse
    run_import(settings, tmp_path / "first")
    assert refining.loaded_at(open_store(tmp_path / "first"), 0.0, 0.0) == coarse
    run_import(replace(settings, quick=0), store)
    assert refining.loaded_at(open_store(store), *middle) is None


@pytest.mark.thorough
def test_further_tiles_are_loaded_without_the_others(tmp_path, small_tiles, monkeypatch):
    settings, store = loaded_store(tmp_path, rough(505, 401), PLACES["north up"], (0, 9))
    made = []
    monkeypatch.setattr(tile_import, "perform", lambda *task: made.append(task[2]) or perform(*task))
    run_import(replace(settings, loaded_tiles=(0, 9, 14)), store)
    read = [task.number for task in made if task.step == "read"]
    assert read == [14], "only this one has other samples"
    run_import(settings, tmp_path / "direct")
    run_import(replace(settings, loaded_tiles=(0, 9, 14)), tmp_path / "direct")
    (arrays, text), (wanted, wanted_text) = content(store), content(tmp_path / "direct")
    assert text == wanted_text and all(np.array_equal(arrays[name], wanted[name]) for name in wanted)
    run_import(replace(settings, loaded_tiles=(9,)), store)
    run_import(settings, tmp_path / "fewer")
    run_import(replace(settings, loaded_tiles=(9,)), tmp_path / "fewer")
    (arrays, _), (wanted, _) = content(store), content(tmp_path / "fewer")
    assert all(np.array_equal(arrays[name], wanted[name]) for name in wanted)
    assert refining.loaded_tiles(open_store(store).provenance) == {9}


def test_a_complete_store_is_not_replaced_by_tiles(again, monkeypatch):
    settings, store = again

    def complete_first(*arguments):
        run_import(replace(settings, quick=0), store)
        return finish(*arguments)

    finish = build_store.report_of  # the last step before the tiles are published
    monkeypatch.setattr(build_store, "report_of", lambda *given: monkeypatch.undo() or complete_first(*given))
    with pytest.raises(TerrainError, match="has no first picture of"):
        run_import(replace(settings, loaded_tiles=(0, 9, 14)), store)
    assert "refined_m" not in open_store(store).provenance and open_store(store).lattice.width == 505


def test_a_reprojected_raster_has_tiles_in_view(tmp_path, small_tiles):
    source = write_raster(tmp_path / "a.tif", hills(505, 401), crs="EPSG:32632", transform=PLACES["north up"])
    settings, store = ImportSettings(str(source), project="EPSG:32633", quick=QUICK, holes=True), tmp_path / "store"
    for tiles in ((), (10,)):
        run_import(replace(settings, loaded_tiles=tiles), store)
    run_import(replace(settings, quick=0), tmp_path / "whole")
    field, full = open_store(store), open_store(tmp_path / "whole")
    grid = TileGrid(field.lattice, 6)
    box = grid.owned(grid.box(10))
    y, x = (
        np.rint(np.arange(few) * ((count - 1) / (few - 1)) + half).astype(int)
        for count, few, half in zip(full.samples.shape, field.samples.shape, (-1e-9, 1e-9), strict=True)
    )
    inside = slice(box.y0, box.y1 + 1), slice(box.x0, box.x1 + 1)
    true, valid = full.heights()[np.ix_(y, x)][inside], full.valid[np.ix_(y, x)][inside] > 0
    assert valid.mean() > 0.8 and np.abs(field.heights()[inside] - true)[valid].max() < 0.02
    assert field.crs == full.crs and (field.valid == 0).any()


def test_tiles_are_refused_where_heights_depend_on_all_samples(tmp_path, small_tiles):
    """Chosen heights fit the range of the loaded samples, which further samples would change."""
    source = str(write_raster(tmp_path / "a.tif", rough(505, 401), crs="EPSG:32632", transform=PLACES["north up"]))
    settings = ImportSettings(source, quick=QUICK, lowest=0.0, highest=100.0)
    run_import(settings, tmp_path / "store")
    before = (tmp_path / "store" / "store.json").read_bytes()
    with pytest.raises(TerrainError, match="depend on all samples"):
        run_import(replace(settings, loaded_tiles=(0,)), tmp_path / "store")
    assert (tmp_path / "store" / "store.json").read_bytes() == before and verify(tmp_path / "store")
