# SPDX-License-Identifier: GPL-3.0-or-later
"""Records of the finished parts of an import by tile: lines of JSON with a checksum each.

A line that is incomplete or damaged counts as none, and its part is made again. An attacker can write valid checksums,
so every entry that numbers are computed from is checked, too.
"""

import json
import math
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..field import finer_heights
from ..field.codes import MAX_EXPONENT, MIN_EXPONENT
from .tile_grid import LatticeVertices, TileGrid, exist

READ, MEASURED = "read", "measured"  # kinds of records
FINER = finer_heights.FILLED, finer_heights.LIMITED, finer_heights.MEASURED, finer_heights.RANGED  # ... of finer tiles
SEAMS = "finer_seams"  # ... and of the borders of their files
# Of a unit, a part that is read at once: the largest height and the largest errors of its conversion, of its resampled
# positions and of its datum, metres or the file's unit.
FIGURES = "largest", "converted", "moved", "shifted"
# Of a measured tile: "errors" and "ranges" are digests of what they were measured from, "above" is the digest and the
# list of its LargeErrors. A record without these entries marks a tile as not measured.
STATE = "errors", "largest", "climbs", "exponents", "ranges", "above"


def line_of(record: dict) -> str:
    """Return a record as a line with its checksum."""
    return _signed(json.dumps(record).encode()).decode() + "\n"


def record_of(line: bytes, grid: TileGrid) -> dict | None:
    """Return the record in a line without its end; None for a damaged one. grid: tiles of the terrain."""
    text = line[len(_signed(b"")) - 1 : -1]  # between the checksum and the last bracket
    if line != _signed(text):
        return None
    try:
        record = json.loads(text)
        return record if _is_record(record, grid) else None
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return None


def _signed(text: bytes) -> bytes:
    """Return the JSON text of a record, wrapped in an object with its checksum."""
    return b'{"sum": "%08x", "record": %s}' % (zlib.crc32(text), text)


def _is_record(record: Any, grid: TileGrid) -> bool:
    """Return whether a JSON value is a record of a part of a terrain. Raises KeyError and others for invalid types."""
    if not _is_count(record["at"]) or not _is_count(record["number"]):
        return False
    if record["kind"] == READ:
        return _is_read(record, grid)
    if record["kind"] in (*FINER, SEAMS):
        return _is_finer(record)
    is_tile = record["kind"] == MEASURED and record["number"] < len(grid)
    # Without any entry of STATE it marks the tile as not measured.
    return is_tile and (not record.keys() & set(STATE) or _is_measured(record, grid))


def _is_read(record: dict, grid: TileGrid) -> bool:
    """Return whether the record of a unit has valid entries.

    "inputs" is a digest, "missing" the number of missing samples, "limits" the lowest and highest height, None if all
    are missing. In "figures", "marks" are pairs of a value that may mark missing samples, and its count, "values" is
    the range of all other values, and FIGURES are the largest height and the largest errors of the conversion.
    """
    lattice, figures, limits = grid.lattice, record["figures"], record["limits"]
    low, high = figures["values"]
    return (
        isinstance(record["inputs"], str)
        and _is_count(record["missing"], lattice.width * lattice.height)
        and (limits is None or (len(limits) == 2 and _are_metres(limits) and limits[0] <= limits[1]))
        and _are_metres([figures[name] for name in FIGURES], min_value=0.0)
        and all(_is_number(value) and _is_count(count) for value, count in figures["marks"])
        and _is_number(low)
        and _is_number(high)
    )


def _is_finer(record: dict) -> bool:
    """Return whether a record of a kind of FINER or of SEAMS has valid entries.

    FILLED belongs to a window of samples of finer tiles, the other kinds of FINER to one of these tiles, SEAMS to a
    block of cells. "sums" are checksums of what was written, "limits" the largest change of height, metres, and slope,
    "marks" the compressed marks of a block's cells by level.
    """
    if not isinstance(record["inputs"], str):
        return False
    if record["kind"] == SEAMS:
        marks = record["marks"]
        return isinstance(marks, dict) and all(isinstance(text, str) for item in marks.items() for text in item)
    if record["kind"] == finer_heights.LIMITED:
        change, slope = record["limits"]
        return _are_metres([change, slope], min_value=0.0)
    if record["kind"] == finer_heights.FILLED and not _are_metres(
        [record["figures"][name] for name in FIGURES], min_value=0.0
    ):
        return False
    return isinstance(record["sums"], str)


def _is_measured(record: dict, grid: TileGrid) -> bool:
    """Return whether the record of a measured tile has valid entries.

    "errors" and "ranges" are digests. "largest" and "exponents" have an item for each group of two levels and one for
    the cells, "climbs" one for each axis. "above" is a digest and a list of (x, y, level, error): diamonds larger than
    the tile.
    """
    groups = grid.local(grid.box(record["number"])).groups
    above_digest, large = record["above"]
    exponents = record["exponents"]
    return (
        all(isinstance(text, str) for text in (record["errors"], record["ranges"], above_digest))
        and len(record["largest"]) == len(exponents) == groups + 1
        and len(record["climbs"]) == 2
        and _are_metres([*record["largest"], *record["climbs"]], min_value=0.0)
        and all(type(number) is int and MIN_EXPONENT <= number <= MAX_EXPONENT for number in exponents)
        and _are_vertices([item[:3] for item in large], grid)
        and _are_metres([error for _, _, _, error in large], min_value=0.0)
    )


def _are_vertices(items: Sequence, grid: TileGrid) -> bool:
    """Return whether all items are x, y and level of a vertex of the terrain's lattice."""
    if not all(_is_count(value, 1 << 31) for item in items for value in item):
        return False
    x, y, level = np.array(items, np.int64).reshape(-1, 3).T
    return bool((level < grid.lattice.levels).all() and exist(grid.lattice, LatticeVertices(x, y, level)).all())


def _is_count(value: Any, max_count: int = 1 << 63) -> bool:
    """Return whether a JSON value is a whole number from 0 to `max_count`."""
    return type(value) is int and 0 <= value <= max_count


def _is_number(value: Any) -> bool:
    """Return whether a value is a number, perhaps infinite, but not NaN."""
    return type(value) in (int, float) and value == value


def _are_metres(values: Sequence, min_value: float = -math.inf) -> bool:
    """Return whether all values are finite numbers of metres that float32 holds, and none is below `min_value`."""
    largest = float(np.finfo(np.float32).max)
    return all(_is_number(value) and max(min_value, -largest) <= value <= largest for value in values)
