# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts of a mosaic's grid that are resampled together, the source samples for them, and their resampling.

A block is a square of BLOCK x BLOCK samples of the grid at a fixed place, a piece a rectangle inside a block. A lattice
is the grid that the samples of some files (tiles) share; its columns are u, its rows v. Positions in it are known at
nodes, which are evenly spread over a block.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..rasters.grid_pieces import BLOCK, EDGE, BlockNodes, GridPiece, LatticeWindow, PieceValues, resample_piece
from .lattices import TileLattice


class FoundLattice(NamedTuple):
    """A lattice with tiles near a piece: its level, the positions of the piece's block, and its samples there."""

    level: int
    nodes: BlockNodes
    window: LatticeWindow


def source_box(
    lattice: TileLattice, near: np.ndarray, nodes: BlockNodes, piece: GridPiece
) -> tuple[int, int, int, int] | None:
    """Return the box of a lattice that a piece of the grid needs: first column and row, and the ends of both.

    It holds the positions at the nodes around the piece, as far as the tiles near it reach, and EDGE more samples on
    each side, for interpolation. None if the piece has no position in the lattice or is beyond these tiles.

    near: indices of the tiles in `lattice.tiles`. nodes: columns u and rows v of the lattice at nodes of the piece's
    block.
    """
    x, y = piece.column % BLOCK, piece.row % BLOCK
    # the rows and columns of nodes around the piece
    down = slice(y // nodes.spacing, (y + piece.rows - 1) // nodes.spacing + 2)
    across = slice(x // nodes.spacing, (x + piece.columns - 1) // nodes.spacing + 2)
    box = []
    # Along x, then along y: positions, entries of a rectangle, and the columns in 360 degrees.
    for values, (first_entry, last_entry), period in ((nodes.u, (0, 2), lattice.period), (nodes.v, (1, 3), 0)):
        # With nodes at the block's corners alone, positions are linear, and the piece's own corners give a smaller box.
        positions = at_corners(values, piece) if nodes.spacing == BLOCK else values[down, across]
        positions = positions[np.isfinite(positions)]
        if not len(positions):
            return None
        rectangles = lattice.rectangles[near]
        low, high = rectangles[:, first_entry].min(), rectangles[:, last_entry].max()
        # Around the globe the tiles repeat every `period` columns: extend their range by as many turns as are needed.
        turns = turns_around(low, high, positions.min(), positions.max(), period)
        low, high = low - turns * period, high + turns * period
        first, last = max(np.floor(positions.min()), low), min(np.ceil(positions.max()), high)
        if first > last + 1:  # more than a cell apart, so not even a border reaches the piece
            return None
        box.append((int(first) - EDGE, int(last) + EDGE + 1))
    return box[0][0], box[1][0], box[0][1], box[1][1]


def turns_around(low: float, high: float, first: float, last: float, period: int) -> int:
    """Return by how many turns of 360 degrees, to either side, columns low .. high repeat within first .. last.

    It is at least 1; more if a block of coarse samples is several turns wide. It is 0 without a period. period: columns
    in 360 degrees, 0 if there are none.
    """
    if not period:
        return 0
    # Copies to the east begin at low + n * period <= last, those to the west end at high - n * period >= first.
    return max(1, int((last - low) // period), int((high - first) // period))


def at_corners(nodes: np.ndarray, piece: GridPiece) -> np.ndarray:
    """Return the values at a piece's four corners, float64 [4], from those at the corners of its whole block.

    The corners are those of the first row, then of the last one. nodes: values at the block's corners, float64 [2, 2].
    """
    row, column = piece.rows - 1, piece.columns - 1
    return interpolate_nodes(nodes, BLOCK, piece, np.array([0, 0, row, row]), np.array([0, column, 0, column]))


def interpolate_nodes(
    nodes: np.ndarray, spacing: int, piece: GridPiece, rows: np.ndarray, columns: np.ndarray
) -> np.ndarray:
    """Return values between a block's nodes, `spacing` samples apart, at samples of a piece, bilinear: float64 [n].

    rows, columns: those of the samples, from the first one of the piece.
    """
    x, y = piece.column % BLOCK + columns, piece.row % BLOCK + rows
    # The node before each sample, and the fractions of the way to the next ones.
    i, j, s, t = x // spacing, y // spacing, (x % spacing) / spacing, (y % spacing) / spacing
    low = nodes[j, i] * (1 - s) + nodes[j, i + 1] * s
    high = nodes[j + 1, i] * (1 - s) + nodes[j + 1, i + 1] * s
    return low * (1 - t) + high * t


def resample_levels(
    piece: GridPiece, levels: np.ndarray, found: Sequence[FoundLattice], result: PieceValues
) -> Iterator[tuple[int, PieceValues | None]]:
    """Write the tiles of one level after the other over `result`, in place; yield each level when it is written.

    With it comes a copy of `result` before the level, None for level 0, the coarsest. The caller may change `result`,
    as by blending, before the next level. A tile only replaces values of lower ranks, which are numbers of tiles in the
    order of priority.

    levels: those of the tiles near the piece, ascending. found: the lattices with tiles in the piece.
    """
    for level in map(int, levels):
        below = result.copy() if level > 0 else None
        for lattice in found:
            if lattice.level == level:
                resample_piece(piece, lattice.nodes, lattice.window, result)
        yield level, below
