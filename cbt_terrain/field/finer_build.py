# SPDX-License-Identifier: GPL-3.0-or-later
"""Computation of finer tiles (finer_tiles.py): their heights, the errors of the change, and the ranges of heights."""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from ...kernels.field import finer as kernels
from ..errors import TerrainError
from ..run import launch
from . import codes, hierarchy
from .blocks import halvings
from .build import Allocate, in_memory
from .finer_tiles import MAX_BITS, SIDE, STRIDE, TILE_BITS, FinerTiles, tile_shape
from .heightfield import HeightField, HeightRaster
from .lattice import PAGE, Lattice

BLOCK = 8  # tiles along a side of the squares that are measured together
GROUPS = 3  # of depths with stored errors
UP = np.float32(1.0 + 2.0**-22)  # above the rounding of a difference to float32

Tile = tuple[int, int]  # column and row


class FinerBox(NamedTuple):
    """First and last finer samples along x and y."""

    x0: int
    y0: int
    x1: int
    y1: int


def with_finer_tiles(
    plain: HeightField,
    bits: int,
    known: Iterable[Tile],
    read: Callable[[FinerBox], np.ndarray],
    threads: int | None = None,
    allocate: Allocate = in_memory,
    on_progress: Callable[[float], None] = lambda _fraction: None,
) -> HeightField:
    """Return a bilinear field whose surface has finer heights in some tiles.

    Args:
        plain: without finer tiles.
        bits: a raster cell becomes 2^bits x 2^bits finer cells.
        known: column and row of each tile with finer heights, from the raster's south-western corner.
        read: read(box) returns heights of finer samples, float32 [rows, columns] metres, row 0 south; NaN where only
            the raster is known. Samples that two tiles share must be equal.
        allocate: allocate(name, shape, dtype) returns a zeroed array.

    Raises TerrainError for a bicubic surface, a detail or other finer tiles, for `bits` out of range, for tiles outside
    of the raster, and for heights of another shape from `read`.
    """
    _check(plain, bits)
    shape = tile_shape(plain.lattice, bits)
    known = sorted(set(known), key=lambda tile: (tile[1] // BLOCK, tile[0] // BLOCK, tile[1], tile[0]))
    for column, row in known:
        if not (0 <= column < shape[1] and 0 <= row < shape[0]):
            what = f"There is no finer tile {column, row}"
            raise TerrainError(what, expected=f"columns 0 to {shape[1] - 1} and rows 0 to {shape[0] - 1}")
    threads = threads or launch.default_threads()
    numbers = _numbered(known, shape)
    heights = allocate("finer_heights", (int(numbers.max()) + 1, STRIDE, STRIDE), np.dtype(np.float32))
    for done in _fill_heights(plain, bits, known, numbers, heights, read):
        on_progress(0.5 * done)
    ends = _ends(heights)
    tiles = _measured(
        plain, bits, numbers, heights, ends, threads, allocate, lambda done: on_progress(0.5 + 0.5 * done)
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


def raster_heights(plain: HeightField | HeightRaster, bits: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the heights of the raster's bilinear surface at finer columns x and rows y, both rising, float64 [y, x].

    Outside of the raster they are those at its border.
    """
    lattice, sides = plain.lattice, []
    for at, cells in ((y, lattice.cells_y), (x, lattice.cells_x)):
        inside = np.clip(at, 0, cells << bits)
        cell = np.minimum(inside >> bits, cells - 1)
        sides.append((cell, (inside - (cell << bits)) / (1 << bits)))
    (j, t), (i, s) = sides
    nodes = plain.heights(slice(int(j[0]), int(j[-1]) + 2), slice(int(i[0]), int(i[-1]) + 2)).astype(np.float64)
    j, i, t = j - j[0], i - i[0], t[:, None]
    south = nodes[np.ix_(j, i)] * (1.0 - s) + nodes[np.ix_(j, i + 1)] * s
    north = nodes[np.ix_(j + 1, i)] * (1.0 - s) + nodes[np.ix_(j + 1, i + 1)] * s
    return south * (1.0 - t) + north * t


def _ends(heights: np.ndarray) -> tuple[float, float]:
    """Return the lowest and the highest height of all tiles, metres; (infinity, -infinity) without tiles."""
    low, high = np.inf, -np.inf
    for tile in heights:
        inner = tile[1 : SIDE + 2, 1 : SIDE + 2]
        low, high = min(low, float(inner.min())), max(high, float(inner.max()))
    return low, high


def _fill_heights(
    plain: HeightField,
    bits: int,
    known: list[Tile],
    numbers: np.ndarray,
    heights: np.ndarray,
    read: Callable[[FinerBox], np.ndarray],
) -> Iterator[float]:
    """Fill `heights` with those of all tiles and the samples around them, metres; yield the fraction that is done."""
    last = plain.lattice.cells_x << bits, plain.lattice.cells_y << bits
    for row, column in np.argwhere(numbers >= 0):
        x, y = (SIDE * n - 1 + np.arange(STRIDE) for n in (column, row))
        heights[numbers[row, column]] = raster_heights(plain, bits, x, y)
    for done, (column, row) in enumerate(known):
        yield done / len(known)
        x, y = SIDE * column, SIDE * row
        box = FinerBox(x, y, min(x + SIDE, last[0]), min(y + SIDE, last[1]))
        if box.x0 > box.x1 or box.y0 > box.y1:  # entirely beyond the raster's border
            continue
        found = np.asarray(read(box), np.float32)
        expected = box.y1 - box.y0 + 1, box.x1 - box.x0 + 1
        if found.shape != expected:
            raise TerrainError(f"The heights of a finer tile have the shape {found.shape}", expected=f"{expected}")
        for other_row, other_column in product(range(row - 1, row + 2), range(column - 1, column + 2)):
            if 0 <= other_row < numbers.shape[0] and 0 <= other_column < numbers.shape[1]:
                _lay(found, box, heights[numbers[other_row, other_column]], other_column, other_row)
    for row, column in np.argwhere(numbers >= 0):
        _extend(heights[numbers[row, column]], column, row, last)


def _lay(found: np.ndarray, box: FinerBox, tile: np.ndarray, column: int, row: int) -> None:
    """Write the heights `found` of a box that are not NaN into the samples of the tile at a column and row.

    tile: float32 [STRIDE, STRIDE], changed where the box meets it.
    """
    x, y = SIDE * column - 1, SIDE * row - 1
    x0, x1 = max(box.x0, x), min(box.x1, x + STRIDE - 1)
    y0, y1 = max(box.y0, y), min(box.y1, y + STRIDE - 1)
    if x0 <= x1 and y0 <= y1:
        part = found[y0 - box.y0 : y1 + 1 - box.y0, x0 - box.x0 : x1 + 1 - box.x0]
        target = tile[y0 - y : y1 + 1 - y, x0 - x : x1 + 1 - x]
        np.copyto(target, part, where=~np.isnan(part))


def _extend(tile: np.ndarray, column: int, row: int, last: tuple[int, int]) -> None:
    """Continue a tile's heights beyond the raster's border: a line there has the slope of the border, then they stay.

    So differences across the border are those inside of it. last: finer cells of the raster along x and y.
    """
    for lines, first, end in ((tile.T, SIDE * column - 1, last[0]), (tile, SIDE * row - 1, last[1])):
        if first < 0:
            lines[0] = 2.0 * lines[1] - lines[2]
        at = end - first  # of the border
        if 1 <= at < STRIDE - 1:
            beyond = 2.0 * lines[at] - lines[at - 1]
            lines[at + 1 :] = lines[at]
            lines[at + 1] = beyond
        elif at < 1:
            lines[:] = lines[max(at, 0)]


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


def _squares(plain: HeightField, bits: int, numbers: np.ndarray, heights: np.ndarray) -> Iterator[_Square]:
    """Yield the squares of BLOCK x BLOCK tiles with any tile, with a margin of one tile on each side.

    Beyond the raster's border heights and change are those at the border.
    """
    last = plain.lattice.cells_x << bits, plain.lattice.cells_y << bits
    rows, columns = numbers.shape
    count = (BLOCK + 2) * SIDE + 1
    first_row, first_column = (int(places.min(initial=max(rows, columns))) - 1 for places in np.nonzero(numbers >= 0))
    for row, column in product(range(first_row, rows, BLOCK), range(first_column, columns, BLOCK)):
        part = numbers[max(row, 0) : row + BLOCK + 2, max(column, 0) : column + BLOCK + 2]
        if not (part >= 0).any():
            continue
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
        yield _Square(column, row, np.ascontiguousarray(whole), np.ascontiguousarray(change))


def _measured(
    plain: HeightField,
    bits: int,
    numbers: np.ndarray,
    heights: np.ndarray,
    ends: tuple[float, float],
    threads: int,
    allocate: Allocate,
    on_progress: Callable[[float], None],
) -> FinerTiles:
    """Return the tiles with the errors and limits of their change. ends: lowest and highest height, metres."""
    lattice, part = plain.lattice, 1.0 / (1 << bits)
    steps = lattice.step_x * part, lattice.step_y * part
    limits = np.zeros((*numbers.shape, 2), np.float32)
    for square in _squares(plain, bits, numbers, heights):
        for row, column, _tile, where in _tiles_of(square, numbers):
            limits[row, column] = _limits(square.change[where], steps)
    limits = np.concatenate([level.reshape(-1, 2) for level in halvings(limits, np.maximum)])
    exponent = codes.exponent_of(2.0 * float(limits[-1, 0]))
    table = codes.tables([exponent])[0]
    errors = allocate("finer_errors", (len(heights), int(kernels.ERRORS)), np.dtype(np.uint8))
    ranges = allocate("finer_ranges", (len(heights), int(kernels.RANGES), 2), np.dtype(np.uint16))
    scale = hierarchy.range_scale(*ends) if len(heights) else (0.0, 1.0)
    small = Lattice(BLOCK + 2, BLOCK + 2, TILE_BITS, *steps)
    for square in _squares(plain, bits, numbers, heights):
        on_progress((square.row + 1) / len(numbers))
        metres = np.zeros(small.node_count, np.float32)
        hierarchy.build_errors(square.change, small, metres, threads)
        found = np.zeros((small.range_count, 2), np.uint16)
        hierarchy.build_ranges(square.heights, small, *scale, found, threads)
        images, half = list(_images(small.layout(), metres * UP)), list(_images(small.range_layout(), found, False))
        for _row, _column, tile, where in _tiles_of(square, numbers):
            stored = np.concatenate([_pages(image, where, shift) for image, shift in images])
            codes.encode_part(stored, table, errors[tile], threads)
            ranges[tile] = np.concatenate([_pages(image, where, shift + 1) for image, shift in half])
    content = hashlib.blake2b(repr((bits, numbers.shape, lattice.step_x, lattice.step_y)).encode(), digest_size=16)
    for array in (numbers, *heights):
        content.update(np.ascontiguousarray(array).data)
    tables = []
    for name, array in (("finer_numbers", numbers), ("finer_limits", limits)):
        tables.append(allocate(name, array.shape, array.dtype))
        tables[-1][...] = array
    return FinerTiles(bits, tables[0], heights, errors, ranges, *scale, exponent, tables[1], content.hexdigest())


def _tiles_of(square: _Square, numbers: np.ndarray) -> Iterator[tuple[int, int, int, tuple[slice, slice]]]:
    """Yield row, column and number of each tile inside a square's margin, and its samples there."""
    for down, across in product(range(1, BLOCK + 1), range(1, BLOCK + 1)):
        row, column = square.row + down, square.column + across
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
