# SPDX-License-Identifier: GPL-3.0-or-later
"""Hard case 57: land that is shaped tile by tile."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.land import level_plan
from adaptive_terrain.cbt_terrain.land.catalogue import LAND_EFFECTS
from adaptive_terrain.cbt_terrain.land.shape import shape
from adaptive_terrain.cbt_terrain.land.stack import Entry, Stack
from adaptive_terrain.cbt_terrain.land.tiles import BAND, all_tiles, levels_of
from land_effects import SMOOTH, bumpy, ragged

# How far tiles may be off, as a part of what the fine levels have moved. 0: their halo is all that they look at.
BOUNDS = {"smooth": 0.0, "relief": 0.0, "thermal": 0.01, "rivers": 0.05, "snow": 0.05}
ROUNDING = 1e-4  # metres, of changes of some hundred


@pytest.mark.parametrize("name", BOUNDS)
def test_case_57_tile_by_tile_equals_the_whole(monkeypatch, name):
    """All tiles of a raster of 560 x 930, each made alone with its halo, differ from the whole by rounding alone
    (smoothing, relief), or by less than 1 % (thermal), 5 % (rivers and snow) of what the finer level moved."""
    monkeypatch.setitem(LAND_EFFECTS, "smooth", SMOOTH)
    field = from_array(bumpy(560, 930) * 2 + 400, 12.0, 10.0)
    stack, every = Stack((Entry(name),)), all_tiles(field.lattice)
    whole = shape(field, stack, every, threads=2).change
    coarse = shape(field, stack, [{} for _ in every], threads=2).change
    monkeypatch.setattr(level_plan, "MOST_WHOLE", 0)
    tiles = shape(field, stack, every, threads=2).change
    moved, off = (float(np.sqrt(np.mean((a - whole) ** 2.0))) for a in (coarse, tiles))
    assert moved > 0.05 and off <= BOUNDS[name] * moved + ROUNDING


def test_case_57_neighbours_share_their_borders(monkeypatch):
    """A tile that is made with its neighbour and one that is made after it have the same bytes, and where tiles meet
    the change of heights has no step: neither between two tiles nor beside one that nobody asked for."""
    field = from_array(bumpy(560, 930) * 2 + 400, 12.0, 10.0)
    stack, level = Stack((Entry("rivers"),)), levels_of(field.lattice)[0]
    none = [{} for _ in levels_of(field.lattice)[1:]]
    pair = shape(field, stack, [{5: 0.0, 6: 0.0}, *none]).change
    assert pair.tobytes() == shape(field, stack, [{6: 0.0, 5: 0.0}, *none], threads=3).change.tobytes()
    one = shape(field, stack, [{5: 0.0}, *none]).change
    rows, columns = level.window(5)
    inside = slice(rows.start + BAND, rows.stop - BAND), slice(columns.start + BAND, columns.stop - BAND)
    assert pair[inside].tobytes() == one[inside].tobytes()
    jumps = abs(np.diff(pair, axis=1))[rows]
    rms = np.sqrt((jumps**2).mean(axis=0))
    across = rms[columns.stop - 1 - BAND : columns.stop - 1 + BAND]
    assert across.max() < 1.5 * rms[columns.start + BAND : columns.stop - 2 * BAND].max()


@pytest.mark.parametrize("name", ["snow", "thermal"])
def test_case_57_what_slides_is_kept_alike_in_a_tile_and_in_the_whole(monkeypatch, name):
    """On cliffs of 7 x 12 m a finer level starts from slides that do not fit its slopes: the sum is made up for nearby,
    so tiles are off by less than 2 % of what the level moved, the worst by less than 5 %."""
    field = from_array(ragged(330, 600), 7.0, 12.0)
    stack, every = Stack((Entry(name, {"line": 700.0} if name == "snow" else {}),)), all_tiles(field.lattice)
    whole = shape(field, stack, every, threads=2).change
    coarse = shape(field, stack, [{} for _ in every], threads=2).change
    monkeypatch.setattr(level_plan, "MOST_WHOLE", 0)
    tiles = shape(field, stack, every, threads=2).change
    level = levels_of(field.lattice)[0]
    windows = [level.window(tile) for tile in range(level.tile_count)]
    moved, off = ([np.mean((a - whole)[w] ** 2.0) for w in windows] for a in (coarse, tiles))
    assert min(moved) > 1.0 and sum(off) < 0.02**2 * sum(moved)
    assert all(o < 0.05**2 * m for o, m in zip(off, moved, strict=True))
