# SPDX-License-Identifier: GPL-3.0-or-later
"""The tile of a scatter: one progressive blue-noise set on a torus, listed by windows.

A point's rank is its number in the order in which points appear as the density grows. Every tile of the plan shows the
set with a random shift, so that nothing repeats, whatever the density. A square of a tile therefore shows a part of the
set that may wrap around: a window. For each halving of a tile's side there is a fixed number of windows, and for each
window the list of its points' ranks.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from ...kernels.scatter import seams
from ...kernels.scatter import tile as kernels
from ..run import launch
from ..run.buffers import flat, shared

POINTS = 1 << 14  # points of a tile
FINEST = int(seams.SQUARE_BITS)  # halvings of a side; the smallest squares have 64 points
UNITS = 1 << int(seams.UNIT_BITS)  # units of a side, in which positions are
SHIFTS = 1 << int(seams.SHIFT_BITS)  # shifts along each axis
# Number of window positions along a side for each halving. A whole tile has one, as it has all ranks wherever it
# starts.
STARTS = np.array([1, *(max(SHIFTS, 1 << halvings) for halvings in range(1, FINEST + 1))])


@dataclass(frozen=True, eq=False)
class Tile:
    """`place`: int32 [POINTS, 2], the point of each rank in units.

    For each halving (0 .. FINEST) and its windows, row by row from the south-west: `order`, int32, ascending ranks of
    each window; `first`, int64 [windows + 1], index of each window's first rank; `keys`, int64, ascending: window and
    rank in one number.
    """

    place: np.ndarray
    order: list[np.ndarray]
    first: list[np.ndarray]
    keys: list[np.ndarray]

    @property
    def length(self) -> int:
        """Return the number of ranks in `order`, which is stored for all halvings of the tile one after the other."""
        return sum(map(len, self.order))

    def windows(self, halvings: np.ndarray, square: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """Return the number of the window that each square shows, int64 [n].

        halvings: int [n], how many times a tile's side is halved to that of the square. square: int [n, 2], its column
        and row in the tile. shift: int [n, 2], that of the pattern in the tile, in sides / SHIFTS.
        """
        starts = STARTS[halvings][:, None]
        # In steps from one window's start to the next: the square's corner in the tile, less the shift of the pattern.
        column, row = ((square * (starts >> halvings[:, None]) - shift * starts // SHIFTS) % starts).T
        return row * starts[:, 0] + column

    def count(self, halvings: int, window: np.ndarray, ranks: np.ndarray) -> np.ndarray:
        """Return the number of points of each window with a rank below `ranks`, int64 [n].

        halvings: of the tile's side to that of the windows.
        """
        return np.searchsorted(self.keys[halvings], _rank_key(window, ranks)) - self.first[halvings][window]

    def runs(self, halvings: np.ndarray, window: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the first index of each window in all of `order`, and its number of ranks, int64 [n] each.

        halvings: int [n], of the tile's side to that of each window.
        """
        firsts = np.concatenate(self.first)
        entry = (np.cumsum([0, *map(len, self.first)]))[halvings] + window
        before = np.cumsum([0, *map(len, self.order)])[halvings]
        return before + firsts[entry], firsts[entry + 1] - firsts[entry]


@cache
def tile() -> Tile:
    """Return the tile of POINTS ranked points that every scatter repeats over its terrain.

    It is computed once, in integers, so it is the same on every machine.
    """
    side = 1 << int(kernels.BITS)
    # near: the kernel's scratch
    near, place = np.full(side * side, side * side, np.int32), np.empty((POINTS, 2), np.int32)
    launch.once(kernels.best_candidates, [POINTS, flat(near, wp.int32), shared(place, wp.vec2i)], step="scatter tile")
    order, first, keys = [], [], []
    for halvings, starts in enumerate(STARTS.tolist()):
        # starts: window positions along a side. Each point is in several windows: those that start up to a window's
        # side before it. column, row: of these starts, [POINTS, starts of a window's side]; window: row * starts +
        # column.
        column, row = (place[:, :, None] * starts // UNITS - np.arange(starts >> halvings)).transpose(1, 0, 2) % starts
        window = (row[:, :, None] * starts + column[:, None, :]).reshape(-1).astype(np.int64)
        keys.append(np.sort(_rank_key(window, np.repeat(np.arange(POINTS), (starts >> halvings) ** 2))))
        order.append((keys[-1] % (POINTS + 1)).astype(np.int32))  # the rank of each key
        first.append(np.searchsorted(keys[-1], _rank_key(np.arange(starts**2 + 1), 0)).astype(np.int64))
    return Tile(place, order, first, keys)


def shifts(tiles: np.ndarray, seed: int) -> np.ndarray:
    """Return the shifts of tiles (int32 [n, 2]: column, row) to the east and north in sides / SHIFTS, int32 [n, 2]."""
    tile_shifts = np.empty_like(tiles)
    inputs = [wp.uint32(seed), shared(tiles, wp.vec2i), shared(tile_shifts, wp.vec2i)]
    launch.spread(seams.write_shifts, len(tiles), inputs, step="squares")
    return tile_shifts


def _rank_key(window: np.ndarray, rank: np.ndarray | int) -> np.ndarray:
    """Return one number that sorts points by window and then by rank."""
    return window * (POINTS + 1) + rank
