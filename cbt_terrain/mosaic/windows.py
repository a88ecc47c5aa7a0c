# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a mosaic's grid that are resampled together, and the source samples for them."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .lattices import TileLattice
from .positions import BLOCK, BlockNodes

UNCOVERED, NO_DATA = -1, -2  # ranks, as in kernels/mosaic/resample.py
EDGE = 3  # source samples around those that a piece is interpolated from


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
        ranks: int32 [rows, columns], rank of each sample's tile; UNCOVERED, or NO_DATA in a tile.
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
        ranks: int32 [rows, columns], rank of each value's tile; UNCOVERED, or NO_DATA in a tile.
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


def source_box(
    lattice: TileLattice, near: np.ndarray, nodes: BlockNodes, piece: GridPiece
) -> tuple[int, int, int, int] | None:
    """Return the part of a lattice that a piece needs, with EDGE more: first column and row, and the ends of both.

    They are those of the nodes around the piece, within the rectangles of the tiles near it. None if the piece has no
    position in the lattice or is beyond these tiles. near: positions of the tiles in `lattice.tiles`.
    """
    x, y = piece.column % BLOCK, piece.row % BLOCK
    down = slice(y // nodes.spacing, (y + piece.rows - 1) // nodes.spacing + 2)
    across = slice(x // nodes.spacing, (x + piece.columns - 1) // nodes.spacing + 2)
    box = []
    for values, (first_entry, last_entry), period in ((nodes.u, (0, 2), lattice.period), (nodes.v, (1, 3), 0)):
        positions = at_corners(values, nodes, (y, x), piece) if nodes.spacing == BLOCK else values[down, across]
        positions = positions[np.isfinite(positions)]
        if not len(positions):
            return None
        rectangles = lattice.rectangles[near]
        low, high = rectangles[:, first_entry].min() - period, rectangles[:, last_entry].max() + period
        first, last = max(np.floor(positions.min()), low), min(np.ceil(positions.max()), high)
        if first > last + 1:
            return None
        box.append((int(first) - EDGE, int(last) + EDGE + 1))
    return box[0][0], box[1][0], box[0][1], box[1][1]


def at_corners(values: np.ndarray, nodes: BlockNodes, first: tuple[int, int], piece: GridPiece) -> np.ndarray:
    """Return the values at a piece's four corners, float64 [4], from those at the corners of its whole block.

    The corners are those of the first row, then of the last one. values: at the block's corners, the nodes, float64 [2,
    2]. first: row and column of the piece's first corner in its block.
    """
    corners = []
    for y in (first[0], first[0] + piece.rows - 1):
        for x in (first[1], first[1] + piece.columns - 1):
            s, t = x / nodes.spacing, y / nodes.spacing
            low = values[0, 0] * (1 - s) + values[0, 1] * s
            corners.append(low * (1 - t) + (values[1, 0] * (1 - s) + values[1, 1] * s) * t)
    return np.array(corners)
