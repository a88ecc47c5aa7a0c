# SPDX-License-Identifier: GPL-3.0-or-later
"""The bicubic surface with finer tiles by other code: point by point, from the four finer samples around each."""

from collections.abc import Callable

import numpy as np
from adaptive_terrain.cbt_terrain.field.heightfield import HeightField
from detail_surface import bilinear

SIDE = 256  # finer cells along a tile
Heights = Callable[[np.ndarray], np.ndarray]


def heights_with_tiles(field: HeightField, plane: np.ndarray, bicubic: Heights) -> np.ndarray:
    """Return the heights of a bicubic surface with finer tiles at points [n, 2].

    bicubic: returns the heights of the raster's bicubic surface at points.
    """
    lattice, count = field.lattice, 1 << field.raster.finer.bits
    low, steps = np.array(lattice.rectangle()[:2]), np.array([lattice.step_x, lattice.step_y]) / count
    cells = np.array([lattice.cells_x, lattice.cells_y]) * count
    at = (plane - low) / steps
    corner = np.clip(np.floor(at).astype(int), 0, cells - 1)
    part = at - corner
    found = bicubic(plane)
    for across, up in ((0, 0), (1, 0), (0, 1), (1, 1)):
        node = corner + (across, up)
        weight = np.abs(1 - across - part[:, 0]) * np.abs(1 - up - part[:, 1])
        found = found + weight * _differences(field, node, low + node * steps, bicubic)
    return found


def _differences(field: HeightField, node: np.ndarray, plane: np.ndarray, bicubic: Heights) -> np.ndarray:
    """Return the differences from the bicubic surface at finer samples; node: column and row, plane: position."""
    lattice, tiles = field.lattice, field.raster.finer
    heights, is_there = np.zeros(len(node)), np.zeros(len(node), bool)
    for row, column in np.argwhere(tiles.numbers >= 0):
        x, y = (node - SIDE * np.array([column, row])).T
        inside = (x >= 0) & (y >= 0) & (x <= SIDE) & (y <= SIDE)
        heights[inside] = tiles.heights[tiles.numbers[row, column], 1 + y[inside], 1 + x[inside]]
        is_there |= inside
    found, node, plane = np.zeros(len(node)), node[is_there], plane[is_there]
    flat = bilinear(lattice, np.asarray(field.heights(), np.float64), plane)
    found[is_there] = (heights[is_there] - flat) - _weights(field, node) * (bicubic(plane) - flat)
    return found


def _weights(field: HeightField, node: np.ndarray) -> np.ndarray:
    """Return the weights of finer heights: the distance from the nearest tile without any, as a part of a margin."""
    lattice, tiles = field.lattice, field.raster.finer
    margin = min(2 << tiles.bits, SIDE // 2)
    rows, columns = (-(-(cells << tiles.bits) // SIDE) for cells in (lattice.cells_y, lattice.cells_x))
    there = tiles.numbers >= 0  # also beyond the border
    nearest = np.full(len(node), margin)
    away_x, away_y = (
        [np.maximum(np.maximum(SIDE * n - at, at - SIDE * n - SIDE), 0) for n in range(count)]
        for at, count in zip(np.ascontiguousarray(node.T), (columns, rows), strict=True)
    )
    for row, column in np.ndindex(rows, columns):
        if not there[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2].all():
            np.minimum(nearest, np.maximum(away_x[column], away_y[row]), out=nearest)
    return nearest / margin
