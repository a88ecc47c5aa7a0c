# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports of small mosaics with finer tiles in several windows and squares, whose records and bytes are compared."""

import json

from adaptive_terrain.cbt_terrain.field import finer_build, finer_heights, store_folder
from adaptive_terrain.cbt_terrain.field.verification import verify
from adaptive_terrain.cbt_terrain.importing import finer_import
from adaptive_terrain.cbt_terrain.mosaic import finer_plan
from adaptive_terrain.cbt_terrain.tiling.tile_records import FINER

BLOCK, WINDOW = 3, 1  # tiles along a side of a square and of a window, so that there are several


def make_small(patch, block=BLOCK, window=WINDOW):
    patch.setattr(finer_plan, "FEWEST", 1 << 20)
    patch.setattr(finer_build, "BLOCK", block)
    patch.setattr(finer_heights, "WINDOW", window)
    patch.setattr(finer_import, "WINDOW", window)


def count_records(patch, stop_after=None):
    """Count the records of finer tiles that an import writes, by kind; stop it after `stop_after` of them."""
    counts, note = dict.fromkeys(FINER, 0), finer_import._WorkRecords.note

    def counting(self, kind, number, **values):
        if stop_after is not None and sum(counts.values()) == stop_after:
            raise KeyboardInterrupt
        note(self, kind, number, **values)
        counts[kind] += 1

    patch.setattr(finer_import._WorkRecords, "note", counting)
    return counts


def content(store):
    """Return all arrays of a store, and its description without names, times and the checksum over them."""
    verify(store)
    folder = store_folder.named_folder(store)
    arrays = {file.name: file.read_bytes() for file in folder.glob("*.npy")}
    text = json.loads((store / "store.json").read_text())
    del text["data"], text["sum"], text["report"]["seconds"]
    return arrays, text, sorted(file.name for file in folder.iterdir())


def assert_same(store, whole):
    """Assert that two stores have the same files, arrays and description."""
    found, wanted = content(store), content(whole)
    assert found[2] == wanted[2] and len(found[0]) >= 9
    assert [name for name, array in found[0].items() if array != wanted[0][name]] == []
    assert found[1] == wanted[1]
    assert len(list(store.glob("data-*"))) == 1
