# SPDX-License-Identifier: GPL-3.0-or-later
"""The finer tiles of a bicubic surface: the raster's bicubic surface plus differences at finer samples.

The difference at a finer sample is its height minus the bicubic surface there, and it is interpolated bilinearly. So
the surface has the known finer heights, is smooth outside of the tiles, and is continuous. Inside the border of all
known tiles, an import mixes finer heights with those of the raster's bilinear surface. There the bicubic surface takes
its place: the height is f + (1 - w) (b - l), with the finer height f, the weight w of `border_weights`, and the heights
b and l of the bicubic and the bilinear surface. In the ring of tiles around them it is b.

The tiles hold these heights, and the errors and limits of the differences, which is their change. In a finer cell the
surface is the bilinear one between the heights plus the bicubic surface minus its bilinear interpolation between the
corners. The latter is at most (|f_xx| + |f_yy|) h^2 / 8 for finer cells of the side h, in raster cells, and so h^2
times the curvature of the patch (bicubic.py). Its largest bound in any tile, `off`, widens the ranges of heights.

A diamond's error is that of the raster's bicubic surface plus that of the differences. Both bend, and the sum is too
large where one bends against the other. Inside tiles the error of the bilinear surface between the heights plus `off`
bounds it, too. It is stored as a *bound* for diamonds of cells of 2 to 64 finer cells, and the smaller number counts.
Where tiles do not cover a diamond's box, or a hole is in it, there is no bound. Then there is none above it either. And
a bound is not below the sum in any finer cell. So the smaller number is nested.

In all functions `smooth` is the bicubic surface of the raster alone, `finer` are the tiles of the bilinear surface, and
a raster cell has 2^`bits` finer cells a side.
"""

from functools import partial

import numpy as np

from ..run import launch
from ..view.linear import add_up
from . import codes, derived_arrays, hierarchy
from .blocks import halvings
from .codes import MAX_EXPONENT, MIN_EXPONENT
from .finer_build import corners_of_squares, rectangle_around, tiles_of
from .finer_heights import border_margin, border_weights, extend_beyond, raster_heights
from .finer_measures import MeasuredRectangle, fill_bounds, fill_errors, fill_ranges, limits_of, outward
from .finer_tiles import SIDE, STRIDE, FinerTiles, bicubic_shapes
from .heightfield import HeightField, HeightRaster
from .hierarchy import ranges_at
from .holes import holes_around
from .lattice import tile_index

Arrays = dict[str, np.ndarray]


def bicubic_tiles(smooth: HeightField) -> tuple[FinerTiles, float, float]:
    """Return the finer tiles of a bicubic surface, cached in its store, and their lowest and highest height, metres.

    smooth: the bicubic surface of the raster alone, which has finer tiles.
    """
    finer = smooth.raster.finer
    assert finer is not None
    shapes = bicubic_shapes(smooth.lattice, finer.bits, len(finer.heights))
    arrays = derived_arrays.derive_cached(smooth.raster, shapes, partial(_fill, smooth, finer), _are_valid)
    exponent, base, step, low, high, off = arrays["finer_values_c"].tolist()
    heights, errors, ranges, limits, bounds = (
        arrays[f"finer_{name}_c"] for name in ("heights", "errors", "ranges", "limits", "bounds")
    )
    tiles = FinerTiles(
        finer.bits, finer.numbers, heights, errors, ranges, base, step, int(exponent), limits, off=off, bounds=bounds
    )
    return tiles, low, high


def _are_valid(arrays: Arrays) -> bool:
    """Return whether the numbers among arrays from files can be an exponent, a scale and a range of heights."""
    values = arrays["finer_values_c"]
    exponent, _base, step, low, high, off = values.tolist()
    known = np.isfinite(values).all() and MIN_EXPONENT <= exponent <= MAX_EXPONENT
    return bool(known and step > 0 and low <= high and off >= 0)


def _fill(smooth: HeightField, finer: FinerTiles, arrays: Arrays) -> None:
    """Fill the zeroed arrays of `bicubic_shapes`, by name; the same bytes for any number of threads.

    First the heights and the limits of the differences, from which the scales of codes follow; then the codes of
    errors, ranges and bounds.
    """
    bits, numbers, threads = finer.bits, finer.numbers, launch.default_threads()
    heights, errors, ranges, bounds = (arrays[f"finer_{name}_c"] for name in ("heights", "errors", "ranges", "bounds"))
    off = _max_distance(smooth, finer)  # of the surface from the bilinear one between the tiles' heights
    low, high = _fill_heights(smooth, finer, heights)
    lows, highs = outward(np.array([low, high], np.float32), off)  # minus and plus `off`, rounded outwards
    low, high = float(lows.min()), float(highs.max())
    around = partial(rectangle_around, smooth, bits, numbers, heights, surface=bicubic_heights)
    corners, limits = list(corners_of_squares(numbers)), np.zeros((*numbers.shape, 2), np.float32)
    for corner in corners:  # squares of neighbouring tiles
        tiles = list(tiles_of(corner, numbers))
        rectangle = around(tiles)
        for tile in tiles:
            limits[tile.row, tile.column] = limits_of(rectangle, tile)
    # Limits of all tiles, then of each 2 x 2 tiles, and so on: largest change in metres, and largest slope.
    arrays["finer_limits_c"][:] = np.concatenate([level.reshape(-1, 2) for level in halvings(limits, np.maximum)])
    # Diamonds too large for a stored error have twice the largest change.
    exponent = codes.exponent_of(2.0 * float(limits[..., 0].max(initial=0.0)))
    table, scale = codes.tables([exponent])[0], hierarchy.range_scale(low, high)
    for corner in corners:
        tiles = list(tiles_of(corner, numbers))
        rectangle = around(tiles)
        fill_errors(rectangle, tiles, errors, threads, table=table)
        fill_ranges(rectangle, tiles, ranges, threads, scale=scale, off=off)
        only_known = rectangle._replace(heights=_known_heights(smooth, bits, rectangle))  # NaN in holes
        fill_bounds(only_known, tiles, bounds, threads, exponent=exponent, off=off)
    arrays["finer_values_c"][:] = exponent, *scale, low, high, off


def _known_heights(smooth: HeightField, bits: int, rectangle: MeasuredRectangle) -> np.ndarray:
    """Return the heights of a rectangle of finer samples, float32 m; NaN outside of tiles and in holes of the raster.

    The borders of holes are refined by the errors of the raster, which no bound may replace.
    """
    if smooth.valid is None:
        return rectangle.heights
    places = zip((rectangle.row, rectangle.column), rectangle.heights.shape, smooth.valid.shape, strict=True)
    y, x = (np.clip(SIDE * first + np.arange(count), 0, (samples - 1) << bits) for first, count, samples in places)
    # logical_or: a sample counts if any of the cells that meet there is a hole.
    in_hole = holes_around(smooth.valid, bits, x, y, np.logical_or)
    return np.where(in_hole, np.float32(np.nan), rectangle.heights)


def _fill_heights(smooth: HeightField, finer: FinerTiles, heights: np.ndarray) -> tuple[float, float]:
    """Fill the heights of all tiles; return the lowest and the highest, metres, 0 and 0 without tiles."""
    lattice, bits, known = smooth.lattice, finer.bits, set(finer.known)
    last = lattice.cells_x << bits, lattice.cells_y << bits
    ends = [np.inf, -np.inf]
    for row, column in np.argwhere(finer.numbers >= 0).tolist():
        number = finer.numbers[row, column]
        x, y = (SIDE * at - 1 + np.arange(STRIDE) for at in (column, row))
        weights = border_weights((column, row), known, border_margin(bits), last, around=1)
        heights[number] = _mixed_heights(smooth, bits, finer.heights[number], weights, x, y)
        extend_beyond(heights[number], column, row, last)
        inner = heights[number, 1:-1, 1:-1]
        ends = [min(ends[0], float(inner.min())), max(ends[1], float(inner.max()))]
    return (ends[0], ends[1]) if len(heights) else (0.0, 0.0)


def _mixed_heights(
    smooth: HeightField, bits: int, heights: np.ndarray, weights: np.ndarray, x: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Return the heights of the surface at finer columns x and rows y: float32 [y, x] metres.

    heights: of the finer tiles, float32 [y, x] metres, where the known heights have the weight w and the raster's
    bilinear surface 1 - w; here the bicubic surface takes its place. weights: w, 0 to 1, [y, x].
    """
    if (weights == 1.0).all():
        return heights
    bilinear, bicubic = raster_heights(smooth, bits, x, y), bicubic_heights(smooth, bits, x, y)
    # Adds (1 - w) (bicubic - bilinear). The rounding of the raster's surface to float32 is no difference.
    difference = np.where(heights == bilinear.astype(np.float32), 0.0, heights - bilinear)
    mixed = (difference + (bicubic * (1.0 - weights) + bilinear * weights)).astype(np.float32)
    return np.where(weights == 1.0, heights, mixed)


def bicubic_heights(plain: HeightField | HeightRaster, bits: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the heights of the raster's bicubic surface at finer columns x and rows y, both rising, float64 [y, x].

    Outside of the raster they are those at its border. bits: a raster cell has 2^bits finer cells a side.
    """
    lattice, axes = plain.lattice, []
    for at, cells in ((x, lattice.cells_x), (y, lattice.cells_y)):
        axes.append(_samples_and_weights(at, cells, bits))
    (columns, across), (rows, up) = axes  # for each position four samples of the raster, and their weights
    first_column, first_row = int(columns.min()), int(rows.min())
    nodes = plain.heights(slice(first_row, int(rows.max()) + 1), slice(first_column, int(columns.max()) + 1))
    nodes = nodes.astype(np.float64)
    along = add_up(nodes[:, columns[k] - first_column] * across[k] for k in range(4))
    return add_up(along[rows[k] - first_row] * up[k][:, None] for k in range(4))


def _samples_and_weights(at: np.ndarray, cells: int, bits: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the four samples on which a height depends along an axis, and their weights: int64 and float64 [4, n].

    The weights are those of cubic convolution (Keys 1981). at: finer columns or rows. cells: raster cells along the
    axis. Beyond the border h(-1) = 2 h(0) - h(1).
    """
    inside = np.clip(at, 0, cells << bits)
    cell = np.minimum(inside >> bits, cells - 1)
    t = (inside - (cell << bits)) / (1 << bits)  # fraction of the cell before the position, and r after it
    r = 1.0 - t
    # Of the sample before the cell, of those at both ends of it, and of the one after it.
    weights = np.array(
        [-0.5 * t * r * r, 1 - 0.5 * t * t * (5 - 3 * t), 0.5 * t * (1 + t * (4 - 3 * t)), -0.5 * t * t * r]
    )
    # In the first and last cell the outer sample is beyond the border: its weight goes to the two inside of it.
    for beyond, outer, near, far in ((cell == 0, 0, 1, 2), (cell == cells - 1, 3, 2, 1)):
        weights[near] += np.where(beyond, 2.0 * weights[outer], 0.0)
        weights[far] -= np.where(beyond, weights[outer], 0.0)
        weights[outer] = np.where(beyond, 0.0, weights[outer])
    return np.clip(cell + np.arange(-1, 3)[:, None], 0, cells), weights


def _max_distance(smooth: HeightField, finer: FinerTiles) -> float:
    """Bound how far, metres, the surface is from the bilinear one between finer heights, in any tile.

    smooth: the bicubic surface of the raster, with the curvatures of its cells. finer: the tiles of the raster.
    """
    lattice, bits = smooth.lattice, finer.bits
    codes_of_cells, table = smooth.error[lattice.node_count :], smooth.table[lattice.groups + 1]
    pages = ranges_at(lattice, lattice.cell_depth).pages
    largest = 0  # of the codes of curvatures of the raster's cells in all tiles; a larger code is a larger curvature
    for row, column in np.argwhere(finer.numbers >= 0).tolist():
        x, y = (  # columns and rows of the raster's cells that the tile meets
            np.arange(SIDE * at >> bits, min(SIDE * (at + 1) - 1 >> bits, cells - 1) + 1, dtype=np.int64)
            for at, cells in ((column, lattice.cells_x), (row, lattice.cells_y))
        )
        largest = max(largest, int(codes_of_cells[tile_index(x, y[:, None], pages)].max(initial=0)))
    return float(table[largest]) / (1 << 2 * bits)  # curvatures fall with the square of a cell's side
