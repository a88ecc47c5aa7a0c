# SPDX-License-Identifier: GPL-3.0-or-later
"""Import by tile: the bytes of a field that is built in memory, for every kind of source."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field import cleaning
from adaptive_terrain.cbt_terrain.field.lattice import lattice_for
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.store_folder import named_folder
from adaptive_terrain.cbt_terrain.importing import drafts
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.rasters.resampled_file import ResampledFile
from adaptive_terrain.cbt_terrain.tiling import borders, tile_work
from adaptive_terrain.cbt_terrain.tiling.tile_grid import TileGrid
from adaptive_terrain.cbt_terrain.tiling.tile_work import work_in
from mosaic_files import EAST, NORTH, UTM32
from rasterio import Affine
from rasterio.transform import from_origin
from rasters import hills, write_raster
from tiled_stores import CountingCrew, assert_built, assert_same, tiled, write_tiles  # noqa: F401


def with_gaps(heights):
    heights = heights.copy()
    heights[20:75, 30:150] = heights[3, 200] = heights[-40:, -30:] = np.nan
    return heights


def spikes():
    heights = np.zeros((170, 220))
    heights[100, 100], heights[31, 65], heights[3, 200] = 300.0, 1e-3, 9e29
    return heights


MOUNTAINS = hills(210, 120)
PLANE = np.add.outer(np.arange(97.0), np.arange(131.0))
SOURCES = {
    "a power of two": (hills(257, 257), 5, {}),
    "padded": (MOUNTAINS, 5, {}),
    "other tiles": (MOUNTAINS, 6, {}),
    "tiles that end at the border": (hills(193, 161), 5, {}),
    "a strip": (hills(500, 20), 5, {}),
    "a tall strip": (hills(3, 300), 5, {}),
    "spikes": (spikes(), 5, {}),
    "a plane": (PLANE, 5, {}),
    "flat": (np.zeros((97, 131)), 5, {}),
    "filled": (with_gaps(MOUNTAINS), 5, {}),
    "holes": (with_gaps(MOUNTAINS), 5, {"holes": True}),
    "whole numbers": (MOUNTAINS.astype(np.int16), 5, {"height_scale": 0.5, "height_offset": -7.0}),
    "no data in whole numbers": (np.maximum(MOUNTAINS, 420.0).astype(np.uint16), 5, {"no_data": 420.0}),
    "numbers that floats round": (MOUNTAINS.astype(np.int16), 5, {"height_scale": 1e-3, "height_offset": 1e6}),
    "float64": (MOUNTAINS.astype(np.float64) + 1e-9, 5, {}),
    "undeclared no data": (np.where(MOUNTAINS < 400.0, -9999.0, MOUNTAINS), 5, {}),
}
FEW = "filled", "holes", "no data in whole numbers"


@pytest.mark.parametrize(
    "name", [*FEW, *(pytest.param(name, marks=pytest.mark.thorough) for name in SOURCES if name not in FEW)]
)
def test_tiles_give_the_bytes_of_a_built_field(tmp_path, tiled, monkeypatch, name):  # noqa: F811
    heights, bits, more = SOURCES[name]
    monkeypatch.setattr(cleaning, "FILLED_ROWS", 32)
    np.save(tmp_path / "a.npy", heights)
    settings = ImportSettings(str(tmp_path / "a.npy"), extent=(9000.0, 5000.0), **more)
    for store, cut in ("whole", None), ("tiled", bits):
        tiled(cut)
        run_import(settings, tmp_path / store)
    assert_same(tmp_path / "tiled", tmp_path / "whole")
    wanted = np.where(heights == more.get("no_data"), np.nan, heights)[::-1].astype(np.float64)
    wanted = wanted * more.get("height_scale", 1.0) + more.get("height_offset", 0.0)
    assert_built(open_store(tmp_path / "tiled"), wanted)


LINES = {
    (1, 1): 1,
    (2, 1): 1,
    (1, 2): 1,
    (300, 1): 10,
    (1, 300): 10,
    (300, 2): 10,
    (3, 300): 10,
}  # columns, rows: tiles


@pytest.mark.parametrize("size", LINES)
@pytest.mark.parametrize("holes", [False, pytest.param(True, marks=pytest.mark.thorough)])
def test_rasters_of_a_line_are_imported_by_tile(tmp_path, tiled, size, holes):  # noqa: F811
    tiled(5)
    heights = np.random.default_rng(3).normal(0.0, 50.0, size[::-1]).astype(np.float32)
    heights[20:24, 150:160] = np.nan
    np.save(tmp_path / "a.npy", heights)
    run_import(ImportSettings(str(tmp_path / "a.npy"), extent=(900.0, 500.0), holes=holes), tmp_path / "store")
    repeats = [2 if count == 1 else 1 for count in size]
    assert_built(open_store(tmp_path / "store"), heights[::-1].repeat(repeats[1], 0).repeat(repeats[0], 1))
    work = work_in(named_folder(tmp_path / "store"))
    assert (len(work.grid) if work else 1) == LINES[size]


def test_a_failed_import_of_one_tile_leaves_nothing(tmp_path, tiled):  # noqa: F811
    np.save(tmp_path / "a.npy", np.where(MOUNTAINS == MOUNTAINS.max(), 1e35, MOUNTAINS))
    settings, store = ImportSettings(str(tmp_path / "a.npy"), extent=(9000.0, 5000.0)), tmp_path / "store"
    for bits in (None, 5):
        tiled(bits)
        with pytest.raises(TerrainError, match="expected less than 1e30 m"):
            run_import(settings, store)
        assert store.exists() == (bits == 5), "a larger import goes on after an error"


@pytest.mark.parametrize("tasks", [0, 1])
def test_a_stopped_import_of_one_tile_leaves_nothing(tmp_path, tasks):
    np.save(tmp_path / "a.npy", MOUNTAINS)
    settings, store = ImportSettings(str(tmp_path / "a.npy"), extent=(9000.0, 5000.0)), tmp_path / "store"
    with pytest.raises(KeyboardInterrupt):
        run_import(settings, store, crew=CountingCrew(tasks))
    assert not store.exists()
    run_import(settings, store)
    [folder] = store.glob("data-*")
    assert sorted(file.name for file in folder.iterdir()) == ["error.npy", "ranges.npy", "samples.npy"]


@pytest.mark.thorough
@pytest.mark.parametrize("holes", [False, True])
def test_few_rows_at_a_time_give_the_same_bytes(tmp_path, tiled, monkeypatch, holes):  # noqa: F811
    np.save(tmp_path / "a.npy", with_gaps(MOUNTAINS))
    settings = ImportSettings(str(tmp_path / "a.npy"), extent=(9000.0, 5000.0), holes=holes)
    for store, cut in ("whole", None), ("tiled", 5):
        tiled(cut)
        run_import(settings, tmp_path / store)
        monkeypatch.setattr(borders, "ROWS", 12)
        monkeypatch.setattr(tile_work, "COPIED_ROWS", 7)
    assert_same(tmp_path / "tiled", tmp_path / "whole")


def test_few_rows_of_an_array_are_mapped_at_a_time():
    """Linux may map 2 MB for each row of pages: before, a process held most of an array of 32,768 samples a side."""
    grid = TileGrid(lattice_for(3000, 20000), 11)
    for level in range(4):
        parts = [*borders.shared_vertices(grid, level, True)]
        rows = [int(part.y.max() - part.y.min()) >> level for part in parts]
        assert borders.ROWS - 3 <= max(rows) < borders.ROWS == grid.side


ORIENTATIONS = {
    "south first": Affine(10.0, 0.0, EAST, 0.0, 10.0, NORTH),
    "east first": Affine(-10.0, 0.0, EAST, 0.0, -10.0, NORTH),
    "turned": Affine(0.0, 10.0, EAST, 10.0, 0.0, NORTH),
    "turned the other way": Affine(0.0, -10.0, EAST, 10.0, 0.0, NORTH),
}


@pytest.mark.thorough
@pytest.mark.parametrize("name", ORIENTATIONS)
def test_rows_of_any_direction_are_read_by_unit(tmp_path, tiled, monkeypatch, name):  # noqa: F811
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.rasters.raster.BLOCK_SAMPLES", 2000)
    source = write_raster(tmp_path / "a.tif", MOUNTAINS, crs=UTM32, transform=ORIENTATIONS[name])
    for store, cut in ("whole", None), ("tiled", 5):
        tiled(cut)
        run_import(ImportSettings(str(source)), tmp_path / store)
    assert_same(tmp_path / "tiled", tmp_path / "whole")


def test_a_reprojected_raster_is_read_by_unit(tmp_path, tiled, monkeypatch):  # noqa: F811
    """A killed import reads only the units that it lacks, and has the bytes of one tile."""
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.formats.gdal_source.BLOCK_ROWS", 8)
    monkeypatch.setattr("adaptive_terrain.cbt_terrain.rasters.raster.BLOCK_SAMPLES", 1000)
    source = write_raster(tmp_path / "a.tif", MOUNTAINS, crs="EPSG:4326", transform=from_origin(10.0, 50.0, 1e-4, 1e-4))
    settings, windows = ImportSettings(str(source), project="utm"), []
    whole_window = ResampledFile.window

    def window(self, first, count, *columns):
        windows.append((first, count))
        if len(windows) == kill_at:
            raise KeyboardInterrupt
        return whole_window(self, first, count, *columns)

    monkeypatch.setattr(ResampledFile, "window", window)
    tiled(None)
    kill_at = 0
    run_import(settings, tmp_path / "whole")
    all_rows = sum(count for _, count in windows)
    tiled(5)
    windows.clear()
    kill_at = 10
    with pytest.raises(KeyboardInterrupt):
        run_import(settings, tmp_path / "tiled")
    windows.clear()
    kill_at = 0
    run_import(settings, tmp_path / "tiled")
    assert 0 < sum(count for _, count in windows) < all_rows
    assert_same(tmp_path / "tiled", tmp_path / "whole")


@pytest.mark.thorough
@pytest.mark.parametrize("more", [{}, {"holes": True}, {"step": 7.0}])
def test_a_mosaic_by_tile_has_the_bytes_of_one_tile(tmp_path, tiled, more):  # noqa: F811
    write_tiles(tmp_path / "tiles")
    settings = ImportSettings(str(tmp_path / "tiles"), **more)
    for store, cut in ("whole", None), ("tiled", 5):
        tiled(cut)
        run_mosaic_import(settings, tmp_path / store)
    assert_same(tmp_path / "tiled", tmp_path / "whole")


def test_room_is_needed_for_the_bytes_that_samples_take(tmp_path, tiled, monkeypatch):  # noqa: F811
    """16-bit samples take two bytes, and a mark of missing ones; before, all counted as floats."""
    tiled(5)
    store, needed = tmp_path / "store", []
    monkeypatch.setattr(drafts, "_check_room", lambda _path, _lattice, count, _elsewhere: needed.append(count))
    for kind in ("int16", "float32"):
        heights = np.round(MOUNTAINS).astype(kind)
        run_import(ImportSettings(str(write_raster(tmp_path / f"{kind}.tif", heights))), store)
    arrays = sum((named_folder(store) / f"{name}.npy").stat().st_size for name in ("samples", "error", "ranges"))
    whole, floats = needed
    assert floats - whole == 2 * MOUNTAINS.size and floats > arrays
