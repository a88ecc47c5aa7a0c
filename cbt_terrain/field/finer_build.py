# SPDX-License-Identifier: GPL-3.0-or-later
"""Computation of finer tiles (finer_tiles.py): their heights, the errors of the change, and the ranges of heights."""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from ...kernels.field import finer as kernels
from ..errors import TerrainError
from ..run import launch
from . import codes, hierarchy
from .blocks import halvings
from .build import Allocate, in_memory
from .finer_heights import (
    LIMITED,
    MEASURED,
    RANGED,
    FinerBox,
    FinerRecords,
    Tile,
    digest_of,
    fill_heights,
    raster_heights,
    window_of,
)
from .finer_reuse import inputs_of_tiles, is_measured, limits_before
from .finer_tiles import MAX_BITS, SIDE, STRIDE, TILE_BITS, FinerTiles, tile_shape
from .heightfield import HeightField
from .lattice import PAGE, Lattice

BLOCK = 8  # tiles along a side of the squares that are measured together
GROUPS = 3  # of depths with stored errors
UP = np.float32(1.0 + 2.0**-22)  # above the rounding of a difference to float32


def with_finer_tiles(
    plain: HeightField,
    bits: int,
    known: Iterable[Tile],
    read: Callable[[FinerBox], np.ndarray],
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
    known = sorted(set(known), key=lambda tile: (*window_of(tile), tile[1], tile[0]))
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
    raster = replace(plain.raster, finer=tiles, digest=_digest(plain.raster.digest, tiles.digest))
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


def _digest(*texts: str) -> str:
    """Return a hex digest of texts."""
    return hashlib.blake2b(" ".join(texts).encode(), digest_size=16).hexdigest()


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
        inner = tile[1 : SIDE + 2, 1 : SIDE + 2]
        low, high = min(low, float(inner.min())), max(high, float(inner.max()))
    return low, high


class _Square(NamedTuple):
    """A square of tiles that is measured at a time.

    Attributes:
        column, row: its first tile.
        heights, change: at its finer samples, float32 metres; both 0 outside of tiles.
    """

    column: int
    row: int
    heights: np.ndarray
    change: np.ndarray


def _corners_of_squares(numbers: np.ndarray) -> Iterator[Tile]:
    """Yield the first tile of each square of BLOCK x BLOCK tiles, in a margin of one tile, that meets any tile."""
    rows, columns = numbers.shape
    first_row, first_column = (int(places.min(initial=max(rows, columns))) - 1 for places in np.nonzero(numbers >= 0))
    for row, column in product(range(first_row, rows, BLOCK), range(first_column, columns, BLOCK)):
        if (_part_of(numbers, (column, row)) >= 0).any():
            yield column, row


def _part_of(numbers: np.ndarray, corner: Tile) -> np.ndarray:
    """Return the numbers of the tiles of a square and its margin, from its first tile on."""
    column, row = corner
    return numbers[max(row, 0) : row + BLOCK + 2, max(column, 0) : column + BLOCK + 2]


def _square_at(plain: HeightField, bits: int, numbers: np.ndarray, heights: np.ndarray, corner: Tile) -> _Square:
    """Return a square of BLOCK x BLOCK tiles with a margin of one tile on each side.

    Beyond the raster's border heights and change are those at the border. bits: a raster cell has 2^bits finer cells a
    side.
    """
    last = plain.lattice.cells_x << bits, plain.lattice.cells_y << bits
    count, (column, row), part = (BLOCK + 2) * SIDE + 1, corner, _part_of(numbers, corner)
    whole, change = np.zeros((2, count, count), np.float32)
    for down, across in np.argwhere(part >= 0):
        y, x = SIDE * (max(row, 0) + down), SIDE * (max(column, 0) + across)
        finer = heights[part[down, across], 1:-1, 1:-1]
        coarse = raster_heights(plain, bits, x + np.arange(SIDE + 1), y + np.arange(SIDE + 1))
        # The rounding of the raster's surface to float32 is no change.
        difference = np.where(finer == coarse.astype(np.float32), 0.0, finer - coarse)
        i, j = x - SIDE * column, y - SIDE * row
        whole[j : j + SIDE + 1, i : i + SIDE + 1] = finer
        change[j : j + SIDE + 1, i : i + SIDE + 1] = difference
    for axis, first, end in ((1, SIDE * column, last[0]), (0, SIDE * row, last[1])):
        inside = np.clip(first + np.arange(count), 0, end) - first
        whole, change = (np.take(values, np.clip(inside, 0, count - 1), axis) for values in (whole, change))
    return _Square(column, row, np.ascontiguousarray(whole), np.ascontiguousarray(change))


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
    """Return the tiles with the errors and limits of their change. ends: lowest and highest height, metres."""
    lattice, part = plain.lattice, 1.0 / (1 << bits)
    steps = lattice.step_x * part, lattice.step_y * part
    limits = np.zeros((*numbers.shape, 2), np.float32)
    corners, inputs = list(_corners_of_squares(numbers)), inputs_of_tiles(plain, bits, numbers, heights)
    for corner in corners:
        missing = []
        for row, column, _tile, where in _tiles_of(corner, numbers):
            found = limits_before(records, (column, row), inputs[row, column])
            if found is None:
                missing.append((row, column, where))
            else:
                limits[row, column] = found
        if missing:
            change = _square_at(plain, bits, numbers, heights, corner).change
        for row, column, where in missing:
            limits[row, column] = pair = _limits(change[where], steps)
            records.note(LIMITED, (column, row), inputs=inputs[row, column], limits=[float(value) for value in pair])
    limits = np.concatenate([level.reshape(-1, 2) for level in halvings(limits, np.maximum)])
    exponent = codes.exponent_of(2.0 * float(limits[-1, 0]))
    table = codes.tables([exponent])[0]
    errors = allocate("finer_errors", (len(heights), int(kernels.ERRORS)), np.dtype(np.uint8))
    ranges = allocate("finer_ranges", (len(heights), int(kernels.RANGES), 2), np.dtype(np.uint16))
    scale = hierarchy.range_scale(*ends) if len(heights) else (0.0, 1.0)
    outputs = (
        (MEASURED, errors, str(exponent), partial(_fill_errors, steps=steps, table=table)),
        (RANGED, ranges, str(scale), partial(_fill_ranges, steps=steps, scale=scale)),
    )
    for corner in corners:
        on_progress((corner[1] + 1) / len(numbers))
        square = None
        for kind, array, coding, fill in outputs:
            tiles = []
            for each in _tiles_of(corner, numbers):
                row, column, tile, _where = each
                if not is_measured(records, kind, (column, row), f"{inputs[row, column]} {coding}", array[tile]):
                    tiles.append(each)
            if tiles:
                square = square or _square_at(plain, bits, numbers, heights, corner)
                fill(square, tiles, array, threads)
            for row, column, tile, _where in tiles:
                given, sums = f"{inputs[row, column]} {coding}", digest_of([array[tile]])
                records.note(kind, (column, row), array=array[tile], inputs=given, sums=sums)
    content = hashlib.blake2b(repr((bits, numbers.shape, lattice.step_x, lattice.step_y)).encode(), digest_size=16)
    for array in (numbers, *heights):
        content.update(np.ascontiguousarray(array).data)
    tables = []
    for name, array in (("finer_numbers", numbers), ("finer_limits", limits)):
        tables.append(allocate(name, array.shape, array.dtype))
        tables[-1][...] = array
    return FinerTiles(bits, tables[0], heights, errors, ranges, *scale, exponent, tables[1], content.hexdigest())


Part = tuple[int, int, int, tuple[slice, slice]]  # row, column and number of a tile, and its samples in a square


def _fill_errors(
    square: _Square,
    tiles: list[Part],
    errors: np.ndarray,
    threads: int,
    *,
    steps: tuple[float, float],
    table: np.ndarray,
) -> None:
    """Fill the errors of some tiles of a square. steps: of finer samples, metres. table: metres of the codes."""
    small = Lattice(BLOCK + 2, BLOCK + 2, TILE_BITS, *steps)
    metres = np.zeros(small.node_count, np.float32)
    hierarchy.build_errors(square.change, small, metres, threads)
    images = list(_images(small.layout(), metres * UP))
    for _row, _column, tile, where in tiles:
        stored = np.concatenate([_pages(image, where, shift) for image, shift in images])
        errors[tile] = 0  # an earlier attempt may have left others, and zeros are not written
        codes.encode_part(stored, table, errors[tile], threads)


def _fill_ranges(
    square: _Square,
    tiles: list[Part],
    ranges: np.ndarray,
    threads: int,
    *,
    steps: tuple[float, float],
    scale: tuple[float, float],
) -> None:
    """Fill the ranges of heights of some tiles of a square. steps: as of `_fill_errors`. scale: metres of the codes."""
    small = Lattice(BLOCK + 2, BLOCK + 2, TILE_BITS, *steps)
    found = np.zeros((small.range_count, 2), np.uint16)
    hierarchy.build_ranges(square.heights, small, *scale, found, threads)
    images = list(_images(small.range_layout(), found, False))
    for _row, _column, tile, where in tiles:
        ranges[tile] = np.concatenate([_pages(image, where, shift + 1) for image, shift in images])


def _tiles_of(corner: Tile, numbers: np.ndarray) -> Iterator[Part]:
    """Yield row, column and number of each tile inside a square's margin, and its samples in the square."""
    for down, across in product(range(1, BLOCK + 1), range(1, BLOCK + 1)):
        row, column = corner[1] + down, corner[0] + across
        if row < numbers.shape[0] and column < numbers.shape[1] and numbers[row, column] >= 0:
            where = slice(SIDE * down, SIDE * (down + 1) + 1), slice(SIDE * across, SIDE * (across + 1) + 1)
            yield row, column, int(numbers[row, column]), where


def _limits(change: np.ndarray, steps: tuple[float, float]) -> tuple[np.float32, np.float32]:
    """Return the largest change of a tile, metres, and its largest slope along an axis, rounded up."""
    slopes = [float(np.abs(np.diff(change, axis=axis)).max()) / step for axis, step in ((1, steps[0]), (0, steps[1]))]
    return np.float32(float(np.abs(change).max()) * UP), np.float32(max(slopes) * UP)


def _images(
    layout: tuple[np.ndarray, np.ndarray], values: np.ndarray, with_cells: bool = True
) -> Iterator[tuple[np.ndarray, int]]:
    """Yield the values of each stored group as rows of vertices, and log2 of the distance of two in those of group 0.

    layout: of the values (lattice.py). with_cells: also yield those of the cells.
    """
    base, pages = layout
    for group in (*range(GROUPS), *([len(pages) - 1] if with_cells else [])):
        wide, rest = int(pages[group]), values.shape[1:]
        image = values[base[group] : base[group + 1]].reshape(-1, wide, 8, 8, 4, 4, *rest)
        rows = image.transpose(0, 2, 4, 1, 3, 5, *range(6, image.ndim)).reshape(-1, PAGE * wide, *rest)
        yield rows, 2 * group if group < GROUPS else 0


def _pages(image: np.ndarray, where: tuple[slice, slice], shift: int) -> np.ndarray:
    """Return the entries of a tile as pages, [n, ...]; `image`: rows of vertices, 2^shift cells apart."""
    y, x = (slice(at.start >> shift, at.stop - 1 >> shift) for at in where)
    part, rest = image[y, x], image.shape[2:]
    side = max(len(part), PAGE)
    full = np.zeros((side, side, *rest), image.dtype)
    full[: len(part), : len(part)] = part
    full = full.reshape(side // PAGE, 8, 4, side // PAGE, 8, 4, *rest)
    return full.transpose(0, 3, 1, 4, 2, 5, *range(6, full.ndim)).reshape(-1, *rest)
