# SPDX-License-Identifier: GPL-3.0-or-later
"""Preparation of a raster's samples: heights in float32, and missing samples filled."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from ...kernels.field import fill as fill_kernels
from ..errors import TerrainError
from ..run import launch
from ..run.buffers import flat

COLUMN_BLOCK = 64  # columns of a work item
FILLED_ROWS = 128  # rows whose missing samples are filled together
# Differences of larger heights overflow float32; an undeclared no-data value is the usual cause.
LARGEST_HEIGHT = 1e30  # metres; float32 has 1.00000002e30 instead, which is beyond


def clean_rows(rows: np.ndarray, name: str = "The raster") -> tuple[np.ndarray, int]:
    """Return a float32 copy of rows with NaN for missing samples and no negative zeros, and the number of the missing.

    NaN and infinities are missing. Raises TerrainError for a height beyond LARGEST_HEIGHT, also if it is infinite in
    float32. name: the raster's, in the error.
    """
    with np.errstate(over="ignore"):
        heights = rows.astype(np.float32) + np.float32(0.0)  # -0 becomes 0
    missing = ~np.isfinite(heights)
    count = int(np.count_nonzero(missing))
    if count:  # a finite number that is infinite in float32 is an error
        _check_heights(rows[missing], name)
        heights[missing] = np.nan
    if count < heights.size and largest_of(heights) > LARGEST_HEIGHT:
        _check_heights(heights, name)
    return heights, count


def _check_heights(heights: np.ndarray, name: str) -> None:
    """Raise TerrainError if the largest finite height is beyond LARGEST_HEIGHT. name: the raster's."""
    finite = heights[np.isfinite(heights)]
    height = float(finite[np.argmax(np.abs(finite))]) if finite.size else 0.0
    if abs(height) > LARGEST_HEIGHT:
        raise TerrainError(
            f"{name} holds a height of {height:.8g} m",
            expected="less than 1e30 m above or below 0",
            fix="if it marks missing data, give it as the no-data value",
        )


def largest_of(rows: np.ndarray) -> float:
    """Return the largest absolute value of rows that are not all NaN."""
    return float(max(np.fmax.reduce(rows, axis=None), -np.fmin.reduce(rows, axis=None)))


def fill_missing(samples: np.ndarray, threads: int) -> None:
    """Replace every NaN in `samples` (float32, in place) by the nearest valid sample, counted in samples.

    Of several equally near ones the westernmost counts, of these the southernmost. At least one sample must be valid.
    """
    fill_rows(lambda: samples, lambda rows: np.isnan(samples[rows]), samples.shape, threads)


def nearest_known(values: np.ndarray, threads: int) -> tuple[np.ndarray, np.ndarray]:
    """Return values with the nearest valid one where they are NaN, as `fill_missing`, and the distances to it.

    Distances are in samples, float64, and infinite if no value is valid. values: [rows, columns].
    """
    missing = np.isnan(values)
    if missing.all():
        return values, np.full(values.shape, np.inf)
    nowhere = np.full(values.shape[1], -1, np.int32)  # no valid rows below or above
    row, column = _nearest(missing, 0, nowhere, nowhere, threads)
    y, x = np.nonzero(missing)
    columns = column[y, x]
    rows = row[y, columns]
    filled, distances = values.copy(), np.zeros(values.shape)
    filled[y, x] = values[rows, columns]
    distances[y, x] = np.sqrt((rows - y).astype(np.float64) ** 2 + (columns - x).astype(np.float64) ** 2)
    return filled, distances


def fill_rows(
    opened: Callable[[], np.ndarray],
    missing_in: Callable[[slice], np.ndarray],
    shape: tuple[int, ...],
    threads: int,
) -> None:
    """Replace each missing sample of a raster that need not be in memory by the nearest valid one, as `fill_missing`.

    opened: maps the samples, of any type, for writing; it is called for each block of rows with missing ones.
    missing_in: returns, for rows, which samples are missing, bool; it is called three times for all rows, never after
    their samples are filled. shape: rows and columns of the raster.

    A chunk of rows needs, for each column, the nearest valid rows below and above it. Those below are known from the
    chunks before. Those above come from a first pass in descending order, which keeps them only at the ends of groups
    of chunks; inside a group they are found again. So memory holds about 2 sqrt(chunks) lines, not one for each chunk.
    """
    height, width = shape
    chunks = [slice(first, min(first + FILLED_ROWS, height)) for first in range(0, height, FILLED_ROWS)]
    length = math.isqrt(len(chunks)) + 1  # chunks of a group
    groups = [chunks[first : first + length] for first in range(0, len(chunks), length)]
    # `above`, `below`: for each column the number of the nearest row with a valid sample, -1 if there is none.
    above, ends = np.full(width, -1, np.int32), []  # ends: `above` at the end of each group
    for group in reversed(groups):
        ends.append(above)
        above = _rows_above(group, missing_in, above)[0]
    below = np.full(width, -1, np.int32)
    for group in groups:
        nearest_above = _rows_above(group, missing_in, ends.pop())  # at the start of each chunk and the group's end
        for number, rows in enumerate(group):
            missing = missing_in(rows)
            if missing.any():  # column: that of the sample nearest to each sample; row: its row, by row and column
                row, column = _nearest(missing, rows.start, below, nearest_above[number + 1], threads)
                samples, (y, x) = opened(), np.nonzero(missing)
                column = column[y, x]
                samples[rows.start + y, x] = samples[row[y, column], column]
            # Downwards from the chunk's last row; the old value stays where the chunk has no valid sample.
            below = _first_valid(~missing[::-1], range(rows.start, rows.stop)[::-1], below)


def _rows_above(
    chunks: Sequence[slice], missing_in: Callable[[slice], np.ndarray], beyond: np.ndarray
) -> list[np.ndarray]:
    """Return for each chunk, by column, the number of the first row at or above its start with a valid sample.

    Each item is int32 [columns], -1 for none. The last, additional one is `beyond`: the same from the end of the last
    chunk on. missing_in: returns, for rows, which samples are missing, bool. chunks: slices of rows, ascending.
    """
    above = [beyond]
    for rows in reversed(chunks):
        above.append(_first_valid(~missing_in(rows), range(rows.start, rows.stop), above[-1]))
    return above[::-1]


def _first_valid(valid: np.ndarray, rows: range, beyond: np.ndarray) -> np.ndarray:
    """Return, for each column, the first of `rows` with a valid sample, int32, or the column's entry of `beyond`.

    valid: bool [len(rows), columns], in the order of `rows`, which may count down. beyond: the answer for columns
    without a valid sample.
    """
    if valid[0].all():  # as in most rasters
        return np.full(valid.shape[1], rows[0], np.int32)
    return np.where(valid.any(axis=0), rows[0] + rows.step * valid.argmax(axis=0), beyond).astype(np.int32)


def _nearest(
    missing: np.ndarray, first: int, below: np.ndarray, above: np.ndarray, threads: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return, for rows from `first` on, the nearest valid row of each column, and the column of the nearest sample.

    Both are int32 like `missing`; the nearest valid sample of [y, x] is in column c = column[y, x], row nearest[y, c].
    Columns at valid samples are undefined. below, above: nearest valid rows outside these rows, -1 for none. Row
    numbers are those of the raster. This is the exact distance transform of Felzenszwalb and Huttenlocher (2012): each
    column's nearest row first, then in each row the lower envelope of the columns' parabolas of squared distances.
    """
    height, width = missing.shape
    nearest, column = np.empty((2, height, width), np.int32)
    nearest_array, mask = flat(nearest, wp.int32), flat(missing.view(np.uint8), wp.uint8)
    outer = [flat(np.ascontiguousarray(line), wp.int32) for line in (below, above)]
    inputs = [mask, width, height, first, *outer, COLUMN_BLOCK, nearest_array]
    cost, blocks = 0.5 * COLUMN_BLOCK * height, -(-width // COLUMN_BLOCK)
    launch.spread(fill_kernels.nearest_in_columns, blocks, inputs, step="fill no-data", threads=threads, cost=cost)
    jobs = []
    for begin, end in launch.ranges(height, threads):  # a range of rows for each thread
        # Memory for the lower envelope: columns of its parabolas, and where each begins.
        apex = wp.empty(width, dtype=wp.int32, device=launch.DEVICE)
        start = wp.empty(width, dtype=wp.float64, device=launch.DEVICE)
        jobs.append([mask, width, first, begin, end, nearest_array, apex, start, flat(column, wp.int32)])
    launch.slices(fill_kernels.nearest_columns, jobs, step="fill no-data")
    return nearest, column


def repeat_single_line(samples: np.ndarray) -> np.ndarray:
    """Repeat the samples of a raster that is one sample wide or high, because one row is a legitimate profile.

    Return a copy with at least two rows and columns. Raises TerrainError for an empty raster.
    """
    height, width = samples.shape
    if height == 0 or width == 0:
        raise TerrainError(f"The raster has {width} x {height} samples", expected="at least one")
    return np.repeat(np.repeat(samples, 2 if height == 1 else 1, axis=0), 2 if width == 1 else 1, axis=1)
