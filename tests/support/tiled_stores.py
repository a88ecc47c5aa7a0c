# SPDX-License-Identifier: GPL-3.0-or-later
"""Stores that are imported by tile and in one piece, and their comparison."""

import json

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.store_folder import named_folder
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.importing import import_work, tile_import
from adaptive_terrain.cbt_terrain.tiling.tile_records import READ
from mosaic_files import EAST, NORTH, UTM32, sheet

ARRAYS = "samples", "error", "ranges", "valid"


@pytest.fixture
def tiled(monkeypatch):
    """Return a function that switches to tiles of 2**bits cells, and for None to imports in one piece."""

    def switch(bits):
        monkeypatch.setattr(tile_import, "TILED_SAMPLES", 1 if bits else 1 << 60)
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
    assert len(list(store.glob("data-*/borders.npy"))) == 1 and not list(other.glob("data-*/borders.npy"))
    (arrays, text), (wanted, wanted_text) = content(store), content(other)
    assert text == wanted_text
    assert arrays.keys() == wanted.keys()
    for name in wanted:
        assert arrays[name].dtype == wanted[name].dtype
        assert np.array_equal(arrays[name], wanted[name]), name


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
