# SPDX-License-Identifier: GPL-3.0-or-later
"""Continued slopes: filled samples next to ground go on like it, so normals beside a hole are those of the ground."""

from collections.abc import Callable

import numpy as np

ROWS = 128  # that are continued together
# Steps (along y and x) from a missing sample to ground, in order of preference.
AXES, DIAGONALS = ((0, -1), (0, 1), (-1, 0), (1, 0)), ((-1, -1), (-1, 1), (1, -1), (1, 1))


def continue_slopes(
    opened: Callable[[], np.ndarray],
    missing_in: Callable[[slice], np.ndarray],
    shape: tuple[int, ...],
    rings: int = 1,
) -> None:
    """Continue the slopes of ground into the filled samples next to it, in place; a plane stays a plane.

    A sample k steps from the nearest ground in a row, a column or a diagonal gets h(k) + k (h(k) - h(k + 1)), the mean
    of several such directions; one without two known samples in any of them keeps its fill. Numbers are rounded, and
    clipped to their type.

    Args:
        opened: maps the samples, float32 or uint16, for writing; called for each block of rows with missing ones.
        missing_in: returns, for rows, which samples are missing, bool.
        shape: rows and columns of the raster.
        rings: largest distance from ground in samples, in rows and in columns, of those that are changed.
    """
    height, margin = shape[0], rings + 1
    for first in range(0, height, ROWS):
        rows = slice(first, min(first + ROWS, height))
        missing = missing_in(rows)
        if not missing.any():
            continue
        around = slice(max(first - margin, 0), min(rows.stop + margin, height))
        outside = margin - (first - around.start), margin - (around.stop - rows.stop)  # rows beyond the raster
        known = np.pad(~missing_in(around), (outside, (margin, margin)))
        y, x = np.nonzero(missing & _near(known, rings)[margin:-margin, margin:-margin])
        samples = opened()
        sums, counts = np.zeros(len(y)), np.zeros(len(y), np.int32)
        for k, steps in ((k, steps) for k in range(1, margin) for steps in (AXES, DIAGONALS)):
            is_open = counts == 0  # no nearer or better direction has ground
            for dy, dx in steps:
                pairs = [(y + distance * dy, x + distance * dx) for distance in (k, k + 1)]
                found = is_open & np.logical_and(*(known[v + margin, u + margin] for v, u in pairs))
                near, far = (samples[first + v[found], u[found]].astype(np.float64) for v, u in pairs)
                sums[found] += near + k * (near - far)
                counts[found] += 1
        found = counts > 0
        values = sums[found] / counts[found]
        if samples.dtype.kind == "u":
            values = np.clip(np.rint(values), 0, np.iinfo(samples.dtype).max)
        samples[first + y[found], x[found]] = values


def _near(known: np.ndarray, distance: int) -> np.ndarray:
    """Return where a known sample is at most `distance` rows and columns away, bool like `known`."""
    for axis in (0, 1):
        padded = np.pad(known, [(distance, distance) if axis == a else (0, 0) for a in (0, 1)])
        count = known.shape[axis]
        shifts = [np.take(padded, range(shift, shift + count), axis) for shift in range(2 * distance + 1)]
        known = np.logical_or.reduce(shifts)
    return known
