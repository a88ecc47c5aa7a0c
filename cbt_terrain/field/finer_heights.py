# SPDX-License-Identifier: GPL-3.0-or-later
"""Heights of finer tiles (finer_tiles.py): those of the raster, and where they are known those of finer files.

They are read by window (WINDOW x WINDOW tiles), and each finished window is recorded with a digest of all that
determines it. So a killed computation loses one at most, and windows that have not changed are taken from an earlier
store. In all functions `plain` is the raster's field without finer tiles, a raster cell has 2^`bits` finer cells a
side, and `records` are those of finished windows (FinerRecords), of the kind FILLED.
"""

from collections.abc import Callable, Iterator
from itertools import groupby, product
from typing import Any

import numpy as np

from ..errors import TerrainError
from .digests import digest_of
from .finer_tiles import SIDE, STRIDE
from .heightfield import HeightField, HeightRaster
from .lattice import TileBox

MARGIN = 2  # raster cells, inside the border of the finer tiles, in which heights change from the raster's to the finer
WINDOW = 4  # tiles along a side of the windows that are read together
LOOKED = 0.3  # fraction of the progress when it is known which windows have to be read
# Kinds of records: the heights of a window, the limits of the change of a tile, its errors, and its ranges.
FILLED, LIMITED, MEASURED, RANGED = "finer_filled", "finer_limited", "finer_measured", "finer_ranged"

Tile = tuple[int, int]  # column and row
Arrays = Callable[[str, Tile], np.ndarray | None]  # array of a tile by the name of its file; None without the tile


class FinerRecords:
    """Records of finished windows and tiles, so that a killed computation can go on; here there are none."""

    def find(self, kind: str, place: Tile, inputs: str) -> Iterator[tuple[dict[str, Any], Arrays | None]]:
        """Yield the records of a place: of this computation with None, then of an earlier store with its arrays.

        Here there are none; a subclass has some. kind: FILLED, LIMITED, MEASURED or RANGED. place: column and row of a
        tile, or of a window. inputs: digest of all that determines the result; records with another entry "inputs"
        count as none.
        """
        return iter(())

    def note(self, kind: str, place: Tile, array: np.ndarray | None = None, **values: Any) -> None:
        """Write a record. array: the errors or ranges of a tile, of the kinds MEASURED and RANGED."""

    def use(self, kind: str, place: Tile, record: dict[str, Any], is_earlier: bool) -> None:
        """Learn that the result of a record is used. is_earlier: it is of an earlier store."""

    def inputs_of(self, box: TileBox) -> str:
        """Return a digest of all that determines the heights that are read in a box, apart from the raster."""
        return ""


def raster_heights(plain: HeightField | HeightRaster, bits: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the heights of the raster's bilinear surface at finer columns x and rows y, both rising, float64 [y, x].

    Outside of the raster they are those at its border. plain: the raster. bits: a cell of it has 2^bits finer cells a
    side.
    """
    lattice, sides = plain.lattice, []
    for positions, cells in ((y, lattice.cells_y), (x, lattice.cells_x)):
        clamped = np.clip(positions, 0, cells << bits)
        cell = np.minimum(clamped >> bits, cells - 1)
        sides.append((cell, (clamped - (cell << bits)) / (1 << bits)))  # raster cells, and fractions within them
    (j, t), (i, s) = sides
    nodes = raster_nodes(plain, bits, (int(x[0]), int(x[-1])), (int(y[0]), int(y[-1]))).astype(np.float64)
    j, i, t = j - j[0], i - i[0], t[:, None]
    rows = nodes[:, i] * (1.0 - s) + nodes[:, i + 1] * s  # of samples of the raster, far fewer than finer rows
    return rows[j] * (1.0 - t) + rows[j + 1] * t


def raster_nodes(plain: HeightField | HeightRaster, bits: int, x: tuple[int, int], y: tuple[int, int]) -> np.ndarray:
    """Return the raster's samples around a rectangle of finer samples, float32 [rows, columns] metres.

    x, y: first and last finer column, and row. bits: a raster cell has 2^bits finer cells a side.
    """
    lattice, ranges = plain.lattice, []
    for ends, cells in ((y, lattice.cells_y), (x, lattice.cells_x)):
        # Raster cells of the first and the last position; the last one also has a sample at its end.
        first, last = (min(min(max(end, 0), cells << bits) >> bits, cells - 1) for end in ends)
        ranges.append(slice(first, last + 2))
    return plain.heights(*ranges)


def border_margin(bits: int) -> int:
    """Return the finer samples, inside the border of all known tiles, in which heights change from the raster's.

    bits: a raster cell has 2^bits finer cells a side.
    """
    return min(MARGIN << bits, SIDE // 2)


def border_weights(tile: Tile, known: set[Tile], margin: int, last: tuple[int, int], around: int = 0) -> np.ndarray:
    """Return the weights of the finer heights at the samples of a tile, 0 .. 1: float64 [rows, columns].

    They are 0 where a tile without finer heights begins, and 1 from `margin` samples on. The raster's border does not
    count. known: the tiles with finer heights, (column, row) each. last: finer cells of the raster along x and y.
    around: 1 to include the samples next to the tile, on each side.
    """
    at = np.arange(-around, SIDE + 1 + around)
    # Along one axis, from the column (or row) of tiles before, of the tile itself and after it: in margins.
    distances = {-1: np.maximum(at, 0), 0: np.maximum(np.maximum(-at, at - SIDE), 0), 1: np.maximum(SIDE - at, 0)}
    distances = {step: distance / margin for step, distance in distances.items()}
    weights = np.ones((len(at), len(at)))
    for across, up in product((-1, 0, 1), (-1, 0, 1)):
        column, row = tile[0] + across, tile[1] + up
        is_in_raster = column >= 0 and row >= 0 and column * SIDE < last[0] and row * SIDE < last[1]
        if is_in_raster and (column, row) not in known:
            np.minimum(weights, np.maximum(distances[up][:, None], distances[across]), out=weights)
    return weights


def window_of(tile: Tile) -> tuple[int, int]:
    """Return row and column of the window that holds a tile."""
    return tile[1] // WINDOW, tile[0] // WINDOW


def fill_heights(
    plain: HeightField,
    bits: int,
    known: list[Tile],
    numbers: np.ndarray,
    heights: np.ndarray,
    read: Callable[[TileBox], np.ndarray],
    records: FinerRecords,
) -> Iterator[float]:
    """Fill `heights` with those of all tiles and the samples around them, metres; yield the fraction that is done.

    known: tiles with finer heights, grouped by window. numbers: int [rows, columns] of the table of tiles, their
    indices in `heights`, -1 for none. heights: float32 [tiles, STRIDE, STRIDE]. read(box): returns finer heights,
    float32 [rows, columns] metres, NaN where only the raster is known.
    """
    last = plain.lattice.cells_x << bits, plain.lattice.cells_y << bits  # column and row of the last finer sample
    windows = [list(tiles) for _window, tiles in groupby(known, window_of)]

    def inner_heights(tile: Tile) -> np.ndarray:
        """Return the samples of a tile that are inside the raster, without those around it."""
        box = _box_of(tile, last)
        return heights[numbers[tile[1], tile[0]], 1 : box.y1 - box.y0 + 2, 1 : box.x1 - box.x0 + 2]

    reused: set[Tile] = set()  # tiles of windows that have their heights already
    digests, known_tiles = [], set(known)
    # Compare each window with its record; this takes the fraction LOOKED of the progress.
    for index, tiles in enumerate(windows):
        yield LOOKED * index / len(windows)
        digests.append(_inputs_of_window(plain, bits, tiles, known_tiles, records))
        if _is_filled(tiles, digests[-1], numbers, heights, inner_heights, records):
            reused.update(tiles)
    # The raster's heights in all tiles, which finer ones replace afterwards; reused ones are put back.
    for row, column in np.argwhere(numbers >= 0).tolist():
        inner = inner_heights((column, row)).copy() if (column, row) in reused else None
        x, y = (SIDE * n - 1 + np.arange(STRIDE) for n in (column, row))
        heights[numbers[row, column]] = raster_heights(plain, bits, x, y)
        if inner is not None:
            inner_heights((column, row))[:] = inner
    # The finer heights of each known tile, also in those samples that its neighbours share.
    for index, tiles in enumerate(windows):
        yield LOOKED + (1.0 - LOOKED) * index / len(windows)
        for tile in tiles:
            box = _box_of(tile, last)
            if box.x0 <= box.x1 and box.y0 <= box.y1:
                box_heights = inner_heights(tile).copy() if tile in reused else _read_box(read, box)
                for row, column in product(range(tile[1] - 1, tile[1] + 2), range(tile[0] - 1, tile[0] + 2)):
                    if 0 <= row < numbers.shape[0] and 0 <= column < numbers.shape[1]:
                        _write_known(box_heights, box, heights[numbers[row, column]], column, row)
        if tiles[0] not in reused:
            sums = digest_of(map(inner_heights, tiles))
            records.note(FILLED, window_of(tiles[0])[::-1], inputs=digests[index], sums=sums)
    for row, column in np.argwhere(numbers >= 0):
        extend_beyond(heights[numbers[row, column]], column, row, last)


def _inputs_of_window(plain: HeightField, bits: int, tiles: list[Tile], known: set[Tile], records: FinerRecords) -> str:
    """Return a digest of all that determines the heights of the known tiles of a window, `tiles`.

    known: the known tiles of the whole table. Places are counted from the window, so that a window is the same in a
    raster that grows in the west or south.
    """
    (down, across), lattice = window_of(tiles[0]), plain.lattice
    last = lattice.cells_x << bits, lattice.cells_y << bits
    x0, y0 = WINDOW * SIDE * across, WINDOW * SIDE * down
    box = TileBox(x0, y0, min(x0 + WINDOW * SIDE, last[0]), min(y0 + WINDOW * SIDE, last[1]))
    columns, rows = (range(WINDOW * at - 1, WINDOW * (at + 1) + 1) for at in (across, down))
    # Known tiles in the window and next to it.
    around = [(column - columns[0], row - rows[0]) for row in rows for column in columns if (column, row) in known]
    nodes = raster_nodes(plain, bits, (box.x0, box.x1), (box.y0, box.y1))
    # Only ends of the raster that the window or its neighbours meet make a difference.
    ends = [min(across, 1), min(down, 1), *(min(end, WINDOW * SIDE + 1) for end in (last[0] - x0, last[1] - y0))]
    # `inputs_of`: a digest of the finer files in the box.
    return digest_of([nodes], repr((bits, WINDOW, ends, around)), records.inputs_of(box))


def _is_filled(
    tiles: list[Tile],
    inputs: str,
    numbers: np.ndarray,
    heights: np.ndarray,
    inner_heights: Callable[[Tile], np.ndarray],
    records: FinerRecords,
) -> bool:
    """Return whether a window has its heights, of this computation or copied from an earlier store.

    tiles: its known ones. inputs: digest of all that determines its heights. inner_heights(tile): the part of `heights`
    that is inside the tile and the raster. numbers: int [rows, columns] of the table of tiles, their indices in
    `heights`. heights: float32 [tiles, STRIDE, STRIDE] metres, all tiles.
    """
    place = window_of(tiles[0])[::-1]  # column and row
    # Each record has the function that returns an earlier store's arrays, or None if it is of this computation.
    for record, earlier_arrays in records.find(FILLED, place, inputs):
        if record["inputs"] != inputs:
            continue
        if earlier_arrays is not None:  # else `heights` has them
            stored = [earlier_arrays("heights", tile) for tile in tiles]
            if any(array is None for array in stored):
                continue
            for tile, array in zip(tiles, stored, strict=True):
                heights[numbers[tile[1], tile[0]]] = array
        if record["sums"] == digest_of(map(inner_heights, tiles)):
            records.use(FILLED, place, record, is_earlier=earlier_arrays is not None)
            return True
    return False


def _box_of(tile: Tile, last: tuple[int, int]) -> TileBox:
    """Return the box of a tile inside the raster, which may be empty. last: finer cells along x and y."""
    x, y = SIDE * tile[0], SIDE * tile[1]
    return TileBox(x, y, max(min(x + SIDE, last[0]), x - 1), max(min(y + SIDE, last[1]), y - 1))


def _read_box(read: Callable[[TileBox], np.ndarray], box: TileBox) -> np.ndarray:
    """Return the heights of a box, float32. Raises TerrainError for another shape."""
    heights = np.asarray(read(box), np.float32)
    if heights.shape != box.shape:
        raise TerrainError(f"The heights of a finer tile have the shape {heights.shape}", expected=f"{box.shape}")
    return heights


def _write_known(box_heights: np.ndarray, box: TileBox, tile: np.ndarray, column: int, row: int) -> None:
    """Write the heights of a box that are not NaN into the samples of a tile.

    box: its columns x0 to x1 and rows y0 to y1 of finer samples, the last ones included. column, row: of the tile.
    """
    x, y = SIDE * column - 1, SIDE * row - 1  # first samples of the tile, those around it included
    x0, x1 = max(box.x0, x), min(box.x1, x + STRIDE - 1)
    y0, y1 = max(box.y0, y), min(box.y1, y + STRIDE - 1)
    if x0 <= x1 and y0 <= y1:
        part = box_heights[y0 - box.y0 : y1 + 1 - box.y0, x0 - box.x0 : x1 + 1 - box.x0]
        target = tile[y0 - y : y1 + 1 - y, x0 - x : x1 + 1 - x]
        np.copyto(target, part, where=~np.isnan(part))


def extend_beyond(tile: np.ndarray, column: int, row: int, last: tuple[int, int]) -> None:
    """Continue a tile's heights beyond the raster's border, so that differences across it are those inside of it.

    The first line beyond the border continues the slope of the two lines before it; all further ones repeat the
    heights of the border. last: finer cells of the raster along x and y.
    """
    for lines, first, end in ((tile.T, SIDE * column - 1, last[0]), (tile, SIDE * row - 1, last[1])):
        if first < 0:  # the tile's first line is before the raster's
            lines[0] = 2.0 * lines[1] - lines[2]
        border = end - first  # index of the raster's last line in the tile
        if 1 <= border < STRIDE - 1:
            beyond = 2.0 * lines[border] - lines[border - 1]
            lines[border + 1 :] = lines[border]
            lines[border + 1] = beyond
        elif border < 1:  # the tile has no two lines of the raster, so no slope
            lines[:] = lines[max(border, 0)]
