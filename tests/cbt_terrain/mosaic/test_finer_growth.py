# SPDX-License-Identifier: GPL-3.0-or-later
"""Mosaics with finer tiles that grow: tiles of the store before are used again, with the bytes of a complete import."""

import shutil

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field import finer_heights, store_folder
from adaptive_terrain.cbt_terrain.importing import finer_import, import_work
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import RESOLUTION, ImportSettings
from finer_imports import assert_same, count_records, make_small
from mosaic_files import DEGREES, EAST, NORTH, UTM32, UTM33, moved, sheet

THOROUGH = pytest.mark.thorough
STEP, SIDE, FINEST = 32.0, 64, 2.0  # metres and samples of coarser files, and metres of finer ones
COLUMNS, ROWS = 4, 3  # of coarser files; a tile of the raster and four finer tiles are as wide as one
CITY = EAST + 3700.0, NORTH - 2800.0  # its corner in the north-west, far from the border


def make_tiles_small(patch):
    make_small(patch)
    patch.setattr(import_work, "TILE_BITS", 6)


@pytest.fixture(autouse=True)
def small(monkeypatch):
    make_tiles_small(monkeypatch)


def write_coarse(folder, name, column, row, width=SIDE, height=SIDE):
    """Write a coarser file, row 0 in the north; smaller ones keep their side next to the first files."""
    west = EAST + STEP * (SIDE * column + (SIDE - width if column < 0 else 0))
    north = NORTH - STEP * (SIDE * row + (SIDE - height if row < 0 else 0))
    sheet(UTM32, west, north, STEP, STEP, width, height).write(folder / f"{name}_{column}_{row}.tif")


def write_finer(folder, name="b_city", corner=CITY, shift=3.0, gap=False):
    """Write a finer file."""
    finer = sheet(UTM32, *corner, FINEST, FINEST, 300, 200, shift=shift)
    if gap:
        finer.heights[100:130, 200:240] = np.nan
    finer.write(folder / f"{name}.tif")


def write_first(folder, columns=COLUMNS, rows=ROWS):
    """Write the first coarser files and a city. Finer tiles depend on borders of finer files up to 168 cells away."""
    for row in range(rows):
        for column in range(columns):
            write_coarse(folder, "a", column, row)
    write_finer(folder, gap=True)


def grow(folder, direction, cells=SIDE, columns=COLUMNS, rows=ROWS):
    """Write coarser files beyond a border, last in the order: lattices begin at the first file."""
    for column in range(columns) if direction in ("north", "south") else ():
        write_coarse(folder, "c", column, -1 if direction == "north" else ROWS, height=cells)
    for row in range(rows) if direction in ("east", "west") else ():
        write_coarse(folder, "c", -1 if direction == "west" else columns, row, width=cells)


class Growth:
    """Imports a mosaic, then again after a change.

    Attributes:
        before: copy of the store of the first import.
        first: number of windows that the first import has read.
        windows: corners of those that the second one has read, in finer samples.
        counts: number of results that the second one has made, by kind of their records.
    """

    def __init__(self, tmp_path, monkeypatch):
        self.files, self.store, self.whole, self.before = (
            tmp_path / name for name in ("files", "store", "whole", "before")
        )
        self.windows, read, self._patch = [], finer_import._Windows._read, monkeypatch

        def reading(windows, *box):
            self.windows.append(box[:2])
            return read(windows, *box)

        monkeypatch.setattr(finer_import._Windows, "_read", reading)

    def run(self, change, **more):
        run_mosaic_import(settings_of(self.files, **more), self.store)
        self.first = len(self.windows)
        shutil.copytree(self.store, self.before)
        change(self.files)
        self.again(**more)
        windows = list(self.windows)
        run_mosaic_import(settings_of(self.files, **more), self.whole)
        self.windows = windows
        assert_same(self.store, self.whole)

    def again(self, **more):
        self.windows.clear()
        with self._patch.context() as patch:
            self.counts = count_records(patch)
            run_mosaic_import(settings_of(self.files, **more), self.store)


def settings_of(files, **more):
    return ImportSettings(str(files), priority=RESOLUTION, **more)


@pytest.fixture
def growth(tmp_path, monkeypatch):
    return Growth(tmp_path, monkeypatch)


@pytest.fixture(scope="module")
def grown(tmp_path_factory):
    """Return the growth of a mosaic in the west."""
    with pytest.MonkeyPatch.context() as patch:
        make_tiles_small(patch)
        growth = Growth(tmp_path_factory.mktemp("grown"), patch)
        write_first(growth.files, columns=3, rows=2)
        growth.run(lambda files: grow(files, "west", rows=2))
    return growth


def test_finer_tiles_are_kept_when_a_mosaic_grows(grown):
    assert grown.first >= 4 and grown.windows == [] and not any(grown.counts.values())


@THOROUGH
@pytest.mark.parametrize("direction", ["east", "north", "south"])
def test_finer_tiles_are_kept_in_any_direction(growth, direction):
    write_first(growth.files)
    growth.run(lambda files: grow(files, direction))
    assert growth.first >= 4 and growth.windows == [] and not any(growth.counts.values())


@pytest.mark.thorough
def test_growth_by_finer_tiles_alone_keeps_them(growth):
    """The raster's own tiles are four times as wide, and are all made again."""
    write_first(growth.files)
    growth.run(lambda files: grow(files, "west", SIDE // 4))
    assert growth.windows == [] and not any(growth.counts.values())


@THOROUGH
def test_growth_by_no_finer_tile_makes_all_again(growth):
    write_first(growth.files)
    growth.run(lambda files: grow(files, "south", SIDE // 8))
    assert len(growth.windows) == growth.counts[finer_heights.FILLED] >= 4


@pytest.mark.thorough
def test_a_finer_file_changes_while_a_mosaic_grows(growth):
    write_first(growth.files)
    write_finer(growth.files, "b_town", (CITY[0] - 2000.0, CITY[1] + 1500.0))

    def change(files):
        grow(files, "west")
        write_finer(files, shift=5.0, gap=True)

    growth.run(change)
    assert 4 <= len(growth.windows) < growth.first
    # those of the town are kept
    assert min(x for x, _ in growth.windows) >= (CITY[0] - EAST) / FINEST + SIDE * STEP / FINEST - 256


@pytest.mark.thorough
def test_a_finer_file_crosses_the_former_border(growth):
    write_first(growth.files, columns=8)
    write_finer(growth.files, "b_town", (EAST + 8 * SIDE * STEP - 400.0, CITY[1]))
    growth.run(lambda files: grow(files, "east", columns=8))
    assert 1 <= len(growth.windows) < growth.first and min(x for x, _ in growth.windows) >= 7 * SIDE * STEP / FINEST


@THOROUGH
def test_an_added_finer_file_leaves_the_others(growth):
    write_first(growth.files, columns=8)

    def change(files):
        grow(files, "west")
        write_finer(files, "b_town", (EAST + 7 * SIDE * STEP, CITY[1]))

    growth.run(change)
    assert len(growth.windows) >= 2 and min(x for x, _ in growth.windows) >= 7 * SIDE * STEP / FINEST


@pytest.mark.parametrize("damage", ["altered", pytest.param("gone", marks=THOROUGH)])
@pytest.mark.parametrize(
    "name",
    [
        "finer_heights",
        *(pytest.param(name, marks=THOROUGH) for name in ("finer_errors", "finer_ranges", "samples", "tiles", "work")),
    ],
)
def test_damaged_stores_give_the_same_bytes(grown, growth, name, damage):
    growth.files = grown.files
    shutil.copytree(grown.before, growth.store)
    [file] = store_folder.named_folder(growth.store).glob(f"{name}.*")
    if damage == "gone":
        file.unlink()
    else:
        text = bytearray(file.read_bytes())
        text[len(text) // 2] ^= 1
        file.write_bytes(text)
    growth.again()
    assert_same(growth.store, grown.whole)
    if damage == "gone":
        assert len(growth.windows) == growth.counts[finer_heights.FILLED] == grown.first


@THOROUGH
@pytest.mark.parametrize("more", [{"holes": True}, {"blend": False}])
def test_two_directions_with_gaps(growth, more):
    write_first(growth.files)

    def change(files):
        grow(files, "south")
        write_coarse(files, "c", -1, 1)

    growth.run(change, **more)
    assert growth.windows == []


@THOROUGH
def test_resampled_files_leave_finer_tiles(growth):
    """Positions in files of another system are interpolated in blocks, which do not move with the extent."""
    write_first(growth.files)
    west, north = (float(value) for value in moved(UTM32, UTM33, CITY[0] - 800.0, CITY[1] + 700.0))
    sheet(UTM33, west, north, STEP, STEP, 80, 60, shift=1.0).write(growth.files / "c_other.tif")
    growth.run(lambda files: grow(files, "west"))
    assert growth.windows == [] and not any(growth.counts.values())


@THOROUGH
def test_finer_tiles_in_degrees_are_kept_in_the_north(growth):
    """The step in metres changes with the latitude of the middle, and slopes with it."""
    west, north = (float(value) for value in moved(UTM32, DEGREES, EAST, NORTH))
    step = 3.3e-4  # no fraction of 360 degrees: else the digest of each window has the middle of all files

    def write(row):
        part = sheet(DEGREES, west, north - row * SIDE * step, step, step, 4 * SIDE, SIDE)
        part.write(growth.files / f"{'a' if row >= 0 else 'c'}_{row}.tif")

    for row in range(4):
        write(row)
    city = sheet(DEGREES, west + 100 * step, north - 100 * step, step / 16, step / 16, 400, 300, shift=2.0)
    city.write(growth.files / "b_city.tif")
    growth.run(lambda _files: write(-1))
    assert growth.windows == [] and not growth.counts[finer_heights.MEASURED]


@THOROUGH
def test_a_mosaic_that_shrinks_keeps_finer_tiles(growth):
    write_first(growth.files)
    grow(growth.files, "west")
    growth.run(lambda files: [file.unlink() for file in files.glob("c_-1_*")])
    assert growth.windows == [] and not any(growth.counts.values())


@THOROUGH
def test_a_copied_store_grows_alike(growth, tmp_path):
    write_first(growth.files)

    def change(files):
        shutil.move(growth.store, tmp_path / "moved")
        shutil.copytree(tmp_path / "moved", growth.store)
        grow(files, "south")

    growth.run(change)
    assert growth.windows == []
