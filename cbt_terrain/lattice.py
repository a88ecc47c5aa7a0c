# SPDX-License-Identifier: GPL-3.0-or-later
"""The lattice: a grid of root squares whose sides are a power of two of raster cells, and the order of its diamonds.

A diamond is the pair of triangles that share a longest edge; splitting it makes one vertex, the edge's middle, so one
entry per diamond is one entry per vertex. Entries are kept level by level, coarsest first: a walk from the root touches
few cache lines and few pages however large the raster is.
"""

import math
from dataclasses import dataclass

import numpy as np

# A raster that needs more root squares than this along its short side is resampled instead: the coarsest mesh has two
# triangles a root square.
MAX_SHORT_SIDE_SQUARES = 16


@dataclass(frozen=True)
class Lattice:
    """`columns` x `rows` root squares of `2**levels` cells a side; a cell is `step_x` by `step_y` metres."""

    columns: int
    rows: int
    levels: int
    step_x: float = 1.0
    step_y: float = 1.0

    @property
    def width(self) -> int:
        """Samples from west to east."""
        return (self.columns << self.levels) + 1

    @property
    def height(self) -> int:
        """Samples from south to north."""
        return (self.rows << self.levels) + 1

    @property
    def squares(self) -> int:
        return self.columns * self.rows

    @property
    def square_bits(self) -> int:
        """Levels of the binary tree above the root squares: ceil(log2(squares))."""
        return (self.squares - 1).bit_length()

    @property
    def cell_depth(self) -> int:
        """Depth, inside a square, of the diamonds whose longest edge is the diagonal of one raster cell."""
        return 2 * self.levels + 1

    def level_shape(self, depth: int) -> tuple[int, int]:
        """Rows and row length of the array of diamonds at `depth` (1 .. cell_depth) inside a square.

        Odd depths hold the centres of square cells; even depths the middles of their sides, two lattice rows a cell,
        where a row between cells is one entry longer than a row through centres (the last entry is then unused).
        """
        half = (depth - 1) // 2
        if depth % 2:
            return self.rows << half, self.columns << half
        return (self.rows << (half + 1)) + 1, (self.columns << half) + 1

    def offsets(self) -> np.ndarray:
        """int64 [cell_depth + 2]: first entry of each depth (entry 0 unused), then the total."""
        sizes = [0] + [math.prod(self.level_shape(d)) for d in range(1, self.cell_depth + 1)]
        return np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)

    def node_offset(self, depth: int) -> int:
        return int(self.offsets()[depth])

    @property
    def node_count(self) -> int:
        """Diamonds down to the single cells of the raster."""
        return int(self.offsets()[-1])


def fit(width: int, height: int) -> tuple[int, int, int]:
    """Columns, rows and levels of the lattice for a raster of `width` x `height` samples (each at least 2).

    Exact where the raster is `m 2^k + 1` by `n 2^k + 1` with few squares, else the smallest lattice that is at least as
    fine in both directions.
    """
    cells_x, cells_y = width - 1, height - 1
    short = min(cells_x, cells_y)
    common = math.gcd(cells_x, cells_y)
    levels = (common & -common).bit_length() - 1
    if short >> levels <= MAX_SHORT_SIDE_SQUARES:
        return cells_x >> levels, cells_y >> levels, levels
    levels = 0
    while -(-short >> levels) > MAX_SHORT_SIDE_SQUARES:
        levels += 1
    return -(-cells_x >> levels), -(-cells_y >> levels), levels
