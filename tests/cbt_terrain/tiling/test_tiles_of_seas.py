# SPDX-License-Identifier: GPL-3.0-or-later
"""Mosaics with much sea, whose stores share pages: a change reads its own tiles alone, with the same bytes."""

import shutil

import pytest
from adaptive_terrain.cbt_terrain.field import shared_pages, store
from adaptive_terrain.cbt_terrain.field.store import read_json
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from mosaic_files import EAST, NORTH, UTM32, sheet
from tiled_stores import CountingCrew, assert_same, tiled  # noqa: F401

BITS, SIDE, STEP = 7, 128, 10.0  # tiles are larger than the 88 samples around them that their errors depend on
COLUMNS, ROWS = 4, 3


def write_sea(folder, name, column, row, island=0.0):
    """Write a file of sea at 0, with an island of 10 x 10 samples of so many metres."""
    part = sheet(UTM32, EAST + STEP * SIDE * column, NORTH - STEP * SIDE * row, STEP, STEP, SIDE, SIDE)
    part.heights[:] = 0.0
    part.heights[60:70, 60:70] = island
    part.write(folder / f"{name}.tif")


@pytest.fixture
def seas(tmp_path, tiled, monkeypatch):  # noqa: F811
    """Return a folder with the files and the store of a first import, which shares pages."""
    monkeypatch.setattr(shared_pages, "MIN_SAVED", 0)
    for row in range(ROWS):
        for column in range(COLUMNS):
            island = {(0, COLUMNS - 1): 3000.0, (1, 1): 40.0}.get((row, column), 0.0)
            write_sea(tmp_path / "tiles", f"a{row}{column}", column, row, island)
    tiled(BITS)
    run_mosaic_import(ImportSettings(str(tmp_path / "tiles")), tmp_path / "store")
    assert read_json(tmp_path / "store")["shared"] == ["error", "ranges"]
    return tmp_path


def imported_again(seas, tiled):  # noqa: F811
    """Import again, and compare with a complete import; return what the second one has read and measured."""
    settings, crew = ImportSettings(str(seas / "tiles")), CountingCrew()
    run_mosaic_import(settings, seas / "store", crew=crew)
    tiled(None)
    run_mosaic_import(settings, seas / "whole")
    assert_same(seas / "store", seas / "whole")
    assert "shared" in read_json(seas / "store")
    return crew


def test_tiles_away_from_a_replaced_file_stay(seas, tiled):  # noqa: F811
    write_sea(seas / "tiles", "a11", 1, 1, island=90.0)
    crew = imported_again(seas, tiled)
    assert crew.read == crew.measured == [0, 1, 2, 4, 5, 6, 8, 9, 10], "those that meet the file or its neighbours"


def test_a_sea_that_grows_keeps_its_tiles(seas, tiled):  # noqa: F811
    for row in range(ROWS):
        write_sea(seas / "tiles", f"b{row}", COLUMNS, row)
    assert imported_again(seas, tiled).read == [row * 5 + column for row in range(ROWS) for column in (3, 4)]


@pytest.mark.parametrize("name", ["error_pages", "error_places"])
def test_damaged_pages_are_not_used_again(seas, tiled, name):  # noqa: F811
    [file] = seas.glob(f"store/data-*/{name}.npy")
    text = bytearray(file.read_bytes())
    text[len(text) // 2] ^= 1
    file.write_bytes(text)
    write_sea(seas / "tiles", "a11", 1, 1, island=90.0)
    assert len(imported_again(seas, tiled).read) == COLUMNS * ROWS


def kill_while_publishing(seas, monkeypatch):
    """Import anew, but end when the shared pages are written and the store is not published yet."""
    shutil.rmtree(seas / "store")
    with monkeypatch.context() as patch:
        patch.setattr(store, "check_version", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            run_mosaic_import(ImportSettings(str(seas / "tiles")), seas / "store")


def test_a_killed_publication_is_continued(seas, tiled, monkeypatch):  # noqa: F811
    kill_while_publishing(seas, monkeypatch)
    assert len(list(seas.glob("store/data-*/error*.npy"))) == 3
    assert imported_again(seas, tiled).read == []
    assert not list(seas.glob("store/data-*/error.npy"))


def test_pages_of_a_killed_publication_do_not_stay(seas, tiled, monkeypatch):  # noqa: F811
    """The import goes on, but nothing is shared any more."""
    kill_while_publishing(seas, monkeypatch)
    monkeypatch.setattr(shared_pages, "MIN_SAVED", 1 << 30)
    run_mosaic_import(ImportSettings(str(seas / "tiles")), seas / "store")
    assert "shared" not in read_json(seas / "store")
    assert not [*seas.glob("store/data-*/*_pages.npy"), *seas.glob("store/data-*/*_places.npy")]
