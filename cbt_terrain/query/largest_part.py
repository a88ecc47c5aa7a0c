# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples of the largest part of a terrain's ground, which has no holes and no wide gaps around it."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..field.finer_tiles import SIDE, FinerTiles
from ..field.heightfield import HeightField
from ..field.known_ground import known_tiles_of
from ..field.lattice import Lattice

Cell = tuple[int, int]  # row and column


class PartSamples(NamedTuple):
    """Samples on a grid over the rectangle around a part of a terrain.

    Attributes:
        x, y: positions of columns [n] and rows [m] in the terrain's space, metres, ascending.
        heights: float64 [m, n], metres, also where there is no ground.
        is_ground: bool [m, n], False in holes and in gaps between the files of a mosaic.
    """

    x: np.ndarray
    y: np.ndarray
    heights: np.ndarray
    is_ground: np.ndarray


def sample_largest_part(field: HeightField, count: int, covered: np.ndarray | None = None) -> PartSamples:
    """Return at most `count` samples a side of the largest connected part of a terrain's ground.

    A terrain without holes and gaps is one part; so is one whose ground is missed by `count` samples a side. Finer
    tiles count in a mosaic with wide gaps only. covered: bool [rows, columns], points at which a file of a mosaic is,
    spread evenly from the first sample to the last, row 0 south; None if all of it has ground or holes.
    """
    lattice, tiles = field.lattice, known_tiles_of(field)
    if tiles is not None and field.raster.finer is not None:  # a part may be smaller than a few samples of the raster
        box = SIDE * largest_box(tiles.is_known)
        last = np.array([lattice.cells_y, lattice.cells_x]) << field.raster.finer.bits
        rows, columns = (_spread(low, high, count) for low, high in np.minimum(box, last[:, None]))
        is_ground = tiles.is_known[np.ix_(rows // SIDE, columns // SIDE)]
        return _finer_samples(field, field.raster.finer, rows, columns, is_ground)
    rows, columns = _spread(0, lattice.height - 1, count), _spread(0, lattice.width - 1, count)
    is_ground = _is_ground(field, covered, rows, columns)
    if is_ground.any() and not is_ground.all():
        # From the sample before the part to the one after it.
        (south, north), (west, east) = largest_box(is_ground)
        rows = _spread(rows[max(south - 1, 0)], rows[min(north, len(rows) - 1)], count)
        columns = _spread(columns[max(west - 1, 0)], columns[min(east, len(columns) - 1)], count)
        is_ground = _is_ground(field, covered, rows, columns)
    else:
        is_ground = np.ones_like(is_ground)
    heights = field.heights(*np.ix_(rows, columns)).astype(np.float64)
    return PartSamples(*_positions(lattice, rows, columns, parts=1), heights, is_ground)


def _spread(first: int, last: int, count: int) -> np.ndarray:
    """Return at most `count` evenly spread whole numbers from `first` to `last`."""
    return np.unique(np.linspace(first, last, count).round().astype(int))


def _is_ground(field: HeightField, covered: np.ndarray | None, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return whether samples are in no hole, and near a point where a file is: bool [rows, columns].

    covered: as in `sample_largest_part`. Marks of holes are more exact, so it counts only without them.
    """
    if field.valid is not None:
        return field.valid[np.ix_(rows, columns)] > 0
    if covered is None:
        return np.ones((len(rows), len(columns)), bool)
    sizes = zip((rows, columns), (field.lattice.height, field.lattice.width), covered.shape, strict=True)
    return covered[np.ix_(*(np.rint(at * ((points - 1) / (size - 1))).astype(int) for at, size, points in sizes))]


def _finer_samples(
    field: HeightField, finer: FinerTiles, rows: np.ndarray, columns: np.ndarray, is_ground: np.ndarray
) -> PartSamples:
    """Return samples of finer tiles, in other places those of the raster.

    rows, columns: of finer samples. is_ground: bool [rows, columns], False where no file is; holes of the raster are no
    ground either.
    """
    raster_rows, raster_columns = rows >> finer.bits, columns >> finer.bits
    heights = field.heights(*np.ix_(raster_rows, raster_columns)).astype(np.float64)
    numbers = finer.numbers[np.ix_(rows // SIDE, columns // SIDE)]
    row, column = np.nonzero(numbers >= 0)
    # A tile begins with a row and a column of the tiles before it.
    inner_row, inner_column = 1 + rows[row] % SIDE, 1 + columns[column] % SIDE
    heights[row, column] = finer.heights[numbers[row, column], inner_row, inner_column]
    positions = _positions(field.lattice, rows, columns, parts=1 << finer.bits)
    return PartSamples(*positions, heights, is_ground & _is_ground(field, None, raster_rows, raster_columns))


def _positions(lattice: Lattice, rows: np.ndarray, columns: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of columns and rows in the terrain's space, metres. parts: of these along a cell of the raster."""
    x = (columns / parts - (lattice.width - 1) / 2) * lattice.step_x - lattice.anchor_x
    y = (rows / parts - (lattice.height - 1) / 2) * lattice.step_y - lattice.anchor_y
    return x, y


def largest_box(is_ground: np.ndarray) -> np.ndarray:
    """Return the box of the largest connected part of a mask: [[first row, end row], [first column, end column]].

    Cells are connected that meet at a side or a corner. is_ground: bool [rows, columns], True somewhere.
    """
    rest: dict[Cell, None] = dict.fromkeys(zip(*(index.tolist() for index in np.nonzero(is_ground)), strict=True))
    largest: list[Cell] = []
    while len(rest) > len(largest):
        part = [rest.popitem()[0]]
        for cell in part:  # it grows meanwhile
            for neighbour in _around(cell):
                if neighbour in rest:
                    del rest[neighbour]
                    part.append(neighbour)
        largest = max(part, largest, key=len)
    cells = np.array(largest)
    return np.stack([cells.min(axis=0), cells.max(axis=0) + 1], axis=1)


def _around(cell: Cell) -> Iterator[Cell]:
    """Yield the cells that meet a cell."""
    for row in range(cell[0] - 1, cell[0] + 2):
        for column in range(cell[1] - 1, cell[1] + 2):
            yield row, column
