# SPDX-License-Identifier: GPL-3.0-or-later
"""Error hierarchies of meshlets against the same passes over float32 errors, in numpy."""

import tracemalloc

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.field import codes, meshlet_errors
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.field.heightfield import INTERPOLATIONS
from adaptive_terrain.cbt_terrain.field.lattice import PAGE
from adaptive_terrain.cbt_terrain.field.meshlet_errors import error_for
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.run.buffers import flat
from adaptive_terrain.kernels.field import expand as kernels
from adaptive_terrain.kernels.field.layout import Depth
from diamond_entries import error_index
from fields import rough, split_points
from rasters import jacksboro
from scenarios import eager_threads

AXES = np.array([(1, 0), (-1, 0), (0, 1), (0, -1)])
DIAGONALS = np.array([(1, 1), (-1, 1), (1, -1), (-1, -1)])


def entries_by_place(lattice):
    """Return for each depth the places [n, 2] in half samples, and the entry of each place, -1 where there is none."""
    margin = 4 << lattice.levels
    found = {}
    for depth in range(1, lattice.cell_depth + 1):
        places = np.stack(split_points(lattice, depth), axis=1)
        entry = np.full([2 * cells + 4 * margin for cells in lattice.span], -1)
        places = 2 * places + (depth == lattice.cell_depth)
        entry[tuple(places.T + margin)] = error_index(lattice, depth, *(places.T // 2))
        found[depth] = places + margin, entry
    return found


def around(entry, places, ways):
    """Return the entries [n, 4] at `ways` from places."""
    return entry[tuple((places[:, None] + ways).transpose(2, 0, 1))]


def expanded(field, meshlet):
    """Return the codes of meshlets, from passes over the errors in metres."""
    lattice = field.lattice
    table, base, count = field.table, lattice.cell_base, lattice.node_count
    errors = np.append(codes.decode(lattice, field.error, table), np.float32(0.0))  # the last one is that of entry -1
    depths, bicubic = entries_by_place(lattice), field.interpolation == "bicubic"
    for step in range(2 * meshlet):
        for depth in range(1, lattice.cell_depth):
            places, entry = depths[depth]
            side = 1 << (lattice.levels - (depth - 1) // 2)
            below = around(depths[depth + 1][1], places, AXES * side if depth % 2 else DIAGONALS * (side // 2))
            errors[entry[tuple(places.T)]] = errors[below].max(axis=1)
        places, entry = depths[lattice.cell_depth]
        cells, beside = entry[tuple(places.T)], around(entry, places, 2 * AXES)
        if step % 2 == 0:
            shift = count - base if bicubic else 0
            beside = np.where(beside < 0, -1, beside + shift)
            largest = np.maximum(errors[cells + shift], errors[beside].max(axis=1))
            errors[cells] = largest * np.float32(0.5 if bicubic else 0.25)
            errors[cells + shift] = errors[cells]
        elif bicubic:
            errors[base:] *= np.float32(0.5)
    found = np.zeros(len(field.error), np.uint8)
    for group, part in enumerate(codes.parts(lattice, len(found))):
        found[part] = np.searchsorted(table[group], errors[:-1][part])
    return found


@pytest.mark.parametrize(
    ("shape", "interpolation"),
    [
        *((shape, name) for shape in ((33, 17), (9, 40)) for name in INTERPOLATIONS),
        *(pytest.param((70, 100), name, marks=pytest.mark.thorough) for name in INTERPOLATIONS),
    ],
)
def test_codes_are_those_of_the_errors_in_metres(shape, interpolation, monkeypatch):
    monkeypatch.setattr(meshlet_errors, "BAND", 1)
    field = interpolated(rough(*shape), interpolation)
    for meshlet in (1, 2, 4):
        with eager_threads():
            assert error_for(field, meshlet).tobytes() == expanded(field, meshlet).tobytes()


def test_bands_of_cells_do_not_change_the_codes(monkeypatch):
    whole, parts = (interpolated(from_array(jacksboro().astype(np.float32)), "bicubic") for _ in range(2))
    expected = error_for(whole, 2).tobytes()
    monkeypatch.setattr(meshlet_errors, "BAND", 5000)
    assert error_for(parts, 2).tobytes() == expected


def test_meshlet_errors_take_one_byte_a_diamond(monkeypatch):
    monkeypatch.setattr(meshlet_errors, "BAND", 1)
    field = rough(513, 513)
    error_for(rough(33, 33), 1)  # compiles
    tracemalloc.start()
    error_for(field, 1)
    assert tracemalloc.get_traced_memory()[1] < 1.3 * field.error.nbytes
    tracemalloc.stop()


def test_codes_beyond_31_bits_are_reached(tmp_path):
    count, row = 2**31, PAGE * PAGE
    large = np.memmap(tmp_path / "codes", np.uint8, "w+", shape=count + row)  # a sparse file
    large[count] = 9
    cells, out = Depth(), np.zeros(row, np.uint8)
    cells.columns = cells.rows = cells.pages = cells.step = 1
    old = Depth()
    old.columns = old.rows = old.pages = old.step = 1
    old.base = count
    inputs = [0, old, flat(large, wp.uint8), cells, flat(np.arange(256, dtype=np.uint8), wp.uint8), flat(out, wp.uint8)]
    launch.spread(kernels.raise_cells, 1, inputs, step="test")
    assert out[0] == 9
