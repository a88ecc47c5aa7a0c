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
    for sign in (np.float32(1.0), np.float32(-1.0)):
        most = _most_around(sign * after, first) + np.float32(drop)
        stood_out = sign * before - _most_around(sign * before, first)
        most += np.maximum(stood_out, np.float32(0.0), out=stood_out)
        heights = sign * np.minimum(sign * heights, most, out=most)
    return heights


def _most_around(samples: np.ndarray, first: tuple[int, int]) -> np.ndarray:
    """The most of the coarser samples that each sample is, or lies between."""
    for axis, number in enumerate(first):
        odd, count = number % 2, samples.shape[axis]
        coarser = np.moveaxis(samples, axis, 0)[odd::2]
        between = np.pad(coarser, [(odd, 1), (0, 0)], mode="edge")
        most = np.empty((2 * len(between) - 2, coarser.shape[1]), np.float32)
        most[::2] = between[:-1]
        np.maximum(between[:-1], between[1:], out=most[1::2])
        samples = np.moveaxis(most[odd : odd + count], 0, axis)
    return samples
