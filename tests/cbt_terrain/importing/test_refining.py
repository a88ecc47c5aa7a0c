# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores of which some tiles are loaded: their samples, bounds, marks, and the complete import after them."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import hierarchy
from adaptive_terrain.cbt_terrain.field.store import open_store, verify
from adaptive_terrain.cbt_terrain.importing import refining, tile_import
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.import_process import import_source
from adaptive_terrain.cbt_terrain.importing.thinning import loaded_text
from adaptive_terrain.cbt_terrain.importing.tile_crew import ProcessCrew
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


def loaded_store(folder, heights, place, tiles, run=run_import, **options):
    """Return the settings and the store of a raster with some loaded tiles."""
    source = str(write_raster(folder / "a.tif", heights, crs="EPSG:32632", transform=place, tiled=True))
    settings = ImportSettings(source, quick=QUICK)
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


def vertices_of(lattice, level, is_centre):
    """Return all vertices of a depth of a lattice."""
    n = 1 << level
    x, y = (values.ravel() for values in np.meshgrid(*(np.arange(0, s + n, n) for s in lattice.span)))
    odd_x, odd_y = x >> level & 1, y >> level & 1
    vertices = LatticeVertices(x, y, level).chosen((odd_x & odd_y if is_centre else odd_x ^ odd_y) == 1)
    return vertices.chosen(exist(lattice, vertices))


def metres_of(field, vertices):
    return field.table[vertices.level // 2][field.error[entries_of(field.lattice, vertices)]]


@pytest.mark.parametrize("tiles", [(9,), (0, 27, 28), (55,)])
def test_bounds_hold_for_the_loaded_surface(tmp_path, small_tiles, tiles):
    _, store = loaded_store(tmp_path, rough(505, 401), PLACES["north up"], tiles)
    field = open_store(store)
    lattice = field.lattice
    true = np.zeros(lattice.node_count, np.float32)
    hierarchy.build_errors(np.ascontiguousarray(field.heights()), lattice, true, 1)
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
    for wrong, message in (
        (settings, "has no first picture"),
        (replace(settings, quick=300), "has no first picture of"),
    ):
        with pytest.raises(TerrainError, match=message):
            run_import(replace(wrong, loaded_tiles=(1,)), store)
    holes = replace(settings, holes=True)
    run_import(holes, tmp_path / "holes")
    with pytest.raises(TerrainError, match="cannot be loaded by tile"):
        run_import(replace(holes, loaded_tiles=(1,)), tmp_path / "holes")


def camera_at(x, y, z, size=(640, 640)):
    """Return the view of a camera that looks down from a point of the world."""
    to_camera = np.eye(4)
    to_camera[:3, 3] = -x, -y, -z
    zoom = np.diag([2.0, 2.0 * size[0] / size[1], -1.0, 0.0])
    zoom[3, 2] = -1.0
    return View(to_camera, zoom, size, clip=(0.1, 1e6))


def test_views_need_the_tiles_below_them(tmp_path, small_tiles):
    source = str(write_raster(tmp_path / "a.tif", rough(505, 401), transform=from_origin(0, 0, 10, 10)))
    run_import(ImportSettings(source, quick=QUICK), tmp_path / "store")
    field = open_store(tmp_path / "store")
    west, south, _, _ = field.lattice.rectangle()
    high = field.max_height + 100.0
    above = camera_at(west + 700.0, south + 2000.0, high)
    below = refining.seen_tiles(field, [above], np.eye(4))
    columns = -(-4 * field.lattice.cells_x // 64)
    assert columns in below and len(below) <= 4, "the view is some 100 m wide"
    far = refining.seen_tiles(field, [camera_at(0.0, 0.0, 1e6)], np.eye(4))
    assert far == (), "no error is as large as a pixel"
    every = refining.seen_tiles(field, [camera_at(0.0, 0.0, 6000.0)], np.eye(4))
    assert len(every) == columns * -(-4 * field.lattice.cells_y // 64)
    coarse = refining.seen_tiles(field, [camera_at(0.0, 0.0, 6000.0)], np.eye(4), error_px=1e9)
    assert coarse == () and refining.seen_tiles(field, [], np.eye(4)) == ()
