# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights of finer tiles (finer_tiles.py): those of the raster, and where they are known those of finer files.

They are read by window, and each finished window is recorded, so that a killed computation loses one at most.
"""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from itertools import groupby, product
from typing import Any, NamedTuple

import numpy as np

from ..errors import TerrainError
from .finer_tiles import SIDE, STRIDE
from .heightfield import HeightField, HeightRaster

WINDOW = 4  # tiles along a side of the windows that are read together
# Kinds of records: the heights of a window, the limits of the changes of a square, and its errors and ranges.
FILLED, LIMITED, MEASURED = "finer_filled", "finer_limited", "finer_measured"

Tile = tuple[int, int]  # column and row


class FinerBox(NamedTuple):
    """First and last finer samples along x and y."""

    x0: int
    y0: int
    x1: int
    y1: int


class FinerRecords:
    """Records of finished windows and squares, so that a killed computation can go on; here there are none."""

    def find(self, kind: str, number: int) -> dict[str, Any] | None:
        """Return the values of a record, None for none. kind: FILLED, LIMITED or MEASURED."""
        return None

    def note(self, kind: str, number: int, **values: Any) -> None:
        """Write a record."""


def raster_heights(plain: HeightField | HeightRaster, bits: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the heights of the raster's bilinear surface at finer columns x and rows y, both rising, float64 [y, x].

    Outside of the raster they are those at its border. bits: a raster cell has 2^bits finer cells a side.
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


def window_of(tile: Tile) -> tuple[int, int]:
    """Return row and column of the window that holds a tile."""
    return tile[1] // WINDOW, tile[0] // WINDOW


def fill_heights(
    plain: HeightField,
    bits: int,
    known: list[Tile],
    numbers: np.ndarray,
    heights: np.ndarray,
    read: Callable[[FinerBox], np.ndarray],
    records: FinerRecords,
) -> Iterator[float]:
    """Fill `heights` with those of all tiles and the samples around them, metres; yield the fraction that is done.

    Arguments are those of `with_finer_tiles`. numbers: that of the tile at each place of the table, -1 for none.
    """
    last = plain.lattice.cells_x << bits, plain.lattice.cells_y << bits
    windows = [list(tiles) for _window, tiles in groupby(known, window_of)]

    def inner_heights(tile: Tile) -> np.ndarray:
        """Return the samples of a tile that are inside the raster, without those around it."""
        box = _box_of(tile, last)
        return heights[numbers[tile[1], tile[0]], 1 : box.y1 - box.y0 + 2, 1 : box.x1 - box.x0 + 2]

    reused: set[Tile] = set()
    for number, tiles in enumerate(windows):
        record = records.find(FILLED, number)
        if record is not None and record["sums"] == digest_of(map(inner_heights, tiles)):
            reused.update(tiles)
    for row, column in np.argwhere(numbers >= 0).tolist():
        inner = inner_heights((column, row)).copy() if (column, row) in reused else None
        x, y = (SIDE * n - 1 + np.arange(STRIDE) for n in (column, row))
        heights[numbers[row, column]] = raster_heights(plain, bits, x, y)
        if inner is not None:
            inner_heights((column, row))[:] = inner
    for number, tiles in enumerate(windows):
        yield number / len(windows)
        for tile in tiles:
            box = _box_of(tile, last)
            if box.x0 <= box.x1 and box.y0 <= box.y1:
                found = inner_heights(tile).copy() if tile in reused else _read_box(read, box)
                for row, column in product(range(tile[1] - 1, tile[1] + 2), range(tile[0] - 1, tile[0] + 2)):
                    if 0 <= row < numbers.shape[0] and 0 <= column < numbers.shape[1]:
                        _lay(found, box, heights[numbers[row, column]], column, row)
        if tiles[0] not in reused:
            records.note(FILLED, number, sums=digest_of(map(inner_heights, tiles)))
    for row, column in np.argwhere(numbers >= 0):
        _extend(heights[numbers[row, column]], column, row, last)


def _box_of(tile: Tile, last: tuple[int, int]) -> FinerBox:
    """Return the box of a tile inside the raster, which may be empty. last: finer cells along x and y."""
    x, y = SIDE * tile[0], SIDE * tile[1]
    return FinerBox(x, y, max(min(x + SIDE, last[0]), x - 1), max(min(y + SIDE, last[1]), y - 1))


def _read_box(read: Callable[[FinerBox], np.ndarray], box: FinerBox) -> np.ndarray:
    """Return the heights of a box, float32. Raises TerrainError for another shape."""
    found = np.asarray(read(box), np.float32)
    expected = box.y1 - box.y0 + 1, box.x1 - box.x0 + 1
    if found.shape != expected:
        raise TerrainError(f"The heights of a finer tile have the shape {found.shape}", expected=f"{expected}")
    return found


def digest_of(arrays: Iterable[np.ndarray], *texts: str) -> str:
    """Return a hex digest of arrays and texts."""
    content = hashlib.blake2b(" ".join(texts).encode(), digest_size=16)
    for array in arrays:
        content.update(np.ascontiguousarray(array).data)
    return content.hexdigest()


def _lay(found: np.ndarray, box: FinerBox, tile: np.ndarray, column: int, row: int) -> None:
    """Write the heights `found` of a box that are not NaN into the samples of a tile."""
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
