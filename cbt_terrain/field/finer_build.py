# SPDX-License-Identifier: GPL-3.0-or-later
"""Computation of finer tiles (finer_tiles.py): their heights, the errors of the change, and the ranges of heights.

The *change* is the surface with finer heights minus that of the raster. Arguments of all functions:

    plain     the raster's bilinear field, without finer tiles
    bits      a raster cell has 2^bits finer cells a side
    numbers   int32 [rows, columns] of the table of tiles: index of each in the arrays of tiles, -1 without a tile
    heights   float32 [tiles, STRIDE, STRIDE] metres, the samples of each tile and one more on each side
    records   results of an earlier attempt or store, which are used again where their inputs are the same; kinds:
              LIMITED, the limits of a tile's change; MEASURED, its errors; RANGED, its ranges of heights
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np

from ...kernels.field import finer as kernels
from ..errors import TerrainError
from ..run import launch
from . import codes, hierarchy
from .blocks import halvings
from .build import Allocate, in_memory
from .digests import digest_of
from .finer_heights import (
    LIMITED,
    MEASURED,
    RANGED,
    FinerRecords,
    Tile,
    fill_heights,
    raster_heights,
    window_of,
)
from .finer_measures import MeasuredFinerTile, MeasuredRectangle, fill_errors, fill_ranges, limits_of
from .finer_reuse import inputs_of_tiles, is_measured, limits_before
from .finer_tiles import MAX_BITS, SIDE, STRIDE, TILE_BITS, FinerTiles, tile_shape
from .heightfield import HeightField
from .lattice import Lattice, TileBox

BLOCK = 8  # tiles along a side of the squares that are measured together
# Returns the heights of a raster's surface from the raster, bits, finer columns and rows.
SurfaceAt = Callable[[HeightField, int, np.ndarray, np.ndarray], np.ndarray]


def with_finer_tiles(
    plain: HeightField,
    bits: int,
    known: Iterable[Tile],
    read: Callable[[TileBox], np.ndarray],
    threads: int | None = None,
    allocate: Allocate = in_memory,
    on_progress: Callable[[float], None] = lambda _fraction: None,
    records: FinerRecords | None = None,
) -> HeightField:
    """Return a bilinear field whose surface has finer heights in some tiles.

    Args:
        plain: without finer tiles.
        bits: a raster cell becomes 2^bits x 2^bits finer cells.
        known: column and row of each tile with finer heights, from the raster's south-western corner.
        read: read(box) returns heights of finer samples, float32 [rows, columns] metres, row 0 south; NaN where only
            the raster is known. Samples that two tiles share must be equal.
        allocate: allocate(name, shape, dtype) returns a zeroed array, or one that an earlier attempt has left.
        records: of the earlier attempt, and of an earlier store. What has no record, or differs from its checksum, is
            made again.

    Raises TerrainError for a bicubic surface, a detail or other finer tiles, for `bits` out of range, for tiles outside
    of the raster, and for heights of another shape from `read`.
    """
    _check(plain, bits)
    shape = tile_shape(plain.lattice, bits)
    known = sorted(set(known), key=lambda tile: (*window_of(tile), tile[1], tile[0]))  # `fill_heights` groups them
    for column, row in known:
        if not (0 <= column < shape[1] and 0 <= row < shape[0]):
            what = f"There is no finer tile {column, row}"
            raise TerrainError(what, expected=f"columns 0 to {shape[1] - 1} and rows 0 to {shape[0] - 1}")
    threads, records = threads or launch.default_threads(), records or FinerRecords()
    numbers = _numbered(known, shape)
    heights = allocate("finer_heights", (int(numbers.max()) + 1, STRIDE, STRIDE), np.dtype(np.float32))
    for done in fill_heights(plain, bits, known, numbers, heights, read, records):
        on_progress(0.5 * done)
    ends = _ends(heights)
    tiles = _measured(
        plain, bits, numbers, heights, ends, threads, allocate, lambda done: on_progress(0.5 + 0.5 * done), records
    )
    raster = replace(plain.raster, finer=tiles, digest=digest_of([], plain.raster.digest, tiles.digest))
    return replace(
        plain,
        raster=raster,
        min_height=min(plain.min_height, ends[0]),
        max_height=max(plain.max_height, ends[1]),
        steepest_x=plain.steepest_x + tiles.max_slope,
        steepest_y=plain.steepest_y + tiles.max_slope,
    )


def _check(plain: HeightField, bits: int) -> None:
    """Raise TerrainError for a field or a number of bits that finer tiles cannot have."""
    if plain.interpolation != "bilinear" or plain.detail or plain.raster.finer is not None:
        raise TerrainError(f"Finer tiles were requested for {plain!r}", expected="a bilinear field as it was built")
    largest = min(MAX_BITS, plain.lattice.unit_bits - plain.lattice.levels)
    if not 1 <= bits <= largest:
        raise TerrainError(f"The finer tiles have {bits} bits", expected=f"1 to {largest}")


def _numbered(known: list[Tile], shape: tuple[int, int]) -> np.ndarray:
    """Return the number, row by row, of each tile that is known or next to a known one, -1 elsewhere: int32 `shape`."""
    there = np.zeros(shape, bool)
    for (column, row), down, across in product(known, (-1, 0, 1), (-1, 0, 1)):
        if 0 <= row + down < shape[0] and 0 <= column + across < shape[1]:
            there[row + down, column + across] = True
    return np.where(there, np.cumsum(there).reshape(shape) - 1, -1).astype(np.int32)


def _ends(heights: np.ndarray) -> tuple[float, float]:
    """Return the lowest and the highest height of all tiles, metres; (infinity, -infinity) without tiles."""
    low, high = np.inf, -np.inf
    for tile in heights:
        inner = tile[1 : SIDE + 2, 1 : SIDE + 2]  # without the margin
        low, high = min(low, float(inner.min())), max(high, float(inner.max()))
    return low, high


def corners_of_squares(numbers: np.ndarray) -> Iterator[Tile]:
    """Yield the corner of each square of BLOCK x BLOCK tiles, with a margin of one tile, that has any tile.

    A corner is column and row of the first tile of the margin, -1 outside of the table.
    """
    rows, columns = numbers.shape
    first_row, first_column = (int(places.min(initial=max(rows, columns))) - 1 for places in np.nonzero(numbers >= 0))
    for row, column in product(range(first_row, rows, BLOCK), range(first_column, columns, BLOCK)):
        if (_numbers_in(numbers, (column, row)) >= 0).any():  # of the square or its margin
            yield column, row


def _numbers_in(numbers: np.ndarray, corner: Tile) -> np.ndarray:
    """Return the numbers of the tiles of a square and its margin, from its first tile on."""
    column, row = corner
    return numbers[max(row, 0) : row + BLOCK + 2, max(column, 0) : column + BLOCK + 2]


def rectangle_around(
    plain: HeightField,
    bits: int,
    numbers: np.ndarray,
    heights: np.ndarray,
    tiles: list[MeasuredFinerTile],
    surface: SurfaceAt = raster_heights,
) -> MeasuredRectangle:
    """Return the smallest rectangle of tiles around some of them, with a margin of one tile on each side.

    Beyond the raster's border all values are those at the border.

    Args:
        tiles: those to enclose, at least one.
        surface: surface(plain, bits, x, y) returns the heights of the raster's surface at finer columns x and rows y.
    """
    last = plain.lattice.cells_x << bits, plain.lattice.cells_y << bits
    row, column = (min(tile[axis] for tile in tiles) - 1 for axis in (0, 1))  # of the margin's first tile
    sample_rows, sample_columns = (
        SIDE * (max(tile[axis] for tile in tiles) + 2 - first) + 1 for axis, first in ((0, row), (1, column))
    )
    # The part of the table of tiles that the rectangle covers.
    near = numbers[max(row, 0) : row + sample_rows // SIDE, max(column, 0) : column + sample_columns // SIDE]
    change, all_heights = (
        np.zeros((sample_rows, sample_columns), np.float32),
        np.full((sample_rows, sample_columns), np.nan, np.float32),
    )
    for down, across in np.argwhere(near >= 0):
        y, x = SIDE * (max(row, 0) + down), SIDE * (max(column, 0) + across)
        finer = heights[near[down, across], 1:-1, 1:-1]
        coarse = surface(plain, bits, x + np.arange(SIDE + 1), y + np.arange(SIDE + 1))
        # The rounding of the raster's surface to float32 is no change.
        difference = np.where(finer == coarse.astype(np.float32), 0.0, finer - coarse)
        i, j = x - SIDE * column, y - SIDE * row  # the tile's first sample in the rectangle
        area = slice(j, j + SIDE + 1), slice(i, i + SIDE + 1)
        change[area], all_heights[area] = difference, finer
    # Beyond the border: clamp rows and columns to the raster, then to the rectangle.
    for axis, count, first, end in ((1, sample_columns, SIDE * column, last[0]), (0, sample_rows, SIDE * row, last[1])):
        clamped = np.clip(np.clip(first + np.arange(count), 0, end) - first, 0, count - 1)
        change, all_heights = (np.take(values, clamped, axis) for values in (change, all_heights))
    roots = (sample_columns - 1) // SIDE, (sample_rows - 1) // SIDE  # a root square for each tile
    lattice = Lattice(*roots, TILE_BITS, *_steps(plain, bits))
    return MeasuredRectangle(column, row, np.ascontiguousarray(all_heights), np.ascontiguousarray(change), lattice)


def _steps(plain: HeightField, bits: int) -> tuple[float, float]:
    """Return the steps of finer samples along x and y, metres."""
    return plain.lattice.step_x / (1 << bits), plain.lattice.step_y / (1 << bits)


def _measured(
    plain: HeightField,
    bits: int,
    numbers: np.ndarray,
    heights: np.ndarray,
    ends: tuple[float, float],
    threads: int,
    allocate: Allocate,
    on_progress: Callable[[float], None],
    records: FinerRecords,
) -> FinerTiles:
    """Return the tiles with the errors of their change and its limits (largest change, metres, and largest slope).

    Only tiles that `records` lacks are measured. ends: lowest and highest height, metres. allocate: returns a zeroed
    array, or one of an earlier attempt.
    """
    lattice, inputs = plain.lattice, inputs_of_tiles(plain, bits, numbers, heights)
    limits_of_tiles = _measure_limits(plain, bits, numbers, heights, inputs, records)
    # The limits of all tiles, then of each 2 x 2 tiles, and so on to those of the whole table.
    limits = np.concatenate([level.reshape(-1, 2) for level in halvings(limits_of_tiles, np.maximum)])
    # Codes have to reach twice the largest change, which is the error of diamonds too large for a stored one.
    exponent = codes.exponent_of(2.0 * float(limits[-1, 0]))
    table = codes.tables([exponent])[0]
    errors = allocate("finer_errors", (len(heights), int(kernels.ERRORS)), np.dtype(np.uint8))
    ranges = allocate("finer_ranges", (len(heights), int(kernels.RANGES), 2), np.dtype(np.uint16))
    scale = hierarchy.range_scale(*ends) if len(heights) else (0.0, 1.0)
    outputs = (  # kind of its records, array, scale of its codes, and function that fills it
        (MEASURED, errors, str(exponent), partial(fill_errors, table=table)),
        (RANGED, ranges, str(scale), partial(fill_ranges, scale=scale)),
    )
    for corner in corners_of_squares(numbers):  # squares of tiles, row by row
        on_progress((corner[1] + 1) / len(numbers))
        # For each output the tiles (row, column, number) whose record is missing or has other inputs.
        missing_by_output: list[list[MeasuredFinerTile]] = [[] for _ in outputs]
        for (kind, array, coding, _fill), tiles in zip(outputs, missing_by_output, strict=True):
            for tile in tiles_of(corner, numbers):
                row, column, number = tile
                if not is_measured(records, kind, (column, row), f"{inputs[row, column]} {coding}", array[number]):
                    tiles.append(tile)
        missing = sorted(set().union(*missing_by_output))
        if not missing:
            continue
        rectangle = rectangle_around(plain, bits, numbers, heights, missing)
        for (kind, array, coding, fill), tiles in zip(outputs, missing_by_output, strict=True):
            fill(rectangle, tiles, array, threads)
            for row, column, number in tiles:
                given, sums = f"{inputs[row, column]} {coding}", digest_of([array[number]])
                records.note(kind, (column, row), array=array[number], inputs=given, sums=sums)
    digest = digest_of([numbers, *heights], repr((bits, numbers.shape, lattice.step_x, lattice.step_y)))
    stored = []  # the numbers and the limits
    for name, array in (("finer_numbers", numbers), ("finer_limits", limits)):
        stored.append(allocate(name, array.shape, array.dtype))
        stored[-1][...] = array
    return FinerTiles(bits, stored[0], heights, errors, ranges, *scale, exponent, stored[1], digest)


def _measure_limits(
    plain: HeightField,
    bits: int,
    numbers: np.ndarray,
    heights: np.ndarray,
    inputs: dict[tuple[int, int], str],
    records: FinerRecords,
) -> np.ndarray:
    """Return the largest change of each tile, metres, and its largest slope: float32 [rows, columns, 2], 0 without one.

    They are taken from records. Missing ones are measured, for neighbouring tiles in one rectangle, and noted there.
    inputs: by row and column of a tile a digest of all that determines its change (`inputs_of_tiles`).
    """
    steps = _steps(plain, bits)
    limits = np.zeros((*numbers.shape, 2), np.float32)
    for corner in corners_of_squares(numbers):
        missing = []
        for tile in tiles_of(corner, numbers):
            row, column, _number = tile
            earlier = limits_before(records, (column, row), f"{inputs[row, column]} {steps}")
            if earlier is None:
                missing.append(tile)
            else:
                limits[row, column] = earlier
        if not missing:
            continue
        rectangle = rectangle_around(plain, bits, numbers, heights, missing)
        for tile in missing:
            row, column, _number = tile
            limits[row, column] = pair = limits_of(rectangle, tile)
            given = f"{inputs[row, column]} {steps}"
            records.note(LIMITED, (column, row), inputs=given, limits=[float(value) for value in pair])
    return limits


def tiles_of(corner: Tile, numbers: np.ndarray) -> Iterator[MeasuredFinerTile]:
    """Yield the tiles inside a square's margin. corner: column and row of the square's first tile, of the margin."""
    for down, across in product(range(1, BLOCK + 1), range(1, BLOCK + 1)):
        row, column = corner[1] + down, corner[0] + across
        if row < numbers.shape[0] and column < numbers.shape[1] and numbers[row, column] >= 0:
            yield MeasuredFinerTile(row, column, int(numbers[row, column]))
