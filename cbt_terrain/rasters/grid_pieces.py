# SPDX-License-Identifier: GPL-3.0-or-later
"""Resampling of a source to pieces of a grid. A sample depends on its position alone, not on the window that is read.

Exact positions at nodes of the grid are interpolated in between. Nodes belong to blocks at fixed places.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..run import launch
from ..run.buffers import flat

BLOCK = 1024  # samples of a side
SPACINGS = (32, 16, 8, 4, 2)  # samples between nodes, the first whose error is small enough, else 1
# Bilinear interpolation is off by at most the sum of the errors in the middles of a cell's sides, plus the change of
# curvature inside it.
MARGIN = 1.25
SNAPPED = 1e-6  # samples: a position this near to a sample counts as the sample (SNAP in kernels/mosaic/resample.py)
# Ranks of samples without a value: no tile is there, or one that has no data (kernels/mosaic/resample.py).
UNCOVERED, NO_DATA = -1, -2
EDGE = 3  # source samples around those that a piece is interpolated from
MAX_BUFFER = 1 << 22  # source samples of a piece; a larger one is divided


class BlockNodes(NamedTuple):
    """Nodes of one block of the grid.

    Attributes:
        u, v: float64 [nodes, nodes], columns and rows of the source; not finite where there are none.
        spacing: samples between nodes.
        error_u, error_v: largest errors of interpolated columns and rows, source samples.
    """

    u: np.ndarray
    v: np.ndarray
    spacing: int
    error_u: float
    error_v: float


class GridPiece(NamedTuple):
    """A part of one block of the grid: its first column and row, as numbers of the grid, and its size."""

    column: int
    row: int
    columns: int
    rows: int

    @property
    def block(self) -> tuple[int, int]:
        """Return the numbers of the block."""
        return self.column // BLOCK, self.row // BLOCK

    def halves(self) -> tuple["GridPiece", "GridPiece"]:
        """Return the two halves of the piece, divided along its longer side."""
        if self.columns >= self.rows:
            left = self.columns // 2
            return self._replace(columns=left), self._replace(column=self.column + left, columns=self.columns - left)
        top = self.rows // 2
        return self._replace(rows=top), self._replace(row=self.row + top, rows=self.rows - top)


class LatticeWindow(NamedTuple):
    """Samples of a lattice around those that a piece needs.

    Attributes:
        values: float64 [rows, columns], NaN where missing.
        ranks: int32 [rows, columns], rank of each sample's tile; UNCOVERED or NO_DATA without a value.
        left, top: column and row of the lattice of the first sample.
        rectangles: int64 [n, 4], those of the tiles near the piece.
        tile_ranks: ranks of these tiles.
    """

    values: np.ndarray
    ranks: np.ndarray
    left: int
    top: int
    rectangles: np.ndarray
    tile_ranks: np.ndarray


class PieceValues(NamedTuple):
    """Resampled values of a piece.

    Attributes:
        values: float64 [rows, columns], NaN where missing.
        ranks: int32 [rows, columns], rank of each value's tile; UNCOVERED or NO_DATA without one.
        moved: float64 [rows, columns], largest difference that the error of the position makes.
    """

    values: np.ndarray
    ranks: np.ndarray
    moved: np.ndarray

    def copy(self) -> "PieceValues":
        """Return a copy of the arrays."""
        return PieceValues(self.values.copy(), self.ranks.copy(), self.moved.copy())


def empty_values(piece: GridPiece) -> PieceValues:
    """Return the values of a piece before any tile is read: NaN, and the rank UNCOVERED."""
    shape = piece.rows, piece.columns
    return PieceValues(np.full(shape, np.nan), np.full(shape, UNCOVERED, np.int32), np.zeros(shape))


def pieces_of(column: int, row: int, columns: int, rows: int) -> Iterator[GridPiece]:
    """Divide a window of the grid into pieces, each inside one block of BLOCK x BLOCK samples, and yield them.

    row, column: first sample of the window. rows, columns: its size.
    """
    for y in range(row // BLOCK, (row + rows - 1) // BLOCK + 1):
        y0, y1 = max(row, y * BLOCK), min(row + rows, (y + 1) * BLOCK)
        for x in range(column // BLOCK, (column + columns - 1) // BLOCK + 1):
            x0, x1 = max(column, x * BLOCK), min(column + columns, (x + 1) * BLOCK)
            yield GridPiece(x0, y0, x1 - x0, y1 - y0)


def interpolation_error(exact: np.ndarray) -> float:
    """Return the largest error of values that are interpolated between every second row and column.

    exact: [2 n + 1, 2 m + 1], of which the even rows and columns are nodes. The error is measured at the odd ones, and
    summed over both axes. Values that are not finite do not count.
    """
    total = 0.0
    with np.errstate(invalid="ignore"):
        for values in (exact, exact.T):
            nodes = values[::2]
            deviations = np.abs(values[1::2, ::2] - (nodes[:-1, ::2] + nodes[1:, ::2]) / 2)
            deviations = deviations[np.isfinite(deviations)]
            total += float(deviations.max()) if deviations.size else 0.0
    return total


def resample_piece(piece: GridPiece, nodes: BlockNodes, window: LatticeWindow, result: PieceValues) -> None:
    """Write to `result` the samples of a piece for which a source has a higher rank (priority) than those so far.

    A kernel does it row by row. nodes: positions in the source, columns u and rows v, at the nodes of the piece's
    block, and the largest errors of positions between nodes. window: the source's samples around the piece, the first
    at column `left` and row `top`. result: also gets in `moved` how far these errors can change each value.
    """
    import warp as wp

    from ...kernels.mosaic import resample

    height, width = window.values.shape
    inputs = [
        piece.columns,
        piece.column % BLOCK,  # the piece's first sample in its block
        piece.row % BLOCK,
        nodes.spacing,
        flat(nodes.u, wp.float64),
        flat(nodes.v, wp.float64),
        nodes.u.shape[1],
        nodes.error_u,
        nodes.error_v,
        flat(window.values, wp.float64),
        flat(window.ranks, wp.int32),
        width,
        height,
        window.left,
        window.top,
        flat(result.values, wp.float64),
        flat(result.ranks, wp.int32),
        flat(result.moved, wp.float64),
    ]
    # Items of the launch are rows; a sample costs about 30 ns, twice the unit of `cost`.
    launch.spread(resample.resample_rows, piece.rows, inputs, step="resample", threads=None, cost=2.0 * piece.columns)
