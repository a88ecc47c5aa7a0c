# SPDX-License-Identifier: GPL-3.0-or-later
"""Positions of a target grid's samples in the lattice of its sources.

PROJ computes them at nodes of the grid, and between nodes they are interpolated. Nodes belong to blocks of BLOCK x
BLOCK samples at fixed places, and each block is computed as a whole, so a position does not depend on the window that
is read. A lattice is the grid that the samples of some files share; its columns are u, its rows v.
"""

import numpy as np

from ..rasters.grid_pieces import BLOCK, MARGIN, SNAPPED, SPACINGS, BlockNodes, interpolation_error
from .lattices import TileLattice
from .systems import period_of, projected
from .target_grid import TargetGrid

# Largest error of an interpolated position, source samples, for which wider nodes are used.
MAX_ERROR = 0.01


def nodes_of(lattice: TileLattice, grid: TargetGrid, column: int, row: int) -> BlockNodes:
    """Return where samples of a block of the grid are in a lattice, at nodes evenly spread over the block.

    (column, row): number of the block, whose first sample is (column, row) * BLOCK. In the grid's own system positions
    are linear, so the corners of the block are its nodes. Elsewhere nodes have the widest of SPACINGS whose positions
    are exact enough in between. Errors, in samples of the lattice, include SNAPPED, the distance within which a
    position is moved to a sample, and `off_grid`, that of the tiles' samples from the lattice's.
    """
    if lattice.crs == grid.crs:
        error = lattice.off_grid + (0.0 if is_congruent(lattice, grid) else SNAPPED)
        u, v = _exact(lattice, grid, column, row, step=BLOCK)
        return BlockNodes(u, v, spacing=BLOCK, error_u=error, error_v=error)
    for spacing in SPACINGS:
        exact_u, exact_v = _exact(lattice, grid, column, row, spacing // 2)  # nodes, and points halfway to measure at
        error_u, error_v = interpolation_error(exact_u), interpolation_error(exact_v)
        u, v = exact_u[::2, ::2], exact_v[::2, ::2]
        if max(error_u, error_v) <= MAX_ERROR:
            break
    else:  # the last spacing has computed every sample
        spacing, u, v, error_u, error_v = 1, exact_u, exact_v, 0.0, 0.0
    more = lattice.off_grid + SNAPPED
    u, v = np.ascontiguousarray(u), np.ascontiguousarray(v)
    # MARGIN: the error elsewhere in a cell over that at the measured points.
    return BlockNodes(u, v, spacing, MARGIN * error_u + more, MARGIN * error_v + more)


def is_congruent(lattice: TileLattice, grid: TargetGrid) -> bool:
    """Return whether all samples of a grid in the lattice's system are samples of the lattice.

    The grid's step may be several of the lattice's.
    """
    a, b, d, e = lattice.steps
    if b != 0.0 or d != 0.0:  # rows or columns are not along the grid's; a and e may be 0
        return False
    ratios = grid.step_x / abs(a), grid.step_y / abs(e)
    corners = np.array([grid.column, grid.column + grid.width]), np.array([grid.row, grid.row + grid.height])
    deviations = [np.abs(w - np.round(w)).max() for w in lattice.indices(*grid.positions(*corners))]
    are_whole = all(ratio > 0.5 and abs(ratio - round(ratio)) < SNAPPED for ratio in ratios)  # numbers 1, 2, ...
    # Half of SNAPPED: with the rounding of positions in between, each still counts as a sample.
    return are_whole and max(deviations) < SNAPPED / 2


def _exact(lattice: TileLattice, grid: TargetGrid, column: int, row: int, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Return exact columns and rows of the lattice at every `step` samples of a block, [rows, columns].

    column, row: numbers of the block. Longitudes are continuous in the block, and its middle is within 180 degrees of
    the middle of the lattice.
    """
    offsets = np.arange(0, BLOCK + 1, step, dtype=np.float64)
    columns, rows = np.meshgrid(column * BLOCK + offsets, row * BLOCK + offsets)
    x, y = projected(grid.crs, lattice.crs, *(p.ravel() for p in grid.positions(columns, rows)))
    circle = period_of(lattice.crs)
    if circle:
        middle_of_tiles = lattice.rectangles[:, [0, 2]].mean(), lattice.rectangles[:, [1, 3]].mean()
        # longitudes of the middle of all tiles, and of the block's middle node
        tiles_middle, block_middle = float(lattice.positions(*middle_of_tiles)[0]), float(x[len(x) // 2])
        block_middle = block_middle if np.isfinite(block_middle) else tiles_middle
        if lattice.crs != grid.crs:  # the grid's own longitudes are continuous
            x = x - circle * np.round((x - block_middle) / circle)
        x = x - circle * np.round((block_middle - tiles_middle) / circle)
    u, v = lattice.indices(x, y)
    return u.reshape(columns.shape), v.reshape(columns.shape)
