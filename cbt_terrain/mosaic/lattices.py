# SPDX-License-Identifier: GPL-3.0-or-later
"""Lattices: tiles whose samples are on one grid of one coordinate system form one raster, interpolated across borders.

So neighbouring tiles have no gap between them, with or without a shared row of samples.
"""

import math
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
    """Group tiles whose samples are on a common grid (a lattice), and return the lattices.

    tiles: in the order of priority, ascending.
    """
    groups: dict[tuple, list[int]] = {}
    for number, tile in enumerate(tiles):
        groups.setdefault(_key(tile), []).append(number)
    lattices = []
    for numbers in groups.values():
        while numbers:  # a group may hold several lattices: take that of its first tile
            first = tiles[numbers[0]]
            offsets = {n: offset for n in numbers if (offset := _offset_of(first, tiles[n])) is not None}
            lattices.append(_lattice(tiles, offsets))
            numbers = [n for n in numbers if n not in offsets]
    return lattices


def _key(tile: SourceTile) -> tuple:
    """Return what tiles of one lattice have in common: system, steps, and where in a cell their first samples are.

    It only groups tiles, so that few are compared by `_offset_of`; hence the rounding. Cosines stand for the fractions
    of a cell, because one fraction may be close to 0 and another close to 1.
    """
    a, b, c, d, e, f = tile.transform
    x, y = tile.position(0, 0)
    if b == d == 0.0:
        fractions = (round(math.cos(2 * math.pi * (x / a)), 2), round(math.cos(2 * math.pi * (y / e)), 2))
    else:  # `_offset_of` tells turned lattices apart
        fractions = (0.0, 0.0)
    return tile.crs, *(float(f"{step:.6g}") for step in (a, b, d, e)), *fractions


def _offset_of(first: SourceTile, tile: SourceTile) -> tuple[int, int, float] | None:
    """Return column and row of a tile's first sample in the lattice of another, and how far its samples are off.

    Return None if they are off by more than MAX_OFF_GRID, or more than 2^30 columns or rows away.
    """
    a, b, _, d, e, _ = first.transform
    (x0, y0), corners = first.position(0, 0), ((0, 0), (tile.width - 1, 0), (0, tile.height - 1))
    x, y = np.array([tile.position(*corner) for corner in corners]).T
    u, v = _indices((x0, y0), (a, b, d, e), x, y)
    if not (np.isfinite(u).all() and np.isfinite(v).all()) or max(abs(u[0]), abs(v[0])) > 2.0**30:
        return None
    column, row = round(float(u[0])), round(float(v[0]))
    # the largest distance, along columns or rows, of three corner samples (i, j) from their places in the lattice
    deviation = max(float(max(abs(u[k] - column - i), abs(v[k] - row - j))) for k, (i, j) in enumerate(corners))
    return (column, row, deviation) if deviation <= MAX_OFF_GRID else None


def _lattice(tiles: Sequence[SourceTile], offsets: dict[int, tuple[int, int, float]]) -> TileLattice:
    """Return the lattice of the tiles numbered in `offsets`.

    offsets: by tile, the column and row of its first sample in the lattice of the first tile, and its distance from
    there in samples.
    """
    first = tiles[next(iter(offsets))]
    a, b, _, d, e, _ = first.transform
    rectangles = [
        (column, row, column + tiles[n].width - 1, row + tiles[n].height - 1) for n, (column, row, _) in offsets.items()
    ]
    deviation = max(offset for _, _, offset in offsets.values())
    period = period_of(first.crs) / a if d == 0.0 else 0.0  # columns in 360 degrees, if rows are parallels
    return TileLattice(
        crs=first.crs,
        origin=first.position(0, 0),
        steps=(a, b, d, e),
        tiles=np.array(list(offsets)),
        rectangles=np.array(rectangles, np.int64),
        off_grid=deviation if deviation > ROUNDING else 0.0,
        period=abs(round(period)) if abs(period - round(period)) < MAX_OFF_GRID else 0,
    )
