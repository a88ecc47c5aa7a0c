# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a mosaic's grid that are resampled together, and the source samples for them."""

import numpy as np

from ..rasters.grid_pieces import BLOCK, EDGE, BlockNodes, GridPiece
from .lattices import TileLattice


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
    # Along x, then along y: positions, entries of a rectangle, and the columns in 360 degrees.
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
