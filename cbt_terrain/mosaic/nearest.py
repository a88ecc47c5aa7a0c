# SPDX-License-Identifier: GPL-3.0-or-later
"""Single samples of a mosaic, for a quick import: the sample of the highest-ranked tile that is nearest to a position.

Tiles on the grid give the composite's samples, bit by bit. Samples of other tiles are off by up to half a step of the
tile. A mosaic whose samples take long to unpack is read from overviews of its files, if they have any (thinning.py).
"""

from collections.abc import Callable

import numpy as np

from ..importing.thinning import FINER, MAX_UNPACKED, scaled
from .composite import Composite
from .systems import projected

MAX_GAP = 16  # rows between two that are read together
MAX_PART = 1 << 22  # samples that are read at once
ROUNDING = 1e-6


def nearest_samples(composite: Composite, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Return samples at rows and columns of the grid, float64 [rows, columns] with NaN for gaps.

    rows, columns: ascending, counted from the grid's corner in the north-west. A call opens each file once. The next
    call opens only files again that the composite has not kept open.
    """
    grid = composite.grid
    rows, columns = grid.row + rows, grid.column + columns
    heights = np.full((len(rows), len(columns)), np.nan)
    stride = float(np.diff(columns).max(initial=1))  # largest step between wanted samples, in samples of the grid
    for rank, box in enumerate(composite.near):
        across = slice(*np.searchsorted(columns, [box[0], box[2]]))
        down = slice(*np.searchsorted(rows, [box[1], box[3]]))
        part = heights[down, across]
        if part.size:
            composite.on_piece()
            places = grid.positions(*np.meshgrid(columns[across], rows[down]))
            _fill(composite, rank, *places, stride / composite.steps[rank], part)  # over those of lower ranks
    return heights


def _fill(composite: Composite, rank: int, x: np.ndarray, y: np.ndarray, stride: float, heights: np.ndarray) -> None:
    """Write over `heights` a tile's samples nearest to positions x and y (in the grid's system), where it has any.

    All arrays are float64 [rows, columns]. stride: columns of the tile between two positions. rank: number of the tile.
    """
    tile = composite.tiles[rank]
    x, y = (values.reshape(heights.shape) for values in projected(composite.grid.crs, tile.crs, x.ravel(), y.ravel()))
    with np.errstate(invalid="ignore"):
        u, v = map(np.rint, tile.indices(x, y))
        inside = (u >= 0) & (u < tile.width) & (v >= 0) & (v < tile.height)
    if not inside.any():
        return
    u, v = u[inside].astype(np.int64), v[inside].astype(np.int64)
    samples = _samples(composite, rank, u, v, stride)
    has_height = np.isfinite(samples)
    inside[inside] = has_height  # now only positions whose sample has a height
    heights[inside] = samples[has_height]


def _samples(composite: Composite, rank: int, u: np.ndarray, v: np.ndarray, stride: float) -> np.ndarray:
    """Return the samples of a tile at columns u and rows v, float64 [n].

    A mosaic of more than MAX_UNPACKED samples takes them from an overview, if the file has one that still has about
    FINER samples for each one wanted. stride: columns of the tile between two wanted samples. rank: number of the tile.
    """
    tile, small = composite.tiles[rank], None
    if composite.grid.width * composite.grid.height > MAX_UNPACKED:
        # ROUNDING: a quotient just below a whole number counts as that number.
        small = composite.overview_of(rank, max_factor=int(stride / FINER + ROUNDING))
    if small is None:
        return _read(lambda *window: composite.tile_window(rank, *window), u, v)
    try:
        composite.reads_overviews = True
        u, v = scaled(u, tile.width, small.width), scaled(v, tile.height, small.height)
        return _read(lambda *window: composite.values_of(tile, small, *window), u, v)
    finally:
        small.close()


def _read(window: Callable[[int, int, int, int], np.ndarray], u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the samples at columns u and rows v, read in bands of rows.

    window: returns samples by first row, number of rows, first column and number of columns.
    """
    left, samples = int(u.min()), np.empty(len(u))
    width = int(u.max()) + 1 - left
    rows = np.unique(v)
    bands = rows // max(1, MAX_PART // width)  # number of each row's band
    for band_rows in np.split(rows, np.flatnonzero((np.diff(rows) > MAX_GAP) | (np.diff(bands) > 0)) + 1):
        first, last = int(band_rows[0]), int(band_rows[-1])
        in_band = (v >= first) & (v <= last)
        samples[in_band] = window(first, last + 1 - first, left, width)[v[in_band] - first, u[in_band] - left]
    return samples
