# SPDX-License-Identifier: GPL-3.0-or-later
"""Tiles that several processes read ahead of an import: the same store, and damaged or foreign files are not used."""

from dataclasses import replace

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.store_folder import named_folder
from adaptive_terrain.cbt_terrain.importing import read_ahead, refining, tile_tasks
from adaptive_terrain.cbt_terrain.importing.build_store import run_import
from adaptive_terrain.cbt_terrain.importing.read_ahead import find_ahead, share_of
from adaptive_terrain.cbt_terrain.importing.tile_import import FILL, READ_TILES, ImportPart
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.tiling.tile_grid import TileGrid
from mosaic_files import EAST, NORTH, UTM32, sheet
from rasterio.transform import from_origin
from rasters import hills, write_raster
from tiled_stores import content

QUICK, TILES = 4000, (0, 6, 9, 14)


@pytest.fixture(autouse=True)
def small_tiles(monkeypatch):
    """Make tiles of 64 x 64 cells, and four cells of one of the first picture along each side."""
    for name, value in (("BITS", 6), ("FACTOR", 4), ("FEWEST", 1)):
        monkeypatch.setattr(refining, name, value)


def one_file(folder):
    """Write a height map with a gap in a loaded tile; return the settings of its quick import."""
    heights = hills(505, 401) + np.random.default_rng(5).normal(0.0, 3.0, (401, 505)).astype(np.float32)
    heights[330:360, 40:90] = np.nan
    place = from_origin(5e5, 5e6, 10, 10)
    source = write_raster(folder / "a.tif", heights, crs="EPSG:32632", transform=place, tiled=True)
    return ImportSettings(str(source), quick=QUICK, holes=True)


def several_files(folder):
    """Write four files that meet; return the settings of their quick import."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, 505, 401)
    for number, (row, column) in enumerate(((0, 0), (0, 250), (200, 0), (200, 250))):
        part = {"first_row": row, "rows": 201, "first_column": column, "columns": 255 if column else 250}
        whole.write(folder / f"t{number}.tif", **part)
    more = tuple(str(folder / f"t{n}.tif") for n in (1, 2, 3))
    return ImportSettings(str(folder / "t0.tif"), more_sources=more, quick=QUICK)


def read(run, settings, store, tiles):
    return run(settings, store, part=ImportPart(READ_TILES, tiles))


@pytest.mark.parametrize(("write", "run"), [(one_file, run_import), (several_files, run_mosaic_import)])
def test_tiles_read_ahead_give_the_same_store(tmp_path, write, run, monkeypatch):
    quick = write(tmp_path)
    settings = replace(quick, loaded_tiles=TILES)
    for name in ("store", "direct"):
        run(quick, tmp_path / name)
    run(settings, tmp_path / "direct")
    assert read(run, settings, tmp_path / "store", ()) == {"tiles": 16, "done": 0}
    if run is run_mosaic_import:
        assert (named_folder(tmp_path / "store") / "catalogue.json").exists(), "processes that follow read no headers"
    for part in (1, 2):
        assert read(run, settings, tmp_path / "store", share_of(TILES, part, 2))["done"] == 2
    units = []
    of_source = tile_tasks._read_heights
    monkeypatch.setattr(tile_tasks, "_read_heights", lambda *unit: units.append(unit[2]) or of_source(*unit))
    assert read(run, settings, tmp_path / "store", TILES)["done"] == 4 and units == [], "they are not read again"
    run(settings, tmp_path / "store")
    assert not set(units) & set(TILES) and len(units) == 12
    (arrays, text), (wanted, wanted_text) = content(tmp_path / "store"), content(tmp_path / "direct")
    assert text == wanted_text and all(np.array_equal(arrays[name], wanted[name]) for name in wanted)
    assert not (tmp_path / "store" / "ahead").exists()


def damaged(file, change):
    """Change the bytes of a file by a function of a bytearray."""
    content = bytearray(file.read_bytes())
    change(content)
    file.write_bytes(content)


DAMAGE = {
    "cut": lambda content: content.__delitem__(slice(-1, None)),
    "longer": lambda content: content.append(0),
    "a height": lambda content: content.__setitem__(-7, content[-7] ^ 64),
    "the record": lambda content: content.__setitem__(40, content[40] ^ 1),
    "empty": lambda content: content.clear(),
}


@pytest.mark.parametrize(
    "change",
    [pytest.param(DAMAGE[name], marks=[] if name == "a height" else pytest.mark.thorough) for name in DAMAGE],
    ids=DAMAGE,
)
def test_a_damaged_tile_is_read_from_its_source(tmp_path, change):
    quick = one_file(tmp_path)
    settings = replace(quick, loaded_tiles=TILES)
    for name in ("store", "direct"):
        run_import(quick, tmp_path / name)
    run_import(settings, tmp_path / "direct")
    read(run_import, settings, tmp_path / "store", TILES)
    damaged(tmp_path / "store" / "ahead" / "6.tile", change)
    (tmp_path / "store" / "ahead" / "9.tile").unlink()
    (tmp_path / "store" / "ahead" / "9.tile").symlink_to(tmp_path / "store" / "ahead" / "0.tile")
    run_import(settings, tmp_path / "store")
    arrays, wanted = content(tmp_path / "store")[0], content(tmp_path / "direct")[0]
    assert all(np.array_equal(arrays[name], wanted[name]) for name in wanted)


def test_tiles_of_other_sources_are_not_used(tmp_path):
    quick = one_file(tmp_path)
    run_import(quick, tmp_path / "store")
    read(run_import, replace(quick, loaded_tiles=TILES), tmp_path / "store", (6,))
    first = open_store(tmp_path / "store")
    grid = TileGrid(replace(first.lattice, cells_x=4 * first.lattice.cells_x, cells_y=4 * first.lattice.cells_y), 6)
    assert find_ahead(tmp_path / "store", grid, 6, "another digest") is None
    (tmp_path / "store" / "ahead" / "6.tile").rename(tmp_path / "store" / "ahead" / "7.tile")
    assert find_ahead(tmp_path / "store", grid, 7, "another digest") is None


def test_only_tiles_are_read_ahead(tmp_path):
    quick = one_file(tmp_path)
    settings = replace(quick, loaded_tiles=TILES)
    with pytest.raises(TerrainError, match="has no first picture of .*; expected one of the same files"):
        read(run_import, settings, tmp_path / "store", TILES)
    run_import(quick, tmp_path / "store")
    with pytest.raises(TerrainError, match="No part 'fill' of tiles in view can be done; expected 'read'"):
        run_import(settings, tmp_path / "store", part=ImportPart(FILL))
    assert read(run_import, settings, tmp_path / "store", (1, 6, 99)) == {"tiles": 16, "done": 1}
    user_file = tmp_path / "store" / "ahead" / "notes.txt"
    user_file.write_text("mine")
    read_ahead.remove_ahead(tmp_path / "store")
    assert list((tmp_path / "store" / "ahead").iterdir()) == [user_file]


def test_shares_are_all_tiles_once():
    tiles = {5, 3, 9, 12, 0, 7, 8}
    for parts in (1, 2, 3, 16):
        shares = [share_of(tiles, part, parts) for part in range(1, parts + 1)]
        assert sorted(sum(shares, ())) == sorted(tiles) and max(map(len, shares)) - min(map(len, shares)) <= 1
