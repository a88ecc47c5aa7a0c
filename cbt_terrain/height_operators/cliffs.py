# SPDX-License-Identifier: GPL-3.0-or-later
"""Limits of the start heights of a finer level at cliffs.

Where rock has slid off a cliff, the coarser level's change is strongly negative at the top and positive at the foot.
Interpolated between them, it would leave a spike on the ground of the top and a trench in that of the foot. These would
slide again, and every tile would find another path along the trench.
"""

import numpy as np


def limit_at_cliffs(
    heights: np.ndarray, before: np.ndarray, after: np.ndarray, first: tuple[int, int], drop: float
) -> np.ndarray:
    """Return `heights`, at most `drop` metres above or below all surrounding samples of the coarser level.

    A sample that was above or below these before the operator may stay so by as much. All float32 [rows, columns] m.
    heights: start of the finer level. before, after: heights at its samples without and with the coarser change; of
    `after` only the coarser level's samples are read. first: row and column of sample [0, 0] in the whole level.
    """
    for sign in (np.float32(1.0), np.float32(-1.0)):
        limit = _max_around(sign * after, first) + np.float32(drop)
        excess = sign * before - _max_around(sign * before, first)
        limit += np.maximum(excess, np.float32(0.0), out=excess)
        heights = sign * np.minimum(sign * heights, limit, out=limit)
    return heights


def _max_around(samples: np.ndarray, first: tuple[int, int]) -> np.ndarray:
    """Return for each sample the maximum of the coarser level's samples around it; these samples keep their values.

    samples: of this level, of which every second one is of the coarser level. first: row and column of the first
    sample in the whole level.
    """
    for axis, number in enumerate(first):
        odd, count = number % 2, samples.shape[axis]  # odd: 1 if the first sample is between two coarser ones
        coarser = np.moveaxis(samples, axis, 0)[odd::2]
        padded = np.pad(coarser, [(odd, 1), (0, 0)], mode="edge")
        maxima = np.empty((2 * len(padded) - 2, coarser.shape[1]), np.float32)
        maxima[::2] = padded[:-1]
        np.maximum(padded[:-1], padded[1:], out=maxima[1::2])
        samples = np.moveaxis(maxima[odd : odd + count], 0, axis)
    return samples
