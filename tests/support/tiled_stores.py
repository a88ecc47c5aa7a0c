# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores of many tiles and of one, and their comparison with each other and with fields that are built in memory."""

import json

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import build
from adaptive_terrain.cbt_terrain.field.store import open_store
from adaptive_terrain.cbt_terrain.field.store_folder import named_folder
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.importing import import_work, tile_crew, tile_import
from adaptive_terrain.cbt_terrain.tiling.tile_records import READ
from adaptive_terrain.cbt_terrain.tiling.tile_work import work_in
from mosaic_files import EAST, NORTH, UTM32, sheet

ARRAYS = (
    *("samples", "error", "ranges", "valid"),
    *("error_pages", "error_places", "ranges_pages", "ranges_places"),  # of shared pages, instead of `error`, `ranges`
)
NUMBERS = "exponents", "range_base", "range_step", "min_height", "max_height", "steepest_x", "steepest_y"


@pytest.fixture
def tiled(monkeypatch):
    """Return a function that switches to tiles of 2**bits cells, and for None to those that hold a whole raster."""

    def switch(bits):
        monkeypatch.setattr(tile_crew, "MIN_SAMPLES", 1)
        monkeypatch.setattr(import_work, "TILE_BITS", bits or 11)

    return switch


def content(store):
    """Return the arrays of a store, and its description without names, times and the checksum over them."""
    folder = named_folder(store)
    verify(store)
    arrays = {name: np.load(folder / f"{name}.npy") for name in ARRAYS if (folder / f"{name}.npy").exists()}
    text = json.loads((store / "store.json").read_text())
    del text["data"], text["sum"], text["report"]["seconds"]
    return arrays, text


def assert_same(store, other):
    """Compare a store of many tiles with one of one tile, and that with a field that is built in memory."""
    assert len(work_in(named_folder(store)).grid) > 1 and work_in(named_folder(other)) is None
    (arrays, text), (wanted, wanted_text) = content(store), content(other)
    assert text == wanted_text
    assert arrays.keys() == wanted.keys()
    for name in wanted:
        assert arrays[name].dtype == wanted[name].dtype
        assert np.array_equal(arrays[name], wanted[name]), name
    field = open_store(other)
    assert_built(
        field, np.where(field.valid == 0, np.nan, field.heights()) if field.valid is not None else field.heights()
    )


def assert_built(field, heights):
    """Compare a field with one that is built in memory of its heights, [rows, columns] with NaN for missing ones."""
    heights, lattice, holes = np.array(heights, np.float32), field.lattice, field.valid is not None
    missing = int(np.isnan(heights).sum())
    built = build(
        heights, lattice.step_x, lattice.step_y, missing=missing, holes=holes, source_max=field.source_max, threads=1
    )
    assert np.array_equal(field.heights(), built.samples) and field.raster.digest == built.raster.digest
    assert np.array_equal(field.error, built.error) and np.array_equal(field.ranges, built.ranges)
    assert np.array_equal(field.valid, built.valid) if holes else field.valid is None
    assert all(getattr(field, name) == getattr(built, name) for name in NUMBERS)


def write_tiles(folder, columns=4, rows=3, side=40, gap=(1, 1)):
    """Write tiles with a gap, and with one a finer tile above them."""
    whole = sheet(UTM32, EAST, NORTH, 10.0, 10.0, columns * side, rows * side)
    for row in range(rows):
        for column in range(columns):
            if (row, column) != gap:
                part = {"first_row": row * side, "rows": side, "first_column": column * side, "columns": side}
                whole.write(folder / f"t{row}{column}.tif", **part)
    if gap:
        sheet(UTM32, EAST + 250.0, NORTH - 130.0, 5.0, 5.0, 50, 40, shift=3.0).write(folder / "u.tif")


def size_of_records(work):
    """Return the bytes of all records of a work."""
    return sum(file.stat().st_size for file in work.folder.glob("tiles*.jsonl"))


class CountingCrew(tile_import.Crew):
    """Counts the tiles that are read and measured; raises KeyboardInterrupt after some tasks."""

    def __init__(self, tasks=10**9):
        self.left, self.read, self.measured = tasks, [], []

    def run(self, work, source, tasks, on_progress):
        for task in tasks:
            if self.left == 0:
                raise KeyboardInterrupt
            before = size_of_records(work)
            if not tile_import.perform(work, source, task, 1):
                return False
            self.left -= 1
            if task.step == READ:
                self.read.append(task.number)
            elif size_of_records(work) != before:
                self.measured.append(task.number)
        return True
