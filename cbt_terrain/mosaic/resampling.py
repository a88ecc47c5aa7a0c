# SPDX-License-Identifier: GPL-3.0-or-later
"""Resampling of tiles to a piece of the target grid: one level over the other, in each level by rank."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ..rasters.grid_pieces import BlockNodes, GridPiece, LatticeWindow, PieceValues, resample_piece


class FoundLattice(NamedTuple):
    """A lattice with tiles near a piece: its level, the positions of the piece's block, and its samples there."""

    level: int
    nodes: BlockNodes
    window: LatticeWindow


def resample_levels(
    piece: GridPiece, levels: np.ndarray, found: Sequence[FoundLattice], result: PieceValues
) -> Iterator[tuple[int, PieceValues | None]]:
    """Write the tiles of one level after the other over `result`, and yield each level with the values before it.

    These are None for level 0, the coarsest. found: the lattices with tiles in the piece.
    """
    for level in map(int, levels):
        below = result.copy() if level > 0 else None
        for lattice in found:
            if lattice.level == level:
                resample_piece(piece, lattice.nodes, lattice.window, result)
        yield level, below
