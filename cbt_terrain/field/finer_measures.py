# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of the change, ranges of heights and limits of finer tiles (finer_tiles.py), by rectangles of tiles.

The arrays that are filled are those of `FinerTiles`: an entry for the number of each tile. It holds *pages*: blocks of
PAGE x PAGE values in the order of lattice.py. They are cut from *images*: the values of a group of four depths of
diamonds, as rows and columns of the vertices that split them, 4^group = 2^shift finer cells apart. Tiles store the
errors of GROUPS groups. UP is a factor slightly above 1, which rounds bounds up. The *change* is the surface with finer
heights minus that of the raster.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from . import codes, hierarchy
from .finer_tiles import SIDE, bounds_table
from .lattice import Lattice, pages_of, rows_of

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
        heights: of its finer samples, float32 metres; NaN outside of tiles.
        change: the surface minus that of the raster at its finer samples, float32 metres; all are 0 outside of tiles.
        lattice: of the finer samples, with a root square for each tile.
    """

    column: int
    row: int
    heights: np.ndarray
    change: np.ndarray
    lattice: Lattice

    def samples_of(self, tile: MeasuredFinerTile) -> tuple[slice, slice]:
        """Return the rows and columns of a tile's samples in the rectangle, with the last ones, which tiles share."""
        y, x = SIDE * (tile.row - self.row), SIDE * (tile.column - self.column)
        return slice(y, y + SIDE + 1), slice(x, x + SIDE + 1)


def fill_errors(
    rectangle: MeasuredRectangle,
    tiles: list[MeasuredFinerTile],
    errors: np.ndarray,
    threads: int,
    *,
    table: np.ndarray,
) -> None:
    """Fill the codes of the errors of the change in some tiles of a rectangle.

    errors: uint8 [all tiles, codes]. table: metres of the codes.
    """
    small = rectangle.lattice
    change_errors = np.zeros(small.node_count, np.float32)
    hierarchy.build_errors(rectangle.change, small, change_errors, threads)
    images = list(_images(small.layout(), change_errors * UP))  # above the rounding of the change to float32
    for tile in tiles:
        stored = np.concatenate([_pages(image, rectangle.samples_of(tile), shift) for image, shift in images])
        errors[tile.number] = 0  # an earlier attempt may have left others, and zeros are not written
        codes.encode_part(stored, table, errors[tile.number], threads)


def fill_bounds(
    rectangle: MeasuredRectangle,
    tiles: list[MeasuredFinerTile],
    bounds: np.ndarray,
    threads: int,
    *,
    exponent: int,
    off: float,
) -> None:
    """Fill the codes of a bound of the bicubic surface's errors (not those of the change) in some tiles of a rectangle.

    The bound is the error of the bilinear surface between the finer heights plus `off`, the largest distance of the
    bicubic surface from it, metres. It is infinite where a diamond's box has unknown heights. bounds: uint8 [all tiles,
    codes]. exponent: the codes of the errors of the change reach 2^exponent metres.
    """
    small, table = rectangle.lattice, codes.tables([exponent])[0]
    cells = hierarchy.stored_at(small, small.cell_depth)
    change_errors, surface_errors = np.zeros(small.node_count, np.float32), np.zeros(small.node_count, np.float32)
    # Errors inside the finer cells, where each surface is a saddle.
    hierarchy.build_twists(rectangle.change, cells, change_errors, threads)
    hierarchy.build_twists(rectangle.heights, cells, surface_errors, threads)
    # In finer cells kernels add the raster's error, which is at most `off`, and the change's code. No bound above may
    # be smaller than this sum.
    coded = table[np.minimum(np.searchsorted(table, change_errors[cells.base :] * UP), len(table) - 1)]
    np.maximum(surface_errors[cells.base :], coded, out=surface_errors[cells.base :])
    filled = np.nan_to_num(rectangle.heights)
    hierarchy.measure_triangles(filled, small, surface_errors, threads, measured=rectangle.heights)
    # Number of unknown heights south and west of each sample.
    missing = np.pad(np.isnan(rectangle.heights).cumsum(0, np.int32).cumsum(1, np.int32), ((1, 0), (1, 0)))
    images = []  # of each group of depths: bounds at rows and columns of vertices that are 2^shift cells apart
    for image, shift in _images(small.layout(), surface_errors, with_cells=False):
        rows, columns = image.shape
        # Above the rounding of `off`, of this sum, and of the sum of both errors in kernels.
        bound = (image + np.float32(off)) * UP * UP * UP
        images.append((np.where(_are_covered(missing, (rows, columns), shift), bound, np.float32(np.inf)), shift))
    for tile in tiles:
        stored = np.concatenate([_pages(image, rectangle.samples_of(tile), shift) for image, shift in images])
        bounds[tile.number] = 0
        codes.encode_part(stored, bounds_table(exponent), bounds[tile.number], threads)


def _are_covered(missing: np.ndarray, shape: tuple[int, int], shift: int) -> np.ndarray:
    """Return whether heights are known in the whole box of each diamond of a group, bool of `shape`.

    missing: number of unknown finer samples south and west of each sample. shift: log2 of the finer cells between two
    vertices of the group. A diamond's box reaches 3 halves of a side from a cell's centre, and one side from the
    middle of a side.
    """
    covered = np.empty(shape, bool)
    # Cells of the group's two finer depths have a side of 2 vertices: the centre has an odd row and column, the middle
    # of a side one of both odd. The coarser cells have 4, so this holds for half of the even rows and columns.
    for row, column in np.ndindex(4, 4):  # remainders of a vertex's row and column
        is_larger = not (row | column) & 1  # the two coarser depths of the group
        is_edge = ((row ^ column) >> 1 if is_larger else row ^ column) & 1  # else the vertex is a cell's centre
        # In vertices: 3 halves of a side are 3 or 6, a side is 2 or 4.
        reach = (2 if is_larger else 1) * (3 - is_edge) << shift
        ends = []
        for first, vertices, samples in zip((row, column), shape, missing.shape, strict=True):
            at = np.arange(first, vertices, 4) << shift
            ends.append((np.clip(at - reach, 0, samples - 1), np.clip(at + reach + 1, 0, samples - 1)))
        (south, north), (west, east) = ends
        # The number of unknown samples in a box, from the numbers at its four corners, is 0 where both are equal.
        up_to_north = missing[np.ix_(north, east)] - missing[np.ix_(north, west)]
        up_to_south = missing[np.ix_(south, east)] - missing[np.ix_(south, west)]
        covered[row::4, column::4] = up_to_north == up_to_south
    return covered


def fill_ranges(
    rectangle: MeasuredRectangle,
    tiles: list[MeasuredFinerTile],
    ranges: np.ndarray,
    threads: int,
    *,
    scale: tuple[float, float],
    off: float = 0.0,
) -> None:
    """Fill the codes of the lowest and highest heights in some tiles of a rectangle.

    ranges: uint16 [all tiles, codes, 2]. scale: metres of code 0, and of a step. off: largest distance of the surface,
    metres, from the bilinear one between heights.
    """
    small, heights = rectangle.lattice, np.nan_to_num(rectangle.heights)  # NaN outside of tiles
    low, high = outward(heights, off) if off else (heights, heights)
    surface_ranges = np.zeros((small.range_count, 2), np.uint16)
    hierarchy.build_ranges(low, small, *scale, surface_ranges, threads)
    if off:
        high_ranges = np.zeros_like(surface_ranges)
        hierarchy.build_ranges(high, small, *scale, high_ranges, threads)
        surface_ranges[:, 1] = high_ranges[:, 1]  # now the ranges of the surface between both
    images = list(_images(small.range_layout(), surface_ranges, with_cells=False))
    for tile in tiles:
        area = rectangle.samples_of(tile)
        # An image of ranges has every other vertex, since the two finest depths store none: hence 1 more halving.
        ranges[tile.number] = np.concatenate([_pages(image, area, shift + 1) for image, shift in images])


def outward(heights: np.ndarray, off: float) -> tuple[np.ndarray, np.ndarray]:
    """Return `heights` - `off` and `heights` + `off`, float32 metres, rounded outwards."""
    low, high = (np.float32(heights - np.float64(off)), np.float32(heights + np.float64(off)))
    return np.nextafter(low, np.float32(-np.inf)), np.nextafter(high, np.float32(np.inf))


def limits_of(rectangle: MeasuredRectangle, tile: MeasuredFinerTile) -> tuple[np.float32, np.float32]:
    """Return the largest change of a tile of a rectangle, metres, and its largest slope along an axis, rounded up."""
    change = rectangle.change[rectangle.samples_of(tile)]
    steps = (1, rectangle.lattice.step_x), (0, rectangle.lattice.step_y)
    slopes = [float(np.abs(np.diff(change, axis=axis)).max()) / step for axis, step in steps]
    return np.float32(float(np.abs(change).max()) * UP), np.float32(max(slopes) * UP)


def _images(
    layout: tuple[np.ndarray, np.ndarray], values: np.ndarray, with_cells: bool = True
) -> Iterator[tuple[np.ndarray, int]]:
    """Yield the values of each stored group of depths as rows of vertices, and log2 of the cells between two vertices.

    layout: first entry of each group in `values`, and its pages in a row. with_cells: also yield those of the cells.
    """
    base, pages = layout
    for group in (*range(GROUPS), *([len(pages) - 1] if with_cells else [])):
        rows = rows_of(values[base[group] : base[group + 1]], int(pages[group]))
        yield rows, 2 * group if group < GROUPS else 0


def _pages(image: np.ndarray, area: tuple[slice, slice], shift: int) -> np.ndarray:
    """Return the entries of a tile as pages, [n, ...]; `image`: rows of vertices, 2^shift cells apart.

    area: the tile's rows and columns of finer samples in the rectangle of `image`.
    """
    # A tile's last line belongs to the next tile.
    y, x = (slice(side_range.start >> shift, side_range.stop - 1 >> shift) for side_range in area)
    return pages_of(image[y, x])
