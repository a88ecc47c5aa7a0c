# SPDX-License-Identifier: GPL-3.0-or-later
"""Seams of a mosaic: how far the heights of two overlapping files are apart where one of them ends.

They are compared as the files have them, before finer files blend to the ones below. A Composite has the files (tiles)
of a mosaic in the order of their priority; a file's number in it is its rank.
"""

from typing import NamedTuple

import numpy as np

from .composite import Composite
from .insets import INSIDE, overlapping_pairs
from .systems import projected

MAX_PAIRS = 400  # of files that are compared; of more, some are chosen evenly
MAX_SAMPLES = 512  # of one side of a file
MAX_INNER = 65  # along each side of a whole file


class StepReport(NamedTuple):
    """Steps between the heights of two files of a mosaic, where one of them ends.

    Attributes:
        pairs: pairs of files with a seam or an edge.
        compared: pairs whose heights were compared.
        steps: float64 [n], metres, heights of the last file of a pair less those of the first.
        places: float64 [n, 2], x and y of these steps in the grid's system.
        numbers: int [n], index in `names` of the pair that each step is of.
        names: paths of the two files of each pair with a step.
    """

    pairs: int
    compared: int
    steps: np.ndarray
    places: np.ndarray
    numbers: np.ndarray
    names: list[tuple[str, str]]


def find_seams(composite: Composite) -> StepReport:
    """Compare the heights of overlapping files where the upper one, of higher priority, ends: at its border's samples.

    If none of these are known in both files, samples of the whole overlap are compared. The upper file is the last of
    its pair.
    """
    pairs = overlapping_pairs(composite.boxes)
    chosen = [pairs[len(pairs) * n // MAX_PAIRS] for n in range(MAX_PAIRS)] if len(pairs) > MAX_PAIRS else pairs
    # of all steps: metres, x and y, and the number of the pair in `names`
    steps, places, numbers = [], [], []
    names: list[tuple[str, str]] = []
    for lower, upper in chosen:
        composite.on_piece()
        pair_steps, pair_places = _seam_of(composite, lower, upper)
        if len(pair_steps):
            steps.append(pair_steps)
            places.append(pair_places)
            numbers.append(np.full(len(pair_steps), len(names), np.int32))
            names.append((composite.tiles[lower].path, composite.tiles[upper].path))
    return StepReport(
        pairs=len(pairs),
        compared=len(chosen),
        steps=np.concatenate([np.zeros(0), *steps]),
        places=np.concatenate([np.zeros((0, 2)), *places]),
        numbers=np.concatenate([np.zeros(0, np.int32), *numbers]),
        names=names,
    )


def _seam_of(composite: Composite, lower: int, upper: int) -> tuple[np.ndarray, np.ndarray]:
    """Return steps (upper minus lower value, in metres) and positions at samples of the upper tile's border.

    They are those inside the lower tile. Without a known step there, samples of the whole upper tile are compared.
    lower, upper: ranks of both tiles. Results are float64 [n] and [n, 2], x and y in the grid's system.
    """
    tile, scale = composite.tiles[upper], abs(composite.scale)  # a negative scale would turn upper minus lower around
    right, bottom = tile.width - 1, tile.height - 1
    along, down = _spread(right), _spread(bottom)  # some columns and rows, from the first to the last
    sides = [(along, np.array([0])), (along, np.array([bottom])), (np.array([0]), down), (np.array([right]), down)]
    parts = [_compare(composite, lower, upper, *side) for side in sides]
    if not any(len(part[0]) for part in parts):
        columns, rows = (_spread(last, max_count=MAX_INNER) for last in (right, bottom))
        parts = [_compare(composite, lower, upper, columns, rows)]
    steps, columns, rows = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    x, y = projected(tile.crs, composite.grid.crs, *tile.position(columns, rows))
    return steps * scale, np.stack([x, y], axis=1)


def _spread(last: int, max_count: int = MAX_SAMPLES) -> np.ndarray:
    """Return whole numbers from 0 to `last`, all or `max_count` of them."""
    return np.unique(np.linspace(0, last, min(last + 1, max_count)).astype(np.int64))


def _compare(
    composite: Composite, lower: int, upper: int, columns: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return differences of values, upper minus lower, and columns and rows of the upper tile, where both have heights.

    Values are those of the composite, before its scale. lower, upper: ranks of both tiles. columns, rows: of the upper
    tile; every column is combined with every row.
    """
    below, above = composite.tiles[lower], composite.tiles[upper]
    columns, rows = (values.ravel() for values in np.meshgrid(columns, rows))
    # the same positions as columns u and rows v of the lower tile
    u, v = below.indices(*projected(above.crs, below.crs, *above.position(columns, rows)))
    inside = (u >= -INSIDE) & (u <= below.width - 1 + INSIDE) & (v >= -INSIDE) & (v <= below.height - 1 + INSIDE)
    columns, rows, u, v = columns[inside], rows[inside], u[inside], v[inside]
    if not len(u):
        return np.zeros(0), columns, rows
    # Read the window of the upper tile that holds these samples, and interpolate in the lower one.
    left, top = columns.min(), rows.min()
    window = composite.tile_window(upper, int(top), int(np.ptp(rows)) + 1, int(left), int(np.ptp(columns)) + 1)
    steps = window[rows - top, columns - left] - _bilinear(composite, lower, u, v)
    known = np.isfinite(steps)
    return steps[known], columns[known], rows[known]


def _bilinear(composite: Composite, rank: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return values of a tile at fractional columns u and rows v, [n]; NaN where a needed sample is missing.

    rank: number of the tile in the order of priority.
    """
    tile = composite.tiles[rank]
    u, v = np.clip(u, 0.0, tile.width - 1.0), np.clip(v, 0.0, tile.height - 1.0)
    # A position that rounding has moved off a sample is that sample's, so that no other one is needed.
    u, v = (np.where(np.abs(w - np.round(w)) < INSIDE, np.round(w), w) for w in (u, v))
    # the cell of each position, and the place in it, 0 .. 1
    i, j = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    s, t = u - i, v - j
    left, top = int(i.min()), int(j.min())
    rows, columns = int(min(j.max() + 2, tile.height)) - top, int(min(i.max() + 2, tile.width)) - left
    z = composite.tile_window(rank, top, rows, left, columns)
    i, j = i - left, j - top
    # The next column or row, but the same one where the next has no weight, since its sample may be missing.
    right, down = np.minimum(i + (s > 0), columns - 1), np.minimum(j + (t > 0), rows - 1)
    return (z[j, i] * (1 - s) + z[j, right] * s) * (1 - t) + (z[down, i] * (1 - s) + z[down, right] * s) * t
