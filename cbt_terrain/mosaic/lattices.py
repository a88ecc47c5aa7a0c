# SPDX-License-Identifier: GPL-3.0-or-later
"""Lattices: tiles whose samples are on one grid of one coordinate system form one raster, interpolated across borders.

So neighbouring tiles have no gap between them, with or without a shared row of samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .catalogue import SourceTile
from .systems import period_of

# Largest distance, samples, of a tile's samples from the lattice that it joins.
MAX_OFF_GRID = 1e-3
# A distance below this, samples, is the rounding of coordinates.
ROUNDING = 1e-7


@dataclass(frozen=True)
class TileLattice:
    """Tiles on one grid.

    Attributes:
        crs: name of the coordinate system.
        origin: x and y of sample (0, 0).
        steps: (a, b, d, e): a column adds (a, d) to (x, y), a row (b, e).
        tiles: numbers of the tiles in the order of priority, ascending.
        rectangles: int64 [tiles, 4], first column and row and the last ones, of each tile.
        off_grid: largest distance of a tile's samples from the lattice's, samples.
        period: columns in 360 degrees, 0 if there are none.
    """

    crs: str
    origin: tuple[float, float]
    steps: tuple[float, float, float, float]
    tiles: np.ndarray
    rectangles: np.ndarray
    off_grid: float
    period: int

    def indices(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return columns and rows, float64, of positions in the lattice's system."""
        return _indices(self.origin, self.steps, x, y)

    def positions(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return x and y, in the lattice's coordinate system, of columns u and rows v."""
        a, b, d, e = self.steps
        return self.origin[0] + a * u + b * v, self.origin[1] + d * u + e * v

    def covers(self, number: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return which positions are in the cells of a tile, also a turn of 360 degrees away.

        number: of the tile in `tiles`. x, y: positions in the lattice's system; those that are not finite are outside.
        """
        first_u, first_v, last_u, last_v = self.rectangles[number]
        period = period_of(self.crs)
        with np.errstate(invalid="ignore"):
            if period:
                middle = self.positions((first_u + last_u) / 2, (first_v + last_v) / 2)[0]
                x = x - period * np.round((x - middle) / period)
            u, v = self.indices(x, y)
            return (u >= first_u - 0.5) & (u < last_u + 0.5) & (v >= first_v - 0.5) & (v < last_v + 0.5)


def _indices(origin: tuple, steps: tuple, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows of positions, by the inverse of the steps.

    origin: position of sample (0, 0). steps: (a, b, d, e), of which a column adds (a, d) to a position, a row (b, e).
    x, y: the positions.
    """
    (a, b, d, e), dx, dy = steps, x - origin[0], y - origin[1]
    if b == d == 0.0:
        return dx / a, dy / e
    area = a * e - b * d
    return (e * dx - b * dy) / area, (a * dy - d * dx) / area


def find_lattices(tiles: Sequence[SourceTile]) -> list[TileLattice]:
    """Group tiles whose samples are on a common grid (a lattice), and return the lattices in the order of first tiles.

    tiles: in the order of priority, ascending.
    """
    _, systems = np.unique([tile.crs for tile in tiles], return_inverse=True)  # number of each tile's system
    sizes = np.array([(tile.width, tile.height) for tile in tiles], np.int64).reshape(-1, 2)
    spans = np.maximum(sizes - 1, 1)  # from the first sample to the last one, or to a second one that is not there
    x, y = _corners(tiles, spans)
    lattices, left, is_left = [], np.arange(len(tiles)), np.ones(len(tiles), bool)
    while len(left):  # take the lattice of the first tile that is left
        first = tiles[left[0]]
        u, v = _indices_in(first, x[left, 0], y[left, 0])  # most tiles of other lattices are found by one corner
        may_join = (abs(u - np.rint(u)) <= MAX_OFF_GRID) & (abs(v - np.rint(v)) <= MAX_OFF_GRID)
        may_join &= systems[left] == systems[left[0]]
        may_join[0] = True
        numbers = left[may_join]
        places, off_grid = _offsets(first, x[numbers], y[numbers], spans[numbers])
        joins = (off_grid <= MAX_OFF_GRID) | (numbers == left[0])
        numbers = numbers[joins]
        lattices.append(_lattice(first, numbers, places[joins], sizes[numbers], off_grid[joins]))
        is_left[numbers] = False
        left = left[is_left[left]]
    return lattices


def _corners(tiles: Sequence[SourceTile], spans: np.ndarray) -> np.ndarray:
    """Return x and y of the first sample of each tile, of one `spans` columns and of one `spans` rows away.

    The result is float64 [2, tiles, 3]. spans: int64 [tiles, 2].
    """
    a, b, c, d, e, f = np.array([tile.transform for tile in tiles], np.float64).reshape(-1, 6).T[:, :, None]
    u, v = spans[:, :1] * (0, 1, 0) + 0.5, spans[:, 1:] * (0, 0, 1) + 0.5
    return np.stack([a * u + b * v + c, d * u + e * v + f])


def _indices_in(first: SourceTile, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return columns and rows, float64, of positions in the lattice of a tile, counted from its first sample."""
    a, b, _, d, e, _ = first.transform
    return _indices(first.position(0, 0), (a, b, d, e), x, y)


def _offsets(first: SourceTile, x: np.ndarray, y: np.ndarray, spans: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where tiles are in the lattice of another one, and how far their samples are off it.

    The first result is int64 [tiles, 2], column and row of the first sample. The second is float64 [tiles], the largest
    distance of the corners in samples; infinite for a tile more than 2^30 columns or rows away.

    Args:
        first: the tile whose lattice it is.
        x, y: float64 [tiles, 3], the tiles' corners.
        spans: int64 [tiles, 2], columns and rows between them.
    """
    u, v = _indices_in(first, x, y)
    is_near = np.isfinite(u).all(1) & np.isfinite(v).all(1) & (np.maximum(abs(u[:, 0]), abs(v[:, 0])) <= 2.0**30)
    places = np.where(is_near[:, None], np.rint(np.stack([u[:, 0], v[:, 0]], axis=1)), 0.0).astype(np.int64)
    off_u = abs(u - places[:, :1] - spans[:, :1] * (0, 1, 0))
    off_v = abs(v - places[:, 1:] - spans[:, 1:] * (0, 0, 1))
    return places, np.where(is_near, np.maximum(off_u, off_v).max(axis=1), np.inf)


def _lattice(
    first: SourceTile, numbers: np.ndarray, places: np.ndarray, sizes: np.ndarray, off_grid: np.ndarray
) -> TileLattice:
    """Return the lattice of a tile and those that join it.

    Args:
        first: the tile.
        numbers: int64 [tiles], of all its tiles.
        places: int64 [tiles, 2], column and row of the first sample of each.
        sizes: int64 [tiles, 2], columns and rows of each.
        off_grid: float64 [tiles], distance of each from the lattice in samples.
    """
    a, b, _, d, e, _ = first.transform
    deviation = float(off_grid.max())
    period = period_of(first.crs) / a if d == 0.0 else 0.0  # columns in 360 degrees, if rows are parallels
    return TileLattice(
        crs=first.crs,
        origin=first.position(0, 0),
        steps=(a, b, d, e),
        tiles=numbers,
        rectangles=np.concatenate([places, places + sizes - 1], axis=1),
        off_grid=deviation if deviation > ROUNDING else 0.0,
        period=abs(round(period)) if abs(period - round(period)) < MAX_OFF_GRID else 0,
    )
