# SPDX-License-Identifier: GPL-3.0-or-later
"""Beside cliffs a finer level starts from no heights that the coarser one does not know.

Where rock has slid off a cliff, the coarser level's change is far down above it and far up at its foot. Between two
such samples it is the mean of both: of the ground there, that of the top would stand as a spike, and that of the foot
lie in a trench. All of that would slide once more, and every tile would find another way along the trench.
"""

import numpy as np


def beside_cliffs(
    heights: np.ndarray, before: np.ndarray, after: np.ndarray, first: tuple[int, int], drop: float
) -> np.ndarray:
    """`heights`, but by no more than `drop` metres above or below all coarser samples around; by more only where the
    ground stood out of them before, and by as much.

    All float32 [rows, columns] m. before: the effect. after: it; only the coarser level's samples count. first: row and
    column of sample [0, 0] in the whole level.
    """
    every = tuple(slice(number % 2, None, 2) for number in first)
    for sign in (np.float32(1.0), np.float32(-1.0)):
        stood_out = np.maximum(sign * before - _most_around(sign * before, every), np.float32(0.0))
        most = _most_around(sign * after, every) + (np.float32(drop) + stood_out)
        heights = sign * np.minimum(sign * heights, most)
    return heights


def _most_around(samples: np.ndarray, every: tuple[slice, slice]) -> np.ndarray:
    """The most of the coarser samples that each sample is, or lies between."""
    most = np.full_like(samples, -np.inf)
    most[every] = samples[every]
    for axis in (0, 1):
        padding = [(int(axis == other),) * 2 for other in (0, 1)]
        along = np.moveaxis(np.pad(most, padding, constant_values=-np.inf), axis, 0)
        most = np.moveaxis(np.maximum(np.maximum(along[:-2], along[2:]), along[1:-1]), 0, axis)
    return most
