# SPDX-License-Identifier: GPL-3.0-or-later
"""Measured finer tiles of an earlier attempt or store, which are used again where nothing has changed.

A record counts only if its digest "inputs" is the present one. `FinerRecords.find` yields records, each with a function
that returns the earlier arrays of a tile by name, or with None if it is of this attempt, whose arrays are there. Kinds
of records: LIMITED, the limits of a tile's change; MEASURED, its errors; RANGED, its ranges of heights.
"""

from itertools import product

import numpy as np

from .digests import digest_of
from .finer_heights import LIMITED, MEASURED, RANGED, FinerRecords, Tile, raster_nodes
from .finer_tiles import SIDE
from .heightfield import HeightField

NAMES = {MEASURED: "errors", RANGED: "ranges"}  # of arrays, by the kind of their records


def inputs_of_tiles(
    plain: HeightField, bits: int, numbers: np.ndarray, heights: np.ndarray
) -> dict[tuple[int, int], str]:
    """Return a digest of all that determines a tile's change, by row and column of the tile.

    These are the heights of the tile and its neighbours, the raster's samples below them, and the raster's borders
    nearby. Slopes also depend on the metres between samples, which the caller adds. plain: the raster's field, whose
    cells have 2^bits finer cells a side. numbers: int32 [rows, columns], index of each tile in `heights`, -1 without a
    tile. heights: float32 [tiles, rows, columns] metres.
    """
    lattice, digests = plain.lattice, {}
    for row, column in np.argwhere(numbers >= 0).tolist():
        nodes = raster_nodes(plain, bits, *((SIDE * index, SIDE * (index + 1)) for index in (column, row)))
        digests[row, column] = digest_of([heights[numbers[row, column]], nodes])
    inputs = {}
    for row, column in digests:
        around = [digests.get((row + down, column + across)) for down, across in product((-1, 0, 1), (-1, 0, 1))]
        # Finer cells from the tile's south-western corner to the raster's eastern and northern border.
        ends = (lattice.cells_x << bits) - SIDE * column, (lattice.cells_y << bits) - SIDE * row
        # How near the four borders are; all distances beyond the tile's neighbours count as one.
        place = [min(column, 1), min(row, 1), *(min(end, 3 * SIDE) for end in ends)]
        inputs[row, column] = digest_of([], repr((bits, place, around)))
    return inputs


def limits_before(records: FinerRecords, tile: Tile, inputs: str) -> list[float] | None:
    """Return the limits of a tile's change that an earlier attempt or store has; None without any.

    They are the largest change, metres, and its largest slope. inputs: digest of all that determines them.
    """
    for record, earlier_arrays in records.find(LIMITED, tile, inputs):
        if record["inputs"] == inputs:
            records.use(LIMITED, tile, record, is_earlier=earlier_arrays is not None)
            return record["limits"]
    return None


def is_measured(records: FinerRecords, kind: str, tile: Tile, inputs: str, array: np.ndarray) -> bool:
    """Return whether a tile has its errors or ranges, in `array` already or copied to it from an earlier store.

    They count if their digest is the record's "sums". kind: MEASURED or RANGED. inputs: digest of all that determines
    them.
    """
    for record, earlier_arrays in records.find(kind, tile, inputs):
        if record["inputs"] != inputs:
            continue
        if earlier_arrays is not None:
            earlier = earlier_arrays(NAMES[kind], tile)
            if earlier is None:
                continue
            array[...] = earlier
        if record["sums"] == digest_of([array]):
            records.use(kind, tile, record, is_earlier=earlier_arrays is not None)
            return True
    return False
