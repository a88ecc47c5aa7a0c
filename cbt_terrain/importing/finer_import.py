# SPDX-License-Identifier: GPL-3.0-or-later
"""Import of the finer tiles of a mosaic, after its coarser raster is there (mosaic/finer_plan.py).

They are made in the work of that raster (tiling/tile_work.py): a window of tiles that was read, or a square that was
measured, in a killed import is not made again.
"""

import math
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np

from ..field.finer_build import with_finer_tiles
from ..field.finer_heights import FILLED, WINDOW, FinerBox, FinerRecords, Tile, raster_heights
from ..field.finer_tiles import SIDE, tile_shape
from ..field.heightfield import HeightField
from ..field.store import Draft
from ..rasters.raster import FinerSource
from ..tiling.tile_records import FIGURES, FINER
from ..tiling.tile_work import TileWork
from .finer_squares import is_in_squares
from .height_reader import HeightReader

MARGIN = 2  # raster cells, inside the border of the finer tiles, in which heights change from the raster's to the finer


def add_finer_tiles(
    plain: HeightField,
    source: FinerSource,
    reader: HeightReader,
    draft: Draft,
    work: TileWork,
    on_progress: Callable[[float], None],
) -> HeightField:
    """Return the field `plain` of the coarser files with the finer heights of `source`, in the arrays of a draft.

    Near the border of all finer tiles they are mixed with the heights of `plain`. reader: gets their figures. work: of
    the raster, in the draft's folder. on_progress, errors: as in `with_finer_tiles`.
    """
    bits, lattice = source.bits, plain.lattice
    last = lattice.cells_x << bits, lattice.cells_y << bits
    margin = min(MARGIN << bits, SIDE // 2)
    known = known_tiles(source.boxes, margin, last, tile_shape(lattice, bits))
    known = {tile for tile in known if is_in_squares(tile, source, lattice)}
    windows, records = _Windows(source, reader, last), _WorkRecords(work, reader)

    def read(box: FinerBox) -> np.ndarray:
        """Return the finer heights of a tile, near the border of all tiles mixed with those of the raster."""
        heights = windows.heights(box)
        weights = border_weights((box.x0 // SIDE, box.y0 // SIDE), known, margin, last)[
            : box.y1 - box.y0 + 1, : box.x1 - box.x0 + 1
        ]
        if (weights < 1.0).any():
            x, y = np.arange(box.x0, box.x1 + 1), np.arange(box.y0, box.y1 + 1)
            coarse = raster_heights(plain, bits, x, y)
            heights = (coarse + weights * (heights - coarse)).astype(np.float32)
        return heights

    def allocate(name: str, shape: tuple, dtype: np.dtype) -> np.ndarray:
        """Return an array of the draft."""
        return work.allocate(draft, name, shape, dtype)

    field = with_finer_tiles(plain, bits, known, read, allocate=allocate, on_progress=on_progress, records=records)
    work.remove("missing")
    work.keep_records()
    return field


class _WorkRecords(FinerRecords):
    """The records of a work. Those of windows also have the figures of the reader."""

    def __init__(self, work: TileWork, reader: HeightReader):
        self._work, self._reader = work, reader
        self._found = {kind: work.records(kind) for kind in FINER}

    def find(self, kind: str, number: int) -> dict[str, Any] | None:
        """Return the values of a record, None for none; the reader gets the figures of a window."""
        found = self._found[kind].get(number)
        if found is not None and kind == FILLED:
            self._reader.add(found["figures"] | {"marks": [], "values": [math.inf, -math.inf]}, 0)
        return found

    def note(self, kind: str, number: int, **values: Any) -> None:
        """Write a record."""
        if kind == FILLED:
            figures = self._reader.figures()
            values["figures"] = {name: figures[name] for name in FIGURES}
        self._work.note(kind, number, **values)


def known_tiles(boxes: np.ndarray, margin: int, last: tuple[int, int], shape: tuple[int, int]) -> set[Tile]:
    """Return the tiles that files meet.

    boxes: int64 [files, 4], in columns and rows of the file's grid, whose first row is in the north. margin: finer
    samples around a file that count, too. last: finer cells of the raster. shape: rows and columns of tiles.
    """
    there = np.zeros(shape, bool)
    for west, north, east, south in boxes:
        first_x, end_x = max(west - margin, 0) // SIDE, min(east + margin, last[0] - 1) // SIDE
        first_y, end_y = max(last[1] - south - margin, 0) // SIDE, min(last[1] - north + margin, last[1] - 1) // SIDE
        there[first_y : end_y + 1, first_x : end_x + 1] = True
    return {(int(column), int(row)) for row, column in np.argwhere(there)}


def border_weights(tile: Tile, known: set[Tile], margin: int, last: tuple[int, int]) -> np.ndarray:
    """Return the weights of the finer heights at the samples of a tile, 0 .. 1: float64 [SIDE + 1, SIDE + 1].

    They are 0 where a tile without finer heights begins, and 1 from `margin` samples on. The raster's border does not
    count. last: finer cells of the raster along x and y.
    """
    from_west = np.arange(SIDE + 1) / margin
    distances = {-1: from_west, 0: np.zeros(SIDE + 1), 1: from_west[::-1]}
    weights = np.ones((SIDE + 1, SIDE + 1))
    for across, up in product((-1, 0, 1), (-1, 0, 1)):
        column, row = tile[0] + across, tile[1] + up
        inside = column >= 0 and row >= 0 and column * SIDE < last[0] and row * SIDE < last[1]
        if inside and (column, row) not in known:
            np.minimum(weights, np.maximum(distances[up][:, None], distances[across]), out=weights)
    return weights


class _Windows:
    """Heights of the finer samples; windows of some tiles are read together, and the last one is kept."""

    def __init__(self, source: FinerSource, reader: HeightReader, last: tuple[int, int]):
        """Prepare the reading. last: finer cells of the raster along x and y."""
        self._source, self._reader, self._last = source, reader, last
        self._kept: dict[tuple[int, int], np.ndarray] = {}

    def heights(self, box: FinerBox) -> np.ndarray:
        """Return the heights of a tile's samples, float32 metres, row 0 south; NaN where no file has any."""
        wide = WINDOW * SIDE
        key = box.x0 // wide, box.y0 // wide
        if key not in self._kept:
            x1, y1 = (min((n + 1) * wide, end) for n, end in zip(key, self._last, strict=True))
            self._kept = {key: self._read(key[0] * wide, key[1] * wide, x1, y1)}
        x, y = box.x0 - key[0] * wide, box.y0 - key[1] * wide
        return self._kept[key][y : y + box.y1 - box.y0 + 1, x : x + box.x1 - box.x0 + 1]

    def _read(self, x0: int, y0: int, x1: int, y1: int) -> np.ndarray:
        """Read the finer samples x0 .. x1 and y0 .. y1, as the heights of `heights`."""
        rows = self._source.window(self._last[1] - y1, y1 - y0 + 1, x0, x1 - x0 + 1)
        return self._reader.heights(rows)[::-1]


def finer_entries(field: HeightField) -> dict:
    """Return the report entries about finer tiles; {} without any."""
    finer, lattice = field.raster.finer, field.lattice
    if finer is None:
        return {}
    steps = [step / (1 << finer.bits) for step in (lattice.step_x, lattice.step_y)]
    return {"finer_tiles": len(finer.heights), "finer_step_m": steps}
