# SPDX-License-Identifier: GPL-3.0-or-later
"""Which squares of the plan views may want points of, and how many ranks of each.

A quadtree over the plan: tiles in its middle, above them squares of 2 x 2 tiles and so on, below them the squares that
the tile is cut into. A square is taken whole where few points of it are wanted, or about as many all over it.
"""

from dataclasses import dataclass

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.field.layout import Depth
from ...kernels.scatter import squares as kernels
from ...kernels.scatter.points import GROWING
from ...kernels.scatter.seen import Views
from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..field.hierarchy import ranges_at
from ..run import launch
from ..run.buffers import shared
from .tile import FINEST, POINTS, shifts, tile

FEW = 64  # points of a square that is not worth cutting
EVEN = 1.5  # times the least that is wanted of a square, the most of one that is not cut
MOST_CANDIDATES = 1 << 26  # 3.4 GB
MOST_CUT = MOST_CANDIDATES // (4 * FEW)  # of a size; each has more points than a few
TOO_MANY = (
    "The scatter has {} points in view{}: make its spacing larger, or let its full density end nearer to the camera "
    "(Full Until; at 0 it never ends)."
)
NOTHING = np.empty(0, np.int32), np.empty((0, 2), np.int32), np.empty(0, np.int64), np.empty(0, bool)


@dataclass(frozen=True)
class Squares:
    """`halvings`: int32 [n], of the tile's side. `number`: int32 [n, 2], column and row among the squares of that size,
    those of tile (0, 0) first. `count`: int64 [n], how many points of each square may be wanted: those of the lowest
    ranks. `clear`: bool [n], whether a frame has all of it."""

    halvings: np.ndarray
    number: np.ndarray
    count: np.ndarray
    clear: np.ndarray

    def of_tile(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """int32 [n, 2], int64 [n]: the tile of each square, and the number of its window."""
        tiles = self.number >> self.halvings[:, None]
        inside = self.number & ((1 << self.halvings) - 1)[:, None]
        return tiles, tile().windows(self.halvings, inside, shifts(tiles, seed))


def squares_wanted(
    field: HeightField,
    domain: Domain,
    views: Views,
    west: float,
    south: float,
    side: float,
    seed: int,
    densest: float,
    threads: int,
) -> Squares:
    """Of tiles of `side` metres, the first of which has its south-western corner at `west`, `south`; density is
    `densest` at most, 0 .. 1.

    Raises TerrainError for more than MOST_CANDIDATES points.
    """
    _, _, east, north = field.lattice.rectangle()
    tiles = max(1.0, (east - west) / side, (north - south) / side)
    halvings = -max(0, int(np.ceil(np.log2(tiles))))
    numbers, found = np.zeros((1, 2), np.int32), []
    while len(numbers):
        wanted = np.empty((len(numbers), 2))
        q = _packed(field, west, south, side * 2.0**-halvings)
        arrays = [shared(numbers, wp.vec2i), wp.array(wanted, dtype=wp.vec2d, device=launch.DEVICE, copy=False)]
        inputs = [domain, views, q, wp.float64(east), wp.float64(north), *arrays]
        launch.spread(kernels.look, len(numbers), inputs, step="squares", threads=threads, cost=10.0)
        most, least = wanted.T
        # Ranks r = (rank + 1/2) / POINTS that are there or growing, and what rounding of a density could add.
        there = most * densest * (float(GROWING) * (1 + 1e-6))
        ranks = np.minimum(np.ceil(there * POINTS - 0.5), POINTS).astype(np.int64)
        cut = ranks > 0
        if halvings >= 0:
            depth = np.full(len(numbers), halvings, np.int32)
            count = tile().count(halvings, Squares(depth, numbers, ranks, cut).of_tile(seed)[1], ranks)
            cut &= (count > FEW) & (most > EVEN * least) & (halvings < FINEST)
            taken = ~cut & (count > 0)
            found.append((depth[taken], numbers[taken], count[taken], least[taken] > 0))
        if cut.sum() > MOST_CUT:
            raise TerrainError(TOO_MANY.format(f"more than {MOST_CANDIDATES:,}", ""))
        numbers = _children(numbers[cut])
        halvings += 1
    squares = Squares(*map(np.concatenate, zip(NOTHING, *found, strict=True)))
    if squares.count.sum() > MOST_CANDIDATES:
        raise TerrainError(TOO_MANY.format(f"more than {MOST_CANDIDATES:,}", ""))
    return squares


def _children(numbers: np.ndarray) -> np.ndarray:
    """int32 [4 n, 2]: the quarters of squares."""
    quarters = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.int32)
    return (2 * numbers[:, None] + quarters).reshape(-1, 2)


def _packed(field: HeightField, west: float, south: float, side: float) -> kernels.Squares:
    """Squares of a size, with the ranges of heights of the smallest lattice cells that are no smaller."""
    lattice, q = field.lattice, kernels.Squares()
    q.west, q.south, q.side, q.low, q.high = west, south, side, field.min_height, field.max_height
    cells = max(side / min(lattice.step_x, lattice.step_y), 4.0)  # ranges are of 4 x 4 cells and more
    bits = int(np.ceil(np.log2(cells * (1 + 1e-9))))
    q.ranges = Depth()
    if bits <= lattice.levels:
        q.ranges = ranges_at(lattice, 2 * (lattice.levels - bits) + 1)
        q.cell_x, q.cell_y = lattice.step_x * 2.0**bits, lattice.step_y * 2.0**bits
    return q
