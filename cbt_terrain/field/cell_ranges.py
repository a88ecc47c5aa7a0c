# SPDX-License-Identifier: GPL-3.0-or-later
"""Ranges of heights over rectangles of the raster, from the stored ranges: no sample is read."""

from collections.abc import Sequence

import numpy as np

from .heightfield import HeightField
from .hierarchy import ranges_at
from .lattice import tile_index

# The stored ranges that are read are of cells of at most this fraction of the smallest rectangle's side.
FRACTION = 1 / 16
FINEST_BITS = 2  # the finest ranges are those of 4 x 4 cells


def rectangle_ranges(
    field: HeightField, columns: Sequence[tuple[float, float]], rows: Sequence[tuple[float, float]]
) -> np.ndarray:
    """Return a range of heights for each pair of a row and a column of rectangles, float64 [rows, columns, 2].

    Heights are metres before vertical scaling. A range encloses the ground of its rectangle, without the detail. It is
    no wider than the range of the rectangle with a margin of an eighth of the smallest rectangle's side, or of 8
    samples if that is more, apart from rounding and from the largest change of finer tiles. Where no ranges of that
    size are stored, all are the limits of the whole field, which include its detail: for a raster with a side of one or
    two cells, and for rectangles much larger than it.

    Args:
        columns: west and east side of each column, in samples from the raster's western border.
        rows: south and north side of each row.
    """
    lattice = field.lattice
    smallest = min(high - low for low, high in (*columns, *rows))
    # log2 of the side of the cells to read: at most FRACTION of the smallest rectangle's.
    bits = max(int(np.floor(np.log2(max(smallest * FRACTION, 1.0)))), FINEST_BITS)
    if bits > lattice.levels:
        return np.broadcast_to((field.min_height, field.max_height), (len(rows), len(columns), 2)).copy()
    ranges = _all_stored(field, bits).astype(np.float64)  # codes of the cells' ranges, [rows, columns, 2]
    for axis, sides in ((0, rows), (1, columns)):
        in_cells = np.array(sides) / 2.0**bits  # below, 1e-9: rounding must not add a cell
        first = np.clip(np.floor(in_cells[:, 0] + 1e-9).astype(int), 0, ranges.shape[axis] - 1)
        end = np.clip(np.ceil(in_cells[:, 1] - 1e-9).astype(int), first + 1, ranges.shape[axis])
        # `reduceat` also reduces from each end to the next first cell: every other result is used.
        pairs = np.stack([first, end], axis=1).ravel()
        # One more cell, because an end may be the number of cells, and `reduceat` needs indices inside the array.
        padded = np.concatenate([ranges, np.take(ranges, [-1], axis=axis)], axis=axis)
        low = np.minimum.reduceat(padded[..., 0], pairs, axis=axis).take(range(0, len(pairs), 2), axis=axis)
        high = np.maximum.reduceat(padded[..., 1], pairs, axis=axis).take(range(0, len(pairs), 2), axis=axis)
        ranges = np.stack([low, high], axis=-1)
    return _heights(field, ranges)  # codes to metres


def cell_ranges(field: HeightField, bits: int, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return ranges of heights, metres before vertical scaling, of some cells of 2^bits samples a side.

    The result is float64 [..., 2] for integer arrays of columns and rows, from the south-west, that broadcast to [...].
    bits: FINEST_BITS to lattice.levels.
    """
    return _heights(field, _stored(field, bits, columns, rows).astype(np.float64))


def _heights(field: HeightField, ranges: np.ndarray) -> np.ndarray:
    """Return stored ranges [..., 2] as metres, with the largest change of finer tiles."""
    change = field.finer.max_change if field.finer is not None else 0.0
    return field.range_base + ranges * field.range_step + (-change, change)


def _all_stored(field: HeightField, bits: int) -> np.ndarray:
    """Return the stored ranges, uint16 [rows, columns, 2], row 0 south, of all cells of 2^bits samples a side.

    bits: FINEST_BITS to lattice.levels.
    """
    columns, rows = (np.arange(-(-cells >> bits)) for cells in (field.lattice.cells_x, field.lattice.cells_y))
    return _stored(field, bits, columns, rows[:, None])


def _stored(field: HeightField, bits: int, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the stored ranges, uint16 [..., 2], of cells of 2^bits samples a side.

    columns, rows: integers that broadcast to [...]. A range is that of the diamond in the cell's centre, which encloses
    its box.
    """
    # In a root square of 2^levels samples a side, odd depths 2q + 1 hold the centres of cells of 2^(levels - q).
    depth = ranges_at(field.lattice, 2 * (field.lattice.levels - bits) + 1)
    # A cell's diamond is stored at the vertex (first + column * step, first + row * step) of an image in pages.
    x, y = (depth.first + places.astype(np.int64) * depth.step for places in (columns, rows))
    return field.ranges[depth.base + tile_index(x, y, depth.pages)]
