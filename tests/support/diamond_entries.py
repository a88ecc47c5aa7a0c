# SPDX-License-Identifier: GPL-3.0-or-later
"""Which entry of a height field's arrays is that of a diamond, by its split vertex; kernels/field/layout.py."""

import numpy as np
from adaptive_terrain.cbt_terrain.field.lattice import Lattice


def error_index(lattice: Lattice, depth: int, i, j) -> np.ndarray:
    """Return the error entries, int64, of the diamonds of `depth` (1 .. cell_depth) that are split at samples (i, j).

    i, j: arrays of columns and rows; at cell_depth those of the raster's cells.
    """
    group = lattice.group(depth)
    return entry_at(*lattice.layout(), group, 0 if depth == lattice.cell_depth else 2 * group, i, j)


def range_index(lattice: Lattice, depth: int, i, j) -> np.ndarray:
    """Return the entries in the ranges of heights (depths 1 .. range_depth, and cell_depth)."""
    group = (lattice.levels - 2 - (depth - 1) // 2) // 2
    shift = 1 + 2 * group
    if depth == lattice.cell_depth:
        group, shift = lattice.levels // 2, 0
    return entry_at(*lattice.range_layout(), group, shift, i, j)


def root_entries(lattice: Lattice) -> np.ndarray:
    """Return the entries, int64 [rows, columns], of the diamonds of the root squares; all others are below them."""
    side = 1 << lattice.levels
    i, j = np.arange(lattice.columns) * side + side // 2, np.arange(lattice.rows)[:, None] * side + side // 2
    return error_index(lattice, 1, i, j)


def entry_at(base: np.ndarray, pages: np.ndarray, group: int, shift: int, i, j) -> np.ndarray:
    """Return entries in the images of groups at columns i and rows j, of which every 2**shift-th is in the image."""
    x, y = np.asarray(i, np.int64) >> shift, np.asarray(j, np.int64) >> shift
    page = (y >> 5) * pages[group] + (x >> 5)
    return base[group] + (page << 10 | (y & 28) << 5 | (x & 28) << 2 | (y & 3) << 2 | (x & 3))
