# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of the change, ranges of heights and limits of finer tiles (finer_tiles.py), by rectangles of tiles."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from . import codes, hierarchy
from .finer_tiles import SIDE, TILE_BITS
from .lattice import PAGE, Lattice

GROUPS = 3  # of depths with stored errors
UP = np.float32(1.0 + 2.0**-22)  # above the rounding of a difference to float32


class MeasuredFinerTile(NamedTuple):
    """Row, column and number of a tile."""

    row: int
    column: int
    number: int


class MeasuredRectangle(NamedTuple):
    """Some tiles that are measured together, with a margin of one tile on each side.

    Attributes:
        column, row: its first tile, of the margin.
        low, high: bounds of the surface at its finer samples, float32 metres; a bilinear surface has one array.
        change: the surface minus that of the raster at its finer samples, float32 metres; all are 0 outside of tiles.
    """

    column: int
    row: int
    low: np.ndarray
    high: np.ndarray
    change: np.ndarray

    def lattice(self, steps: tuple[float, float]) -> Lattice:
        """Return a lattice with a root square for each tile. steps: of finer samples, metres."""
        rows, columns = (count // SIDE for count in self.change.shape)
        return Lattice(columns, rows, TILE_BITS, *steps)

    def samples_of(self, tile: MeasuredFinerTile) -> tuple[slice, slice]:
        """Return the rows and columns of a tile's samples in the rectangle."""
        y, x = SIDE * (tile.row - self.row), SIDE * (tile.column - self.column)
        return slice(y, y + SIDE + 1), slice(x, x + SIDE + 1)


def fill_errors(
    rectangle: MeasuredRectangle,
    tiles: list[MeasuredFinerTile],
    errors: np.ndarray,
    threads: int,
    *,
    steps: tuple[float, float],
    table: np.ndarray,
) -> None:
    """Fill the errors of some tiles of a rectangle. steps: of finer samples, metres. table: metres of the codes."""
    small = rectangle.lattice(steps)
    metres = np.zeros(small.node_count, np.float32)
    hierarchy.build_errors(rectangle.change, small, metres, threads)
    images = list(_images(small.layout(), metres * UP))
    for tile in tiles:
        stored = np.concatenate([_pages(image, rectangle.samples_of(tile), shift) for image, shift in images])
        errors[tile.number] = 0  # an earlier attempt may have left others, and zeros are not written
        codes.encode_part(stored, table, errors[tile.number], threads)


def fill_ranges(
    rectangle: MeasuredRectangle,
    tiles: list[MeasuredFinerTile],
    ranges: np.ndarray,
    threads: int,
    *,
    steps: tuple[float, float],
    scale: tuple[float, float],
) -> None:
    """Fill the ranges of heights of some tiles of a rectangle. steps: as of `fill_errors`. scale: metres of codes."""
    small = rectangle.lattice(steps)
    low_ranges = np.zeros((small.range_count, 2), np.uint16)
    hierarchy.build_ranges(rectangle.low, small, *scale, low_ranges, threads)
    if rectangle.high is not rectangle.low:
        high_ranges = np.zeros_like(low_ranges)
        hierarchy.build_ranges(rectangle.high, small, *scale, high_ranges, threads)
        low_ranges[:, 1] = high_ranges[:, 1]  # now the ranges of the surface between both
    images = list(_images(small.range_layout(), low_ranges, False))
    for tile in tiles:
        area = rectangle.samples_of(tile)
        # Ranges are those of a lattice of every other sample.
        ranges[tile.number] = np.concatenate([_pages(image, area, shift + 1) for image, shift in images])


def limits_of(change: np.ndarray, steps: tuple[float, float]) -> tuple[np.float32, np.float32]:
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
        pages_in_row, rest = int(pages[group]), values.shape[1:]
        # Pages of 8 x 8 tiles of 4 x 4 vertices (lattice.py).
        image = values[base[group] : base[group + 1]].reshape(-1, pages_in_row, 8, 8, 4, 4, *rest)
        rows = image.transpose(0, 2, 4, 1, 3, 5, *range(6, image.ndim)).reshape(-1, PAGE * pages_in_row, *rest)
        yield rows, 2 * group if group < GROUPS else 0


def _pages(image: np.ndarray, area: tuple[slice, slice], shift: int) -> np.ndarray:
    """Return the entries of a tile as pages, [n, ...]; `image`: rows of vertices, 2^shift cells apart.

    area: the tile's rows and columns of finer samples in the rectangle of `image`.
    """
    y, x = (slice(side_range.start >> shift, side_range.stop - 1 >> shift) for side_range in area)
    part, rest = image[y, x], image.shape[2:]
    side = max(len(part), PAGE)
    full = np.zeros((side, side, *rest), image.dtype)  # a coarse group has less than a page
    full[: len(part), : len(part)] = part
    full = full.reshape(side // PAGE, 8, 4, side // PAGE, 8, 4, *rest)
    return full.transpose(0, 3, 1, 4, 2, 5, *range(6, full.ndim)).reshape(-1, *rest)
