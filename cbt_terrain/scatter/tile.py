# SPDX-License-Identifier: GPL-3.0-or-later
"""The tile that a scatter repeats: one progressive blue-noise set, cut into squares of several sizes.

Ranks are those of the whole tile, not of a square: so of the few points of a thin scatter the nearest repetition is a
tile away, 128 times the spacing at full density, and no square has a first point of its own that would make a lattice.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from ...kernels.scatter import tile as kernels
from ..run import launch
from ..run.buffers import flat, shared

POINTS = 1 << 14  # of a tile
FINEST = 4  # halvings of a side; the smallest squares have 64 points
UNITS = 1 << 16  # of a side, in which points are


@dataclass(frozen=True, eq=False)
class Tile:
    """`place`: int32 [POINTS, 2], the point of each rank, in units. Of each halving (0 .. FINEST): `order`, int32
    [POINTS], ranks square by square (row by row from the south-west), in a square from low to high; `first`, int64
    [squares + 1], where those of a square begin; `keys`, int64 [POINTS], ascending: square and rank in one number."""

    place: np.ndarray
    order: list[np.ndarray]
    first: list[np.ndarray]
    keys: list[np.ndarray]

    def count(self, halvings: int, square: np.ndarray, ranks: np.ndarray) -> np.ndarray:
        """int64 [n]: how many points of squares have a rank below `ranks`; both int64 [n]."""
        return np.searchsorted(self.keys[halvings], _key(square, ranks)) - self.first[halvings][square]

    def runs(self, halvings: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """int64 [n], int64 [n]: where the ranks of squares begin in all of `order`, one halving after the other, and
        how many there are. halvings, square: int [n]."""
        ends = np.concatenate(self.first)
        row = (np.cumsum([0, *map(len, self.first)]))[halvings] + square
        return halvings * POINTS + ends[row], ends[row + 1] - ends[row]


@cache
def tile() -> Tile:
    """The one tile, made when it is first asked for: whole numbers, so the same on every machine."""
    side = 1 << int(kernels.BITS)
    near, place = np.full(side * side, side * side, np.int32), np.empty((POINTS, 2), np.int32)
    launch.once(kernels.best_candidates, [POINTS, flat(near, wp.int32), shared(place, wp.vec2i)], step="scatter tile")
    order, first, keys = [], [], []
    for halvings in range(FINEST + 1):
        x, y = (place * (1 << halvings) // UNITS).T
        square = (y << halvings) + x
        order.append(np.argsort(square, kind="stable").astype(np.int32))
        first.append(np.searchsorted(square[order[-1]], np.arange(4**halvings + 1)).astype(np.int64))
        keys.append(_key(square[order[-1]].astype(np.int64), order[-1]))
    return Tile(place, order, first, keys)


def _key(square: np.ndarray, rank: np.ndarray) -> np.ndarray:
    return square * (POINTS + 1) + rank
