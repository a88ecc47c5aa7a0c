# SPDX-License-Identifier: GPL-3.0-or-later
"""A mosaic with finer tiles is imported again after files were replaced, added or removed: only near ones are read."""

import os
import shutil
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field import finer_heights, store_folder
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.importing import finer_import
from adaptive_terrain.cbt_terrain.mosaic import insets
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
from finer_imports import assert_same, count_records, make_small
from mosaic_files import EAST, NORTH, UTM32, sheet

pytestmark = pytest.mark.thorough

CITY = EAST + 3000.0, NORTH - 2200.0  # its corner in the north-west
ACROSS, DOWN, COLUMNS, ROWS = 4, 3, 400, 380  # files of the city, and pixels of each
SIDE = 256 * 2  # finer samples of a window


@pytest.fixture(autouse=True)
def small(monkeypatch):
    make_small(monkeypatch, 4, 2)


@pytest.fixture(scope="module")
def city():
    """Return the heights of the city at 2 m, with a gap."""
    found = sheet(UTM32, *CITY, 2.0, 2.0, ACROSS * COLUMNS, DOWN * ROWS, shift=3.0)
    found.heights[500:520, 1200:1230] = np.nan
    return found


def write_part(city, folder, column, row):
    """Write one file of the city."""
    path = folder / f"b_{column}_{row}.tif"
    city.write(path, row * ROWS, ROWS, column * COLUMNS, COLUMNS)
    return path


@pytest.fixture(scope="module")
def files(city, tmp_path_factory):
    """Return the folder of the country and of all files of the city but one."""
    folder = tmp_path_factory.mktemp("files")
    sheet(UTM32, EAST, NORTH, 32.0, 32.0, 400, 300).write(folder / "a_country.tif")
    for column in range(ACROSS):
        for row in range(DOWN):
            if (column, row) != (3, 2):
                write_part(city, folder, column, row)
    return folder


@pytest.fixture(scope="module")
def first(files, tmp_path_factory):
    """Return the store of the files as they are, and the numbers of windows and blocks of seams that were read."""
    with pytest.MonkeyPatch.context() as patch:
        make_small(patch, 4, 2)
        store, counts = tmp_path_factory.mktemp("first") / "store", count_reads(patch)
        run_mosaic_import(ImportSettings(str(files)), store)
    return store, counts


def count_reads(patch):
    """Return the boxes of windows, and the blocks of seams, that imports read from now on."""
    found, read, scanned = ([], []), finer_import._Windows._read, insets.InsetBlend._find_marks

    def reading(self, *box):
        found[0].append(box)
        return read(self, *box)

    def scanning(self, row, column):
        marks = scanned(self, row, column)
        if self.records is not None:  # of the finest grid
            found[1].append((row, column))
        return marks

    patch.setattr(finer_import._Windows, "_read", reading)
    patch.setattr(insets.InsetBlend, "_find_marks", scanning)
    return found


@pytest.fixture(scope="module")
def replaced(files, city, tmp_path_factory):
    """Return another first file of the city, the store of all files with it, and the number of windows read."""
    file, store = tmp_path_factory.mktemp("file"), tmp_path_factory.mktemp("replaced") / "store"
    file = write_part(higher(city), file, 0, 0)
    with kept(files, tmp_path_factory.mktemp("kept") / "files"), pytest.MonkeyPatch.context() as patch:
        make_small(patch, 4, 2)
        shutil.copy2(file, files)
        counts = count_reads(patch)
        run_mosaic_import(ImportSettings(str(files)), store)
    return file, store, len(counts[0])


@contextmanager
def kept(files, copy):
    """Restore a folder of files with their times of modification after the block."""
    shutil.copytree(files, copy)
    yield
    for file in files.iterdir():
        file.unlink()
    shutil.copytree(copy, files, dirs_exist_ok=True)


@pytest.fixture
def again(files, first, tmp_path, monkeypatch):
    """Return a function that changes the files, imports them into a copy of the first store, and compares it.

    whole: the store of an import of the changed files alone, and the number of windows that it has read.
    """
    shutil.copytree(first[0], tmp_path / "store")

    def run(change, whole=None, **more):
        change(files)
        settings = ImportSettings(str(files), **more)
        counts = count_reads(monkeypatch)
        run_mosaic_import(settings, tmp_path / "store")
        read = tuple(map(list, counts))
        if whole is None:
            run_mosaic_import(settings, tmp_path / "whole")
            whole = tmp_path / "whole", len(counts[0]) - len(read[0])
        assert whole[1] >= len(read[0])
        assert_same(tmp_path / "store", whole[0])
        return read

    with kept(files, tmp_path / "kept"):
        yield run


def higher(city, metres=1.0):
    """Return the city with other heights."""
    return type(city)(city.crs, city.west, city.north, city.step_x, city.step_y, city.heights + metres)


def test_the_first_import_reads_every_window_once(first):
    windows, blocks = first[1]
    assert len(windows) == len(set(windows)) >= 12 and len(blocks) == len(set(blocks)) >= 6


def test_one_replaced_file_is_read_with_its_borders(first, replaced, again):
    windows, blocks = again(lambda folder: shutil.copy2(replaced[0], folder), replaced[1:])
    # The file has 400 x 380 pixels of the grid, and the windows 512 x 512.
    assert 1 <= len(windows) <= 6 < len(first[1][0]) / 2 and len(blocks) <= 4
    x, y = (np.array([box[axis] for box in windows]) for axis in (0, 1))
    assert np.ptp(x) <= 2 * SIDE and np.ptp(y) <= SIDE


def test_other_gaps_change_the_rings_around(again, city):
    gaps = higher(city, 0.0)
    gaps.heights[100:160, 200:260] = np.nan
    windows, _ = again(lambda folder: write_part(gaps, folder, 0, 0))
    assert windows


def test_an_added_file_changes_the_numbers_of_tiles(first, again, city):
    windows, _ = again(lambda folder: write_part(city, folder, 3, 2))
    assert windows


def test_a_removed_file_leaves_its_tiles(first, again):
    assert again(lambda folder: (folder / "b_0_2.tif").unlink())[0]


def test_another_scale_reads_everything_but_seams(first, again):
    windows, blocks = again(lambda _folder: None, height_scale=2.0)
    assert len(windows) == len(first[1][0]) and not blocks


@pytest.mark.parametrize("done", [0.1, 0.6])
def test_a_stopped_import_goes_on_with_both_stores(first, replaced, again, tmp_path, monkeypatch, done):
    def change(folder):
        shutil.copy2(replaced[0], folder)
        total = sum(counts_of(first[0]).values())
        with monkeypatch.context() as patch:
            count_records(patch, stop_after=int(done * total))
            patch.setattr(finer_import._WorkRecords, "_write_again", counting_again(patch, int(done * total)))
            with pytest.raises(KeyboardInterrupt):
                run_mosaic_import(ImportSettings(str(folder)), tmp_path / "store")

    windows, _ = again(change, replaced[1:])
    assert len(windows) <= 6


def counts_of(store):
    """Return the numbers of records of a store by kind."""
    text = next(store_folder.named_folder(store).glob("tiles.jsonl")).read_text()
    return {kind: text.count(f'"{kind}"') for kind in (finer_heights.FILLED, finer_heights.MEASURED)}


def counting_again(patch, stop_after):
    """Return a method that writes records of an earlier store, and stops after some."""
    write, left = finer_import._WorkRecords._write_again, [stop_after]

    def writing(self, *record):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        write(self, *record)

    return writing


KILLED = """
import os, signal, sys
from pathlib import Path
from adaptive_terrain.cbt_terrain.field import finer_build, finer_heights
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.importing import finer_import
from adaptive_terrain.cbt_terrain.mosaic import finer_plan
from adaptive_terrain.cbt_terrain.mosaic.import_child import run_mosaic_import
from adaptive_terrain.cbt_terrain.rasters.raster import ImportSettings
source, store, event, name, count = sys.argv[1:]
finer_plan.FEWEST, finer_build.BLOCK, finer_heights.WINDOW, finer_import.WINDOW = 1 << 20, 4, 2, 2
left = int(count)
def kill(found, values):
    global left
    if found == event and (str(values[0]).endswith(name) if name else store in str(values[0])):
        left -= 1
        if not left:
            os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(kill)
run_mosaic_import(ImportSettings(source), Path(store))
"""
MOMENTS = {  # event of Python, end of the file's name ("": any file of the store), and its number
    "the arrays of the earlier store are copied": ("open", "ranges.npy", 2),
    "records are written": ("open", "", 150),
    "the last records are written": ("open", "", 450),
    "the new version is complete": ("os.rename", "store.json", 1),
    "the new version counts": ("os.remove", "borders.npy", 1),
    "the earlier arrays are removed": ("os.remove", "finer_ranges.npy", 1),
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_an_import_that_was_killed_goes_on_with_both_stores(replaced, again, tmp_path, moment):
    def change(folder):
        shutil.copy2(replaced[0], folder)
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
        command = [sys.executable, "-c", KILLED, str(folder), str(tmp_path / "store"), *map(str, MOMENTS[moment])]
        assert subprocess.run(command, env=environment).returncode == -9
        assert len(list((tmp_path / "store").glob("data-*"))) == 2
        verify(tmp_path / "store")
        store_folder.remove_abandoned(tmp_path / "store")  # as each import begins

    assert len(again(change, replaced[1:])[0]) <= 6


@pytest.mark.parametrize("name", ["finer_heights", "finer_errors", "finer_ranges"])
def test_damage_in_the_earlier_store_is_made_again(replaced, again, tmp_path, name):
    def change(folder):
        shutil.copy2(replaced[0], folder)
        file = store_folder.named_folder(tmp_path / "store") / f"{name}.npy"
        array = np.load(file, mmap_mode="r+")
        array[-1].reshape(-1)[-3000:] += 1
        array[len(array) // 2].reshape(-1)[len(array[0].reshape(-1)) // 2] += 1
        array.flush()

    again(change, replaced[1:])
