# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores of which some tiles are loaded: their samples, bounds, marks, and the complete import after them."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.attributes import sizing
from adaptive_terrain.cbt_terrain.attributes.tiling import Tiling
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
from adaptive_terrain.cbt_terrain.view.view import View
from mosaic_files import EAST, NORTH, UTM32, sheet
from rasterio.transform import Affine, from_origin
from rasters import hills, write_raster
from tiled_stores import content

QUICK = 4000
PLACES = {
    "north up": Affine(10, 0, 5e5, 0, -10, 5e6),
    "south first": Affine(10, 0, 5e5, 0, 12, 5e6),
    "columns along y": Affine(0, 8, 5e5, 10, 0, 5e6),
}


@pytest.fixture
def small_tiles(monkeypatch):
    """Make tiles of 64 x 64 cells, and four cells of one of the first picture along each side."""
    monkeypatch.setattr(refining, "BITS", 6)
    monkeypatch.setattr(refining, "FACTOR", 4)
    monkeypatch.setattr(refining, "FEWEST", 1)
    monkeypatch.setattr(tile_import, "TILED_SAMPLES", 10_000)


def rough(width, height):
    """Return hills with noise, so that no error is 0."""
    noise = np.random.default_rng(5).normal(0.0, 3.0, (height, width))
    return (hills(width, height) + noise).astype(np.float32)


def loaded_store(folder, heights, place, tiles, run=run_import, holes=False, **options):
    """Return the settings and the store of a raster with some loaded tiles."""
    source = str(write_raster(folder / "a.tif", heights, crs="EPSG:32632", transform=place, tiled=True))
    settings = ImportSettings(source, quick=QUICK, holes=holes)
    run(settings, folder / "store")
    run(replace(settings, loaded_tiles=tiles), folder / "store", **options)
    return settings, folder / "store"


def interpolated(nodes, factor):
    """Return a surface between samples, float32 [rows * factor + 1, columns * factor + 1]."""
    for _ in (0, 1):
        low, high = nodes[:-1].astype(np.float64), nodes[1:].astype(np.float64)
        parts = [low * (1 - k / factor) + high * (k / factor) for k in range(factor)]
        nodes = np.concatenate([np.stack(parts, axis=1).reshape(-1, nodes.shape[1]), nodes[-1:]]).T
    return nodes.astype(np.float32)


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_loaded_tiles_are_true_and_others_the_first_picture(tmp_path, small_tiles, place):
    heights = rough(505, 401)
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


@pytest.mark.parametrize(("tiles", "heights"), [((9,), rough), ((0, 6, 7), rough), ((15,), rough), ((6, 9), holed)])
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


def test_a_complete_import_has_no_trace_of_loaded_tiles(tmp_path, small_tiles, monkeypatch):
    settings, store = loaded_store(tmp_path, rough(505, 401), PLACES["north up"], (0, 9))
    monkeypatch.setattr(tile_import, "TILED_SAMPLES", 1 << 60)
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


def test_other_stores_have_no_tiles_to_load(tmp_path, small_tiles):
    settings, store = loaded_store(tmp_path, rough(505, 401), PLACES["north up"], (0,))
    for folder, wrong in ((tmp_path / "none", settings), (store, replace(settings, quick=300))):
        with pytest.raises(TerrainError, match="has no first picture of"):
            run_import(replace(wrong, loaded_tiles=(1,)), folder)


def camera_at(x, y, z):
    """Return the view of a camera that looks down from a point of the world."""
    to_camera = np.eye(4)
    to_camera[:3, 3] = -x, -y, -z
    zoom = np.diag([2.0, 2.0, -1.0, 0.0])
    zoom[3, 2] = -1.0
    return View(to_camera, zoom, (640, 640), clip=(0.1, 1e6))


def test_views_need_the_tiles_below_them(tmp_path, small_tiles):
    source = str(write_raster(tmp_path / "a.tif", rough(505, 401), transform=from_origin(0, 0, 10, 10)))
    run_import(ImportSettings(source, quick=QUICK), tmp_path / "store")
    field = open_store(tmp_path / "store")
    west, south, _, _ = field.lattice.rectangle()
    high = field.max_height + 100.0
    above = camera_at(west + 700.0, south + 2000.0, high)
    columns = -(-4 * field.lattice.cells_x // 64)

    def seen(*views, **more):
        return refining.seen_tiles(field, refining.SeenLand(views, np.eye(4), **more))

    below = seen(above)
    assert columns in below and len(below) <= 4, "the view is some 100 m wide"
    assert seen(camera_at(0.0, 0.0, 1e6)) == (), "no error is as large as a pixel"
    every = seen(camera_at(0.0, 0.0, 6000.0))
    assert len(every) == columns * -(-4 * field.lattice.cells_y // 64)
    assert seen(camera_at(0.0, 0.0, 6000.0), error_px=1e9) == () and seen() == ()
    wanted = refining.SeenLand([above], np.eye(4))
    assert refining.seen_tiles(field, wanted, frozenset(below[:1])) == below[1:], "loaded ones are left out"


@pytest.fixture
def field(tmp_path, small_tiles, monkeypatch):
    """Return a first picture of a slope of 2,400 m. Its squares are looked at as a whole and in cells of 4 samples."""
    heights = rough(505, 401) + np.linspace(0.0, 2400.0, 505, dtype=np.float32)
    source = str(write_raster(tmp_path / "a.tif", heights, transform=from_origin(0, 0, 10, 10)))
    run_import(ImportSettings(source, quick=QUICK), tmp_path / "store")
    monkeypatch.setattr(refining, "SQUARES", 1)
    monkeypatch.setattr(refining, "NEAR_BITS", 2)
    return open_store(tmp_path / "store")


def ground_at(field, x, y):
    """Return the height of the sample that is nearest to a point."""
    west, south, _, _ = field.lattice.rectangle()
    row, column = round((y - south) / field.lattice.step_y), round((x - west) / field.lattice.step_x)
    return float(field.heights(slice(None), slice(None))[row, column])


def needs_from(field, views, placement):
    [needs] = refining.errors_in_view(field, 16, [refining.SeenLand(views, placement)])
    return needs


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_needs_near_an_eye_are_by_the_distance_of_the_ground(field, monkeypatch, scale):
    """Needs are at most those of whole squares, and at least those of boxes half as large as the cells."""
    rng, lattice = np.random.default_rng(3), field.lattice
    west, south, east, north = lattice.rectangle()
    counts = -(-lattice.cells_x // 2), -(-lattice.cells_y // 2)
    boxes = sizing.boxes(Tiling(*counts, west, south, 2 * lattice.step_x, 2 * lattice.step_y, 0.0), field, 1.0, 0.0)
    errors = refining._largest_errors(field, refining._centre_codes(field), 2).ravel()
    lower, placement = 0, np.diag([scale, scale, scale, 1.0])
    for _ in range(40):
        x, y = rng.uniform((west, south), (east, north))
        view = camera_at(x * scale, y * scale, scale * (ground_at(field, x, y) + rng.uniform(-50.0, 700.0)))
        needs = needs_from(field, [view], placement)
        with monkeypatch.context() as patch:
            patch.setattr(refining, "NEAR_BITS", 30)
            whole = needs_from(field, [view], placement)
        pixels = sizing.footprints(boxes, [view], placement, only_seen=True, nearest=10.0)
        found = np.zeros_like(needs)
        rows, columns = np.divmod(np.arange(len(boxes)), counts[0])
        np.maximum.at(found, (rows // 8, columns // 8), np.nan_to_num(errors / pixels))
        assert np.isfinite(whole).all() and (needs <= whole).all() and (needs >= found * (1 - 1e-9)).all()
        lower += int((needs < 0.5 * whole).sum())
    assert lower > 30, "the box of a square encloses much air"


def test_an_eye_in_a_square_has_the_need_of_the_finest_step(field):
    """The need there is that at a distance of 10 m, the step of all samples."""
    west, south, east, north = field.lattice.rectangle()
    x, y = 0.5 * (west + east), 0.5 * (south + north)
    view = camera_at(x, y, ground_at(field, x, y) + 0.01)
    needs, largest = needs_from(field, [view], np.eye(4)), refining._centre_codes(field)
    per_pixel = 10.0 / view.pixels_per_unit
    assert 0.0 < needs.max() <= field.table[0][largest.max()] / per_pixel * (1 + 1e-9)
    assert needs.max() > 0.1 * field.table[0][largest.max()] / per_pixel


def test_an_eye_high_above_a_slope_needs_few_tiles(field):
    """It is 600 m above the ground, and in the box of a square that is 1,280 m long and rises by 600 m and more."""
    west, south, east, north = field.lattice.rectangle()
    x, y = west + 0.4 * (east - west), 0.5 * (south + north)
    seen = refining.SeenLand([camera_at(x, y, ground_at(field, x, y) + 600.0)], np.eye(4))
    highest = max(needs.max() for needs in refining.errors_in_view(field, 16, [seen]))
    exact = refining._centre_codes(field).max()
    assert highest <= field.table[0][exact] / (300.0 / seen.views[0].pixels_per_unit), (
        "the ground is 300 m away or more"
    )


def test_tiles_with_all_samples_need_no_complete_import(tmp_path, small_tiles):
    """A step of four samples is that of the tiles: a camera on the ground then needs its tiles only."""
    source = str(write_raster(tmp_path / "a.tif", rough(505, 401), transform=from_origin(0, 0, 10, 10)))
    settings, store = ImportSettings(source, quick=13_000), tmp_path / "store"
    run_import(settings, store)
    picture = open_store(store)
    assert refining.are_all_samples(picture)
    land = refining.SeenLand([camera_at(0.0, 0.0, ground_at(picture, 0.0, 0.0) + 2.0)], np.eye(4))
    wanted = refining.missing_tiles(store, land)
    assert 0 < len(wanted) < refining.picture_tiles(picture) / 4
    assert not refining.is_fine_enough(store, [land])
    run_import(replace(settings, loaded_tiles=wanted), store)
    assert refining.is_fine_enough(store, [land]) and refining.are_loaded_enough(store, [land])
    assert refining.needed_tiles(store, [land]) == set(wanted)


def test_detail_is_that_of_the_loaded_tile_at_a_point(tmp_path, small_tiles):
    settings, store = loaded_store(tmp_path, rough(505, 401), PLACES["north up"], (9,))
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


def test_views_that_tiles_satisfy_need_no_more(tmp_path, small_tiles, monkeypatch):
    settings, store = loaded_store(tmp_path, rough(505, 401), PLACES["north up"], (0,))
    west, south, _, _ = open_store(store).lattice.rectangle()
    near = refining.SeenLand([camera_at(west + 700.0, south + 2000.0, 1500.0)], np.eye(4))
    far = near._replace(error_px=1e4)
    assert not refining.is_fine_enough(store, [near]) and refining.is_fine_enough(store, [far])
    assert not refining.is_fine_enough(store, [far, near]), "one of them needs more"
    assert not refining.missing_tiles(store, far), "none is missing there"
    wanted = refining.missing_tiles(store, near)
    assert wanted and 0 not in wanted
    assert refining.all_missing_tiles(store, [far, near]) == wanted
    run_import(settings, tmp_path / "first")
    assert refining.is_fine_enough(tmp_path / "first", [far]), "a large source is not imported for a distant view"
    assert not refining.is_fine_enough(tmp_path / "first", [far, near])
    monkeypatch.setattr(refining, "FEWEST", 1 << 29)
    assert not refining.is_fine_enough(tmp_path / "first", [far]), "all of a smaller one are soon there"


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


def test_a_complete_store_is_not_replaced_by_tiles(tmp_path, small_tiles, monkeypatch):
    settings, store = loaded_store(tmp_path, rough(505, 401), PLACES["north up"], (0,))

    def complete_first(*arguments):
        run_import(replace(settings, quick=0), store)
        return finish(*arguments)

    finish = build_store.report_of  # the last step before the tiles are published
    monkeypatch.setattr(build_store, "report_of", lambda *given: monkeypatch.undo() or complete_first(*given))
    with pytest.raises(TerrainError, match="has no first picture of"):
        run_import(replace(settings, loaded_tiles=(0, 9)), store)
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
