# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors and ranges of one tile, from its samples and those around it.

There is one error, in metres, and one range of heights for each diamond (pair of triangles) of the tile's lattice. Two
levels of diamonds are a group; the raster's cells are one more. A code is a byte: the index of an error in the table of
its group, whose largest error is 2^exponent metres (codes.py). The kind of a diamond tells whether the cells below it
are ground (1), a hole (2) or both (3).

`grid`: the tiles of the raster. `box`: first and last samples of the tile in it. A vertex of level j, where a diamond
is split, is the centre of a cell of 2^(j + 1) samples or the middle of a side of one.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import warp as wp

from ...kernels.field import window_errors as kernels
from ...kernels.field.window_errors import Corner
from ..field import codes, hierarchy
from ..field.holes import refine_borders
from ..field.lattice import PAGE, TileBox
from ..run import launch
from ..run.buffers import flat
from .tile_grid import TileGrid, entries_of, exist

Height = Callable[[int, int], float]
RANGE_MARGIN = 8  # samples around a tile that its ranges cover
COLUMN_BLOCK = 128  # columns of cells that are saturated together


class LargeError(NamedTuple):
    """Error of a diamond of cells as large as a tile or larger, over one tile: its vertex, its level and metres."""

    x: int
    y: int
    level: int
    error: float


class LargeTriangles(NamedTuple):
    """A diamond of cells as large as a tile or larger: its vertex, its level, and its triangles that meet a tile."""

    x: int
    y: int
    level: int
    corners: list[Corner]


class TileErrors(NamedTuple):
    """Errors of a tile.

    Attributes:
        codes: uint8, in the layout of the tile's lattice, under the tile's own exponents.
        border: uint8 [n], codes of the vertices near the tile's border (`TileGrid.near_border`).
        kinds: uint8 [n], kinds of cells (holes.py) below these vertices; None without holes.
        largest: largest error of each group and of the cells, metres.
    """

    codes: np.ndarray
    border: np.ndarray
    kinds: np.ndarray | None
    largest: list[float]


@dataclass(frozen=True)
class TileSamples:
    """The samples of a tile and around it.

    Attributes:
        window: of the arrays: the tile with a margin of `margin_of`.
        samples: float32 [rows, columns] metres, filled.
        valid: uint8, 0 at filled samples that are cut out; None without any.
    """

    grid: TileGrid
    box: TileBox
    window: TileBox
    samples: np.ndarray
    valid: np.ndarray | None

    @cached_property
    def measured(self) -> np.ndarray:
        """Return the samples, NaN where they do not count."""
        if self.valid is None:
            return self.samples
        return np.where(self.valid == 0, np.float32(np.nan), self.samples)

    @cached_property
    def inner_samples(self) -> np.ndarray:
        """Return the samples of the tile alone."""
        return self.inner(self.samples)

    @cached_property
    def inner_measured(self) -> np.ndarray:
        """Return the samples of the tile alone, NaN where they do not count."""
        return self.inner_samples if self.valid is None else self.inner(self.measured)

    def inner(self, values: np.ndarray, margin: int = 0) -> np.ndarray:
        """Return a contiguous copy of the samples of the tile and `margin` samples around it.

        values: an array of the whole window, which reaches further around the tile.
        """
        around = self.grid.window(self.box, margin)
        x, y = self.window.x0, self.window.y0
        return np.ascontiguousarray(values[around.y0 - y : around.y1 - y + 1, around.x0 - x : around.x1 - x + 1])


def margin_of(low: float, high: float) -> int:
    """Return the samples around a tile on which its errors depend. low, high: limits of the raster's heights, metres.

    A cell n samples away counts with 4^-n of its twist, until that is 0 in float32, whose smallest number is 2^-149.
    The number is rounded up to a multiple of 8 and at least a page, which changes no error.
    """
    reach = (codes.exponent_of(high - low) + 150) // 2 + 1  # the twist is at most twice 2^exponent
    return max(PAGE, -(-reach // 8) * 8)


def exact_errors(tile: TileSamples, threads: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the errors of a tile, float32 metres in the layout of its lattice, and the kinds of its cells.

    The kinds (ground, hole) are uint8 in the same layout, None without holes. The errors of cells as large as a tile
    and larger are `large_errors`.
    """
    grid = tile.grid
    local = grid.local(tile.box)
    errors = np.zeros(local.node_count, np.float32)
    _fill_cells(errors, tile, threads)
    # `large_errors` measures the diamond at the tile's centre, of depth 1, unless the tile holds root squares.
    coarsest_depth = 1 if grid.holds_roots else 2
    # `inner_measured` has the samples of the tile as `inner_samples`, but NaN where they do not count.
    hierarchy.measure_triangles(
        tile.inner_samples, local, errors, threads, measured=tile.inner_measured, coarsest=coarsest_depth
    )
    # Also raises the errors of diamonds on the border of a hole.
    kinds = None if tile.valid is None else refine_borders(tile.inner(tile.valid), local, errors, threads)
    return errors, kinds


def code_errors(tile: TileSamples, errors: np.ndarray, kinds: np.ndarray | None, threads: int) -> TileErrors:
    """Return the codes of a tile's errors, under the smallest exponents that cover them, and those near its border.

    errors: float32 metres in the layout of its lattice. kinds: kinds (ground, hole) of the cells below each; None
    without holes.
    """
    local = tile.grid.local(tile.box)
    stored = np.zeros(local.node_count, np.uint8)
    # Of each group of two levels, and of the cells.
    largest = [float(errors[part].max()) for part in codes.parts(local, len(errors))]
    # A coarser group has no smaller exponent (`nested`).
    table = codes.tables(codes.nested(local, list(map(codes.exponent_of, largest))))
    codes.encode_with_table(local, errors, table, stored, threads)
    near = tile.grid.near_border
    exists = exist(local, near)
    entries = entries_of(local, near.chosen(exists))

    def near_values(values: np.ndarray) -> np.ndarray:
        """Return the values of the vertices near the border, 0 for those that do not exist."""
        result = np.zeros(len(near.x), np.uint8)
        result[exists] = values[entries]
        return result

    return TileErrors(stored, near_values(stored), None if kinds is None else near_values(kinds), largest)


def _fill_cells(errors: np.ndarray, tile: TileSamples, threads: int) -> None:
    """Write the errors of a tile's cells into `errors`, float32 metres in the layout of its lattice.

    The error of a cell is a quarter of its twist, |h00 + h11 - h10 - h01|. Then it is saturated over the window: raised
    to at least a quarter of each neighbouring cell's error.
    """
    local, measured = tile.grid.local(tile.box), tile.measured
    cells = hierarchy.stored_at(local, local.cell_depth)
    west, south = tile.box.x0 - tile.window.x0, tile.box.y0 - tile.window.y0  # cells of the window before the tile
    # Rows and columns of cells: those of the window, and those of the tile, of which the raster's last tiles have one
    # more beyond the border, which saturation reaches.
    rows, columns = (
        max(samples - 1, before + inside)
        for samples, before, inside in zip(measured.shape, (south, west), (cells.rows, cells.columns), strict=True)
    )
    row_groups, blocks, quarter = -(-rows // kernels.ROWS), -(-columns // COLUMN_BLOCK), wp.float32(0.25)
    cell_errors = flat(np.zeros(row_groups * kernels.ROWS * columns, np.float32), wp.float32)
    # Compute twists over the window, saturate along rows and then along columns, and copy the tile's part.
    inputs: list = [codes.pack_samples(measured, steps=None), columns, cell_errors]
    spread = partial(launch.spread, step="error hierarchy", threads=threads)
    spread(kernels.window_twists, measured.shape[0] - 1, inputs, cost=0.1 * columns)
    spread(kernels.saturate_window_rows, row_groups, [quarter, columns, cell_errors], cost=0.8 * columns)
    inputs = [COLUMN_BLOCK, quarter, columns, rows, cell_errors]
    spread(kernels.saturate_window_columns, blocks, inputs, cost=0.1 * COLUMN_BLOCK * rows)
    inputs = [columns, west, south, cells, cell_errors, flat(errors, wp.float32)]
    spread(kernels.store_cells, cells.rows, inputs, cost=0.1 * columns)


def measure_ranges(tile: TileSamples, scale: tuple[float, float], threads: int) -> np.ndarray:
    """Return the lowest and highest heights of a tile's diamonds, uint16 [n, 2] in the layout of its lattice.

    A number q stands for base + q * step metres. Ranges cover samples up to RANGE_MARGIN around the tile. scale: base
    and step, of the whole raster.
    """
    local, around = tile.grid.local(tile.box), tile.grid.window(tile.box, RANGE_MARGIN)
    ranges = np.zeros((local.range_count, 2), np.uint16)
    before = tile.box.x0 - around.x0, tile.box.y0 - around.y0  # columns and rows of the window before the tile
    hierarchy.build_ranges(tile.inner(tile.samples, RANGE_MARGIN), local, *scale, ranges, threads, before)
    return ranges


def large_triangles(grid: TileGrid, box: TileBox, height: Height) -> list[LargeTriangles]:
    """Return the diamonds that meet a tile and are of cells as large as a tile or larger, with their triangles.

    height: height(x, y) returns the height of any vertex of the lattice, metres: that of the nearest sample.
    """
    lattice, diamonds = grid.lattice, []
    for level in range(grid.bits - 1, lattice.levels):
        half = 1 << level
        is_root = level == lattice.levels - 1
        for x, y in _cells_over(grid, box, 2 * half):  # their diamonds have their vertex in the middle
            corners = _centre_corners(x, y, 2 * half, is_root, height)
            diamonds.append(LargeTriangles((2 * x + 1) * half, (2 * y + 1) * half, level, corners))
        # Two corners of a cell of `half` samples are middles of sides; it holds a triangle of the diamond of each. They
        # are on one diagonal or on the other, alternating as the squares of a chessboard.
        for x, y in _cells_over(grid, box, half) if level >= grid.bits else []:
            for dx in (0, 1):
                dy = dx if (x + y) & 1 else 1 - dx
                # The triangle at corner (x + dx, y + dy) of the cell: its legs point into the cell.
                corner = _side_corner(x + dx, y + dy, 1 - 2 * dx, 1 - 2 * dy, half, height)
                diamonds.append(LargeTriangles((x + dx) * half, (y + dy) * half, level, [corner]))
    return diamonds


def large_errors(tile: TileSamples, diamonds: list[LargeTriangles], threads: int) -> list[LargeError]:
    """Return the errors over one tile of large diamonds, those of cells that are at least as large as a tile.

    diamonds: position, level and triangles of each.
    """
    measured, errors = tile.inner_measured, []
    samples, cost = codes.pack_samples(measured, steps=None), 0.1 * measured.shape[1]
    spread = partial(launch.spread, step="error hierarchy", threads=threads, cost=cost)
    for x, y, level, corners in diamonds:
        largest = np.zeros(len(measured), np.float64)
        for corner in corners:
            inputs = [samples, tile.box.x0, tile.box.y0, corner, flat(largest, wp.float64)]
            spread(kernels.window_errors, len(measured), inputs)
        errors.append(LargeError(x, y, level, _rounded_up(float(largest.max()))))
    return errors


def _cells_over(grid: TileGrid, box: TileBox, side: int) -> list[tuple[int, int]]:
    """Return the cells of `side` samples that meet a tile: (column, row) of each.

    side: at least that of a tile, so that one cell holds the tile. A tile at the raster's border also meets the cells
    of the padding beyond it, if one begins there.
    """
    axes = []
    for first, last, cells, span in zip(
        box[:2], box[2:], (grid.lattice.cells_x, grid.lattice.cells_y), grid.lattice.span, strict=True
    ):
        beyond = [last // side] if last == cells < span and last % side == 0 else []
        axes.append([first // side, *beyond])
    return [(x, y) for y in axes[1] for x in axes[0]]


def _centre_corners(x: int, y: int, side: int, is_root: bool, height: Height) -> list[Corner]:
    """Return the two triangles of the diamond in the middle of cell (x, y): column and row of cells of `side` samples.

    is_root: the cell is a root square. height: function of a sample (i, j), metres.
    """
    corners = []
    # Whether the legs of the first triangle point to the north-east; else to the south-east. The cells' diagonals
    # alternate as the squares of a chessboard, except for root squares (as in the kernel `centre_errors`).
    points_northeast = is_root or (x + y) & 1 == 1
    for k in range(2):
        right = 1 - 2 * k
        up = right if points_northeast else -right
        # The sample at the right angle: the western one first, at the southern end of the cell if the legs point north.
        i, j = (x + k) * side, (y + (0 if up > 0 else 1)) * side
        corner_height = height(i, j)
        slope_x = float(right) * (height(i + right * side, j) - corner_height) / float(side)
        slope_y = float(up) * (height(i, j + up * side) - corner_height) / float(side)
        corners.append(_corner(i, j, right, up, side, corner_height, slope_x, slope_y))
    return corners


def _side_corner(x: int, y: int, right: int, up: int, half: int, height: Height) -> Corner:
    """Return the right triangle, of four in the diamond of a side, that is towards `right` and `up`.

    x, y: middle of the side, in units of `half` samples, half the side. right, up: 1 or -1. height: function of a
    sample (i, j), metres. The triangle's plane contains both ends of the side and the corner across from it.
    """
    is_along_x = x & 1  # the ends of a side are even multiples of `half` along both axes, its middle is odd along one
    dx, dy = is_along_x * half, (1 - is_along_x) * half
    i, j = x * half, y * half
    begin, end = height(i - dx, j - dy), height(i + dx, j + dy)
    middle = 0.5 * (begin + end)
    slope_along = (end - begin) / (2.0 * float(half))
    across = up if is_along_x else right
    # The corner across from the side is `half` samples from its middle, at right angles: dx and dy exchanged.
    slope_across = float(across) * (height(i + across * dy, j + across * dx) - middle) / float(half)
    slopes = (slope_along, slope_across) if is_along_x else (slope_across, slope_along)
    return _corner(i, j, right, up, half, middle, *slopes)


def _corner(x: int, y: int, right: int, up: int, legs: int, plane: float, slope_x: float, slope_y: float) -> Corner:
    """Return a right triangle for the kernel: its corner (x, y), samples, and the plane over it.

    right, up: 1 or -1, directions of the legs of `legs` samples. plane: height at the corner, slopes: metres a sample.
    """
    corner = Corner()
    corner.x, corner.y, corner.right, corner.up, corner.legs = x, y, right, up, legs
    corner.plane, corner.slope_x, corner.slope_y = plane, slope_x, slope_y
    return corner


def _rounded_up(value: float) -> float:
    """Return the smallest float32 that is not below a number."""
    rounded = np.float32(value)
    return float(rounded if float(rounded) >= value else np.nextafter(rounded, np.float32(math.inf)))
