# SPDX-License-Identifier: GPL-3.0-or-later
"""Squares of a raster in which a quick import loads the finest files of a mosaic, as of a city in a large country.

It is the third step of a quick import. The second (refining.py) loads tiles of a raster with one step; where finer
files cover little of the mosaic, their samples become finer tiles (field/finer_tiles.py) on that raster, in squares of
32 x 32 cells or more. A square has finer tiles only where a finer file meets it. Those of squares that an earlier store
has are copied from it (finer_import.py).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..field.finer_tiles import MAX_BITS, SIDE, TILE_BITS
from ..field.heightfield import HeightField
from ..field.lattice import Lattice
from ..rasters.raster import FinerSource, Raster
from ..tiling.tile_grid import TileGrid

SQUARE_BITS = 5  # log2 of the raster's cells along a square, at least
FINER = "finer_m"  # entry of a store's provenance (finer_provenance)


def square_bits(bits: int) -> int:
    """Return log2 of the raster's cells along a square, which is at least as large as a tile. bits: of the tiles."""
    return max(SQUARE_BITS, TILE_BITS - bits)


def finer_source(raster: Raster, counts: Sequence[int], loaded: Sequence[int]) -> FinerSource | None:
    """Return a source of finer tiles for a coarser raster of the same area; None for a mosaic without finer files.

    `raster` has the finest step everywhere. A cell of the coarser raster becomes 2^bits x 2^bits finer cells, about as
    dense as `raster`, and a finer sample is the nearest sample of `raster`. None also if a cell of the coarser raster
    is larger than a finer tile.

    Args:
        raster: the whole mosaic; its `finest` has the boxes of the finer files.
        counts: columns and rows of cells of the coarser raster.
        loaded: numbers of the squares to load.
    """
    raster_cells = raster.width - 1, raster.height - 1
    bits = max(int(np.ceil(np.log2(size / count))) for size, count in zip(raster_cells, counts, strict=True))
    if raster.finest is None or raster.window is None or not 1 <= bits <= MAX_BITS:
        return None
    finer_cells = [count << bits for count in counts]
    scale = np.array([cell / size for cell, size in zip(finer_cells, raster_cells, strict=True)])
    # A box is first column, first row, last column and last row, here converted to finer cells.
    first_corners, last_corners = (raster.finest.boxes[:, part] * scale for part in (slice(0, 2), slice(2, 4)))
    boxes = np.concatenate([np.floor(first_corners), np.ceil(last_corners)], axis=1).astype(np.int64)

    def nearest(first: int, count: int, column: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the raster's rows and columns nearest to those of the finer grid, from `first` and `column` on."""
        # number of a sample * cells of the raster / cells of the finer grid, rounded
        v, u = (
            (2 * np.arange(start, start + number) * cells + finer) // (2 * finer)
            for start, number, cells, finer in (
                (first, count, raster_cells[1], finer_cells[1]),
                (column, columns, raster_cells[0], finer_cells[0]),
            )
        )
        return v, u

    def window(first: int, count: int, column: int, columns: int) -> np.ndarray:
        """Return samples of the finer grid, those of the raster that are nearest to its positions."""
        assert raster.window is not None
        v, u = nearest(first, count, column, columns)
        values = raster.window(*_span(v), *_span(u))
        return values[np.ix_(v - v[0], u - u[0])]

    def inputs(first: int, count: int, column: int, columns: int) -> str:
        """Return a digest of all that determines the samples of a window."""
        assert raster.inputs is not None
        v, u = nearest(first, count, column, columns)
        return f"{raster.inputs(*_span(v), *_span(u))} {raster_cells} {finer_cells}"

    given = inputs if raster.inputs is not None else None
    return FinerSource(bits, boxes, window, given, squares=frozenset(loaded), continues=raster.finest.continues)


def _span(places: np.ndarray) -> tuple[int, int]:
    """Return the first of some rising places and the number of places from it to the last."""
    return int(places[0]), int(places[-1] - places[0]) + 1


def squares_of(source: FinerSource, lattice: Lattice) -> set[int]:
    """Return the numbers of the squares of a raster that finer files meet, row by row from the south-west."""
    # a square has 2^shift finer samples a side
    grid, shift = TileGrid(lattice, square_bits(source.bits)), source.bits + square_bits(source.bits)
    has_files, finer_rows = np.zeros((grid.rows, grid.columns), bool), lattice.cells_y << source.bits
    for west, north, east, south in source.boxes:
        # a box is in finer samples with the first row in the north, the grid of squares has it in the south
        edges = int(west), int(east), finer_rows - int(south), finer_rows - int(north)
        first_column, last_column, first_row, last_row = (max(edge, 0) >> shift for edge in edges)
        has_files[first_row : last_row + 1, first_column : last_column + 1] = True
    return set(map(int, np.flatnonzero(has_files)))


def is_in_squares(tile: tuple[int, int], source: FinerSource, lattice: Lattice) -> bool:
    """Return whether a finer tile (column, row) is in a square to be loaded; all are if the source names no squares."""
    shift = source.bits + square_bits(source.bits)  # log2 of the finer samples along a square
    column, row = (place * SIDE >> shift for place in tile)  # of the square that holds the tile's first sample
    squares = source.squares
    return squares is None or row * TileGrid(lattice, square_bits(source.bits)).columns + column in squares


def finer_provenance(raster: Raster, lattice: Lattice, finest_m: float) -> dict:
    """Return the entry of a store's provenance about squares with finer files; {} for a raster without any.

    It has the finest step `finest_m`, metres, the bits of the finer tiles, whether the raster has the step of the
    coarser files, and the numbers of the squares as runs [first, count].
    """
    source = raster.squares
    if source is None or raster.finest is None:
        return {}
    numbers = np.array(sorted(squares_of(source, lattice)), np.int64)
    runs = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1) if len(numbers) else []  # of successive numbers
    # A cell of the raster has 2^bits of the finest steps a side, one of the coarser files 2^finest.bits.
    is_coarse = source.bits <= raster.finest.bits
    return {FINER: [finest_m, source.bits, is_coarse, [[int(run[0]), len(run)] for run in runs]]}


class FinerSquares(NamedTuple):
    """Squares of a store.

    Attributes:
        finest_m: the finest step, metres.
        bits: log2 of the finer samples along a cell of the raster.
        is_coarse: whether the raster has the step of the coarser files, so that only finer files have more detail.
        there: numbers of the squares with finer files.
        loaded: numbers of those that are loaded.
    """

    finest_m: float
    bits: int
    is_coarse: bool
    there: frozenset[int]
    loaded: frozenset[int]


def finer_squares(field: HeightField) -> FinerSquares | None:
    """Return the squares of a store; None for a store without any, and for damaged entries."""
    # runs: squares that finer files meet, (first, count)
    try:
        finest_m, bits, is_coarse, runs = field.provenance[FINER]
        is_valid = (type(finest_m), type(bits), type(is_coarse)) == (float, int, bool) and finest_m > 0.0
        if not is_valid or not 1 <= bits <= MAX_BITS:
            return None
        ends = [(int(first), int(first) + int(count)) for first, count in runs]
        loaded = frozenset(map(int, field.provenance["settings"].get("loaded_finer", ())))
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError):
        return None
    total = len(TileGrid(field.lattice, square_bits(bits)))
    # runs in ascending order that do not overlap
    marks = [0, *(mark for run in ends for mark in run), total]
    if marks != sorted(marks):
        return None
    there = frozenset(number for first, end in ends for number in range(first, end))
    return FinerSquares(finest_m, bits, is_coarse, there=there, loaded=loaded & there)
