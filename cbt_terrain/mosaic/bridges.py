# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights in the cell between the outer samples of two tiles that have no common lattice.

A tile's border counts beyond its outer samples, with a weight that falls from 1 to 0 within one cell. The mean of all
such tiles is linear between two borders one cell apart, so tiles without a shared row have no gap.

A lattice is the grid that the samples of some tiles share. A rank is a tile's number in the order of priority.
"""

import numpy as np

from ..rasters.grid_pieces import SNAPPED, UNCOVERED, BlockNodes, GridPiece, LatticeWindow
from .windows import interpolate_nodes

# Sum of weights from which on a sample has a height: the outer cells of a single tile are half a cell wide.
MIN_WEIGHT = 0.5 - 1e-9


def bridge(
    piece: GridPiece,
    lattices: list[tuple[BlockNodes, LatticeWindow]],
    values: np.ndarray,
    ranks: np.ndarray,
    moved: np.ndarray,
) -> None:
    """Fill samples of a piece of the grid that no tile covers from the borders of tiles within one cell, in place.

    Samples of less weight than MIN_WEIGHT stay NaN.

    Args:
        lattices: of each lattice near the piece, the positions in it (columns u and rows v, at nodes of the piece's
            block), and its samples with the rectangles (first column and row, last ones) and ranks of its tiles.
        values: float64 [rows, columns] of the piece, NaN where missing; filled.
        ranks: rank of each value's tile, UNCOVERED where no tile is.
        moved: errors of the values by inexact positions, in their unit; written where values are.
    """
    rows, columns = np.nonzero(ranks == UNCOVERED)
    weights, sums = np.zeros(len(rows)), np.zeros(len(rows))  # of all tiles so far, at each uncovered sample
    low, high = np.full(len(rows), np.inf), np.full(len(rows), -np.inf)  # extremes of the heights
    # of a border's height by an inexact position, and of that position in samples of the lattice
    max_errors, max_shifts = np.zeros(len(rows)), np.zeros(len(rows))
    tiles = []  # rank, lattice, number in its window, and the uncovered samples' columns u and rows v of the lattice
    for number, (nodes, window) in enumerate(lattices):
        u, v = (interpolate_nodes(values, nodes.spacing, piece, rows, columns) for values in (nodes.u, nodes.v))
        for n in range(len(window.tile_ranks)):
            tiles.append((int(window.tile_ranks[n]), number, n, u, v))
    for _, number, n, u, v in sorted(tiles, key=lambda tile: tile[:3]):  # by rank, so that sums round alike everywhere
        nodes, window = lattices[number]
        first_u, first_v, last_u, last_v = window.rectangles[n]
        # How far each sample is beyond the tile's outer samples, and which are less than a cell away.
        beyond_u = np.maximum(np.maximum(first_u - u, u - last_u), 0.0)
        beyond_v = np.maximum(np.maximum(first_v - v, v - last_v), 0.0)
        with np.errstate(invalid="ignore"):
            near = np.flatnonzero((beyond_u < 1.0 - SNAPPED) & (beyond_v < 1.0 - SNAPPED))
        if not len(near):
            continue
        # The border's height at its nearest point, and how much an error of one sample in position may change it.
        heights, change = _border(window, np.clip(u[near], first_u, last_u), np.clip(v[near], first_v, last_v))
        near, heights, change = (array[np.isfinite(heights)] for array in (near, heights, change))
        weight = (1.0 - beyond_u[near]) * (1.0 - beyond_v[near])
        weights[near] += weight
        sums[near] += weight * heights
        low[near], high[near] = np.minimum(low[near], heights), np.maximum(high[near], heights)
        error = nodes.error_u + nodes.error_v  # of a position, in samples of the lattice
        max_shifts[near] = np.maximum(max_shifts[near], error)
        max_errors[near] = np.maximum(max_errors[near], error * change)
    has_height = weights >= MIN_WEIGHT
    samples = rows[has_height], columns[has_height]
    values[samples] = sums[has_height] / weights[has_height]
    # An error of position moves a height by max_errors. It also changes weights by at most itself; the mean of heights
    # changes by that times their range (high - low), divided by the sum of weights, which is at least a half.
    moved[samples] = max_errors[has_height] + 2.0 * max_shifts[has_height] * (high[has_height] - low[has_height])


def _border(window: LatticeWindow, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return heights interpolated at columns u and rows v of a lattice, and how far an error of position changes them.

    Heights are NaN where a needed sample is missing. The second result bounds the change of a height, metres, for an
    error of one sample in u or v: twice the largest difference between the first corner of its cell and another, since
    two other corners differ by that at most.
    """
    height, width = window.values.shape
    # the cell of each position, and the place in it, 0 .. 1
    i, j = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    s, t = u - i, v - j
    i, j = i - window.left, j - window.top
    # A window has some more samples than it needs, so that the outermost ones have a cell, too.
    inside = (i >= 0) & (j >= 0) & (i + 1 < width) & (j + 1 < height)
    i, j = np.clip(i, 0, width - 2), np.clip(j, 0, height - 2)
    corners = window.values[j, i], window.values[j, i + 1], window.values[j + 1, i], window.values[j + 1, i + 1]
    a, b, c, d = (  # a missing corner of weight 0 must not make the sum NaN (s, t < 1, so the first has a weight)
        np.where(needed, z, 0.0) for z, needed in zip(corners, (s < 1, s > 0, t > 0, (s > 0) & (t > 0)), strict=True)
    )
    heights = (a * (1 - s) + b * s) * (1 - t) + (c * (1 - s) + d * s) * t
    step = np.fmax.reduce([np.abs(corners[0] - z) for z in corners[1:]] + [np.zeros_like(s)])
    return np.where(inside, heights, np.nan), 2.0 * step
