# SPDX-License-Identifier: GPL-3.0-or-later
"""Resampling of tiles to a piece of the target grid: one level over the other, in each level by rank."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import warp as wp

from ...kernels.mosaic import resample
from ..run import launch
from ..run.buffers import flat
from .positions import BLOCK, BlockNodes
from .windows import GridPiece, LatticeWindow, PieceValues


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
                _resample(piece, lattice.nodes, lattice.window, result)
        yield level, below


def _resample(piece: GridPiece, nodes: BlockNodes, window: LatticeWindow, result: PieceValues) -> None:
    """Write to `result` the samples of a piece for which a lattice has a tile of a higher rank than those so far.

    nodes: positions of the lattice at the nodes of the piece's block.
    """
    height, width = window.values.shape
    inputs = [
        piece.columns,
        piece.column % BLOCK,
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
    launch.spread(resample.resample_rows, piece.rows, inputs, step="resample", threads=None, cost=2.0 * piece.columns)
