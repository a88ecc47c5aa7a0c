# SPDX-License-Identifier: GPL-3.0-or-later
"""The places of diamonds in the arrays of the error hierarchy and of the ranges."""

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.field.lattice import Lattice, fit
from adaptive_terrain.kernels.field.layout import tile_index
from diamond_entries import error_index, root_entries

LATTICES = [Lattice(1, 1, k) for k in range(8)]
LATTICES += [
    Lattice(3, 2, 0),
    Lattice(40, 3, 1),
    Lattice(2, 17, 2),
    Lattice(5, 3, 3),
    Lattice(3, 2, 6),
    Lattice(1, 3, 7),
]
LATTICES += [fit(width, height) for width, height in ((4, 2), (8, 6), (7, 60), (34, 34), (100, 333), (130, 129))]


def name(lattice):
    return f"{lattice.columns}x{lattice.rows}x2^{lattice.levels}-{lattice.cells_x}x{lattice.cells_y}"


def diamonds(lattice):
    """(depth, samples i, j) of every diamond, from where cells' centres and sides' middles are, but of those whose box
    is beyond the raster."""
    across, up = lattice.span
    for q in range(lattice.levels):
        half = 1 << (lattice.levels - q - 1)
        j, i = np.mgrid[0 : up + 1 : half, 0 : across + 1 : half]
        odd = (i // half) % 2 + (j // half) % 2
        for depth, wanted, reach in ((2 * q + 1, 2, 3 * half), (2 * q + 2, 1, 2 * half)):
            kept = (odd == wanted) & (i - reach < lattice.cells_x) & (j - reach < lattice.cells_y)
            yield depth, i[kept], j[kept]
    j, i = np.mgrid[0:up, 0:across]
    kept = (i - 1 < lattice.cells_x) & (j - 1 < lattice.cells_y)
    yield lattice.cell_depth, i[kept], j[kept]


@pytest.mark.parametrize("lattice", LATTICES, ids=name)
def test_every_diamond_has_an_entry_of_its_own(lattice):
    base, pages = lattice.layout()
    assert base.dtype == np.int64 and base.shape == (lattice.groups + 2,) and base[0] == 0
    assert pages.dtype == np.int32 and pages.shape == (lattice.groups + 1,)
    assert lattice.node_count == base[-1] and lattice.cell_base == base[-2]
    taken = np.zeros(lattice.node_count, int)
    for depth, i, j in diamonds(lattice):
        at = error_index(lattice, depth, i, j)
        group = lattice.group(depth)
        assert at.min() >= base[group] and at.max() < base[group + 1]
        np.add.at(taken, at, 1)
    assert taken.max() == 1
    for entries in (taken[root_entries(lattice)], root_entries(lattice) < lattice.node_count):
        assert entries.shape == (lattice.rows, lattice.columns) and entries.all()
    if lattice.is_padded:
        return
    # The corners of the root squares are the samples that split nothing.
    samples = lattice.width * lattice.height - (lattice.columns + 1) * (lattice.rows + 1)
    assert taken[: lattice.cell_base].sum() == samples
    assert taken[lattice.cell_base :].sum() == (lattice.width - 1) * (lattice.height - 1)


@wp.kernel
def tile_indices(pages: wp.int32, points: wp.array(dtype=wp.vec2i), out: wp.array(dtype=wp.int64)):
    p = points[wp.tid()]
    out[wp.tid()] = tile_index(p[0], p[1], pages)


@pytest.mark.parametrize("lattice", LATTICES, ids=name)
def test_kernels_find_the_same_entries(lattice):
    base, pages = lattice.layout()
    for depth, i, j in diamonds(lattice):
        group = lattice.group(depth)
        shift = 2 * group if depth < lattice.cell_depth else 0
        points = wp.array(np.stack([i >> shift, j >> shift], 1).astype(np.int32), dtype=wp.vec2i, device="cpu")
        out = wp.zeros(len(i), dtype=wp.int64, device="cpu")
        wp.launch(tile_indices, len(i), inputs=[int(pages[group]), points, out], device="cpu")
        assert np.array_equal(base[group] + out.numpy(), error_index(lattice, depth, i, j))


def test_four_bisections_share_a_cache_line():
    lattice = Lattice(3, 2, 8)
    for g in range(lattice.groups):
        q = lattice.levels - 1 - 2 * g
        unit = 1 << 2 * g
        x, y = 4 * unit, 8 * unit  # a tile's corner: a vertex of a coarser group
        vertices = (-1, x + 2 * unit, y + 2 * unit), (0, x + 2 * unit, y)
        vertices += (1, x + unit, y + 3 * unit), (2, x + unit, y + 2 * unit)
        tile = [error_index(lattice, 2 * q + finer, i, j) for finer, i, j in vertices]
        assert len({int(at) // 16 for at in tile}) == 1
        page = [error_index(lattice, 2 * q + 2, unit * a, 0) for a in (1, 15, 31)]
        assert all(at // 1024 == tile[0] // 1024 for at in page)


def test_indices_beyond_31_bits():
    lattice = Lattice(1, 1, 16)
    at = error_index(lattice, lattice.cell_depth, lattice.width - 2, lattice.height - 2)
    assert at == lattice.node_count - 1 > 2**32 and error_index(lattice, 1, 1 << 15, 1 << 15) < lattice.cell_base


@pytest.mark.parametrize("size", [4097, 4098, 6000])
def test_entries_of_nothing_are_a_small_part_of_a_large_raster(size):
    lattice = fit(size, size)
    diamonds = lattice.width * lattice.height + (lattice.width - 1) * (lattice.height - 1)
    assert lattice.node_count < 1.08 * diamonds
