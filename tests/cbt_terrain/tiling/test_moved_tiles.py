# SPDX-License-Identifier: GPL-3.0-or-later
"""Mosaics that grow: tiles of the store before are used again, and the arrays are those of a complete import."""

import json
import shutil

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.importing import import_work
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from adaptive_terrain.cbt_terrain.tiling import tile_steps, tile_work
from mosaic_files import DEGREES, EAST, NORTH, UTM32, moved, sheet
from tiled_stores import CountingCrew, assert_same, tiled  # noqa: F401

BITS, SIDE, STEP = 7, 128, 10.0  # tiles are larger than the 88 samples around them that their errors depend on
COLUMNS, ROWS = 4, 3  # of files with SIDE samples a side, so the last tiles end one sample earlier


def write_file(folder, name, column, row, side=SIDE, gap=None, peak=None, shift=0.0):
    """Write a file at a column and a row, in the order of the north, of the mosaic. gap: rows and columns without data.

    peak: height of one sample; a lower and a higher one keep the limits of all heights when further files come.
    """
    part = sheet(UTM32, EAST + STEP * SIDE * column, NORTH - STEP * SIDE * row, STEP, STEP, side, side, shift=shift)
    if gap is not None:
        part.heights[gap] = np.nan
    if peak is not None:
        part.heights[60, 60], part.heights[60, 61] = peak, -peak
    part.write(folder / f"{name}.tif")


def write_first(folder, **more):
    """Write the files of the first import."""
    for row in range(ROWS):
        for column in range(COLUMNS):
            write_file(folder, f"a{row}{column}", column, row, peak=3000.0 if (row, column) == (1, 2) else None, **more)


class Growth:
    """Imports a mosaic, then again after a change; `measured` has the tiles whose errors the second import measured."""

    def __init__(self, tmp_path, tiled, monkeypatch):  # noqa: F811
        self.files, self.store, self.whole = tmp_path / "tiles", tmp_path / "store", tmp_path / "whole"
        self.crew, self.measured = CountingCrew(), []
        self._switch, exact = tiled, tile_steps.exact_errors

        def counted(tile, threads):
            row, column = tile.box.y0 >> BITS, tile.box.x0 >> BITS
            self.measured.append(row * tile.grid.columns + column)
            return exact(tile, threads)

        monkeypatch.setattr(tile_steps, "exact_errors", counted)

    def run(self, change, **more):
        settings = ImportSettings(str(self.files), **more)
        self._switch(BITS)
        if not self.store.exists():
            run_mosaic_import(settings, self.store)
        change()
        self.measured.clear()
        run_mosaic_import(settings, self.store, crew=self.crew)
        measured = [*self.measured]
        self._switch(None)
        run_mosaic_import(settings, self.whole)
        self.measured = measured  # without the tile of the whole raster
        assert_same(self.store, self.whole)


@pytest.fixture
def growth(tmp_path, tiled, monkeypatch):  # noqa: F811
    return Growth(tmp_path, tiled, monkeypatch)


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """Return a folder with the first files and the store of their import."""
    folder = tmp_path_factory.mktemp("first")
    write_first(folder / "tiles")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(import_work, "TILE_BITS", BITS)
        run_mosaic_import(ImportSettings(str(folder / "tiles")), folder / "store")
    return folder


@pytest.fixture
def begun(growth, first):
    """Return the growth of a mosaic whose first files are imported; a test may add files, but change none."""
    growth.files, before = first / "tiles", {*(first / "tiles").iterdir()}
    shutil.copytree(first / "store", growth.store)
    yield growth
    for file in {*growth.files.iterdir()} - before:
        file.unlink()


def numbers(columns, tiles):
    """Return the numbers of tiles from their columns and rows. columns: of the raster."""
    return sorted(row * columns + column for column, row in tiles)


def test_files_in_the_east_leave_western_tiles(begun):
    begun.run(lambda: [write_file(begun.files, f"b{row}", COLUMNS, row) for row in range(ROWS)])
    changed = numbers(5, [(column, row) for row in range(3) for column in (3, 4)])
    assert (begun.crew.read, sorted(begun.measured)) == (changed, changed)


@pytest.mark.thorough
def test_files_in_the_north_leave_southern_tiles(begun):
    begun.run(lambda: [write_file(begun.files, f"b{column}", column, -1) for column in range(COLUMNS)])
    changed = numbers(4, [(column, row) for row in (2, 3) for column in range(4)])
    assert (begun.crew.read, sorted(begun.measured)) == (changed, changed)


@pytest.mark.thorough
def test_files_in_the_west_renumber_tiles(begun):
    begun.run(lambda: [write_file(begun.files, f"b{row}", -1, row) for row in range(ROWS)])
    # the last column is measured: its padding is different
    assert begun.crew.read == numbers(5, [(column, row) for row in range(3) for column in (0, 1)])
    assert sorted(begun.measured) == numbers(5, [(column, row) for row in range(3) for column in (0, 1, 4)])


def test_a_single_tile_becomes_one_of_two(growth):
    side = 1 << BITS
    sheet(UTM32, EAST, NORTH, 10.0, 10.0, side + 1, side + 1).write(growth.files / "a.tif")

    def change():
        sheet(UTM32, EAST + 10.0 * (side + 1), NORTH, 10.0, 10.0, side, side + 1).write(growth.files / "b.tif")

    growth.run(change)
    assert (growth.crew.read, growth.measured) == ([0, 1], [0, 1])


INNER = (2, 2), (3, 2)


def test_files_in_the_south_west_renumber_tiles(begun):
    begun.run(lambda: write_file(begun.files, "b", -1, ROWS))
    assert begun.crew.read == numbers(5, [*((column, 0) for column in range(5)), (0, 1), (0, 2), (0, 3), (1, 1)])
    # the padding of the last column and the last row is different
    assert sorted(begun.measured) == numbers(5, [(c, r) for r in range(4) for c in range(5) if (c, r) not in INNER])


@pytest.mark.thorough
def test_an_inner_part_of_a_tile_in_the_west_moves_all(begun):
    begun.run(lambda: [write_file(begun.files, f"b{row}", -0.5, row) for row in range(ROWS)])
    assert len(begun.crew.read) == len(begun.measured) == 15


@pytest.mark.thorough
@pytest.mark.parametrize("more", [{}, pytest.param({"holes": True}, marks=pytest.mark.thorough)])
def test_gaps_and_a_changed_file_while_a_mosaic_grows(growth, more):
    write_first(growth.files, gap=(slice(50, 90), slice(20, 70)))

    def change():
        write_file(growth.files, "a00", 0, 0, shift=3.0)
        write_file(growth.files, "b1", COLUMNS, 1, gap=(slice(0, 30), slice(90, 128)))

    growth.run(change, **more)


@pytest.mark.thorough
def test_holes_leave_tiles_far_from_them(growth):
    write_first(growth.files)
    write_file(growth.files, "a11", 1, 1, gap=(slice(40, 80), slice(40, 80)))

    def change():
        write_file(growth.files, "a02", 2, 0, shift=1.0)
        [write_file(growth.files, f"b{row}", COLUMNS, row) for row in range(ROWS)]

    growth.run(change, holes=True)
    north, south = numbers(5, [(column, 2) for column in range(1, 5)]), numbers(5, [(0, 0), (1, 0), (2, 0)])
    assert set(growth.crew.read) >= set(numbers(5, [(3, 0), (4, 0), (1, 1), (2, 2)]))
    assert not set(growth.crew.read) & set(south)
    assert set(north) <= set(growth.measured) and not set(growth.measured) & set(south)


@pytest.mark.thorough
def test_a_mosaic_without_its_last_column(growth):
    write_first(growth.files)
    growth.run(lambda: [(growth.files / f"a{row}3.tif").unlink() for row in range(ROWS)])
    assert len(growth.crew.read) == 3


@pytest.mark.thorough
def test_a_lower_peak_while_a_mosaic_grows(growth):
    write_first(growth.files)

    def change():
        write_file(growth.files, "a12", 2, 1)
        write_file(growth.files, "b", COLUMNS, 0)

    growth.run(change)


@pytest.mark.thorough
def test_a_mosaic_in_degrees_grows_north(growth):
    """Its step in metres changes with the latitude of its middle."""
    west, north = map(float, moved(UTM32, DEGREES, EAST, NORTH))

    def write(name, row):
        part = sheet(DEGREES, west, north - row * SIDE * 1e-4, 1.3e-4, 1e-4, 3 * SIDE, SIDE)
        part.write(growth.files / f"{name}.tif")

    for row in range(3):
        write(f"a{row}", row)
    growth.run(lambda: write("b", -1))
    assert growth.crew.read == numbers(3, [(column, row) for row in (2, 3) for column in range(3)])


@pytest.mark.parametrize(
    "name",
    ["samples.npy", *(pytest.param(name, marks=pytest.mark.thorough) for name in ("tiles.jsonl", "error.npy"))],
)
def test_damaged_stores_give_no_tiles_to_a_larger_one(begun, name):
    def change():
        [file] = begun.store.glob(f"data-*/{name}")
        text = bytearray(file.read_bytes())
        text[len(text) // 2] ^= 1
        file.write_bytes(text)
        write_file(begun.files, "b", COLUMNS, 0)

    begun.run(change)
    assert len(begun.crew.read) == len(begun.measured) == 15


RARE = "none", [1.0], [1e300, -1e300], ["a", 0.0]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "corner",
    [[float("nan"), 0.0], [5.0, 5.0], *(pytest.param(corner, marks=pytest.mark.thorough) for corner in RARE)],
)
def test_an_impossible_corner_of_a_store_is_harmless(begun, corner):
    def change():
        [file] = begun.store.glob("data-*/work.json")
        content = json.loads(file.read_text()) | {"corner": corner}
        del content["sum"]
        file.write_text(json.dumps(content | {"sum": tile_work._sum_of(content)}))
        write_file(begun.files, "b", COLUMNS, 0)

    begun.run(change)
    assert len(begun.crew.read) == len(begun.measured) == 15
