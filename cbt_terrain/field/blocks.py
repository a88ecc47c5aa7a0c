# SPDX-License-Identifier: GPL-3.0-or-later
"""Pyramids of blocks: the most, or the least, of 2 x 2 values, of 2 x 2 of those, and so on to one of all."""

import numpy as np


def over_cells(samples: np.ndarray, side: int, reduce: np.ufunc, around: int = 0) -> np.ndarray:
    """`reduce` (np.maximum, np.minimum) of the samples [rows, columns] of every `side` x `side` cells, those on their
    border and `around` more on each side; a last block that is cut off has what there is."""
    for axis in (0, 1):
        last = samples.shape[axis] - 1
        first = np.arange(0, last, side)
        found = np.take(samples, first, axis)
        for k in range(-around, side + 1 + around):
            reduce(found, np.take(samples, np.clip(first + k, 0, last), axis), out=found)
        samples = found
    return samples


def halvings(finest: np.ndarray, reduce: np.ufunc) -> list[np.ndarray]:
    """`finest`, [rows, columns, ...], and level after level `reduce` (np.maximum, np.minimum) of each 2 x 2; a last odd
    row or column stands alone."""
    levels = [finest]
    while levels[-1].shape[:2] != (1, 1):
        level = levels[-1]
        for axis in (0, 1):
            level = level.swapaxes(0, axis)
            half, odd = level[::2].copy(order="K"), level[1::2]
            reduce(half[: len(odd)], odd, out=half[: len(odd)])
            level = half.swapaxes(0, axis)
        levels.append(level)
    return levels


def stacked(levels: list[np.ndarray], below: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The levels one after the other, flat, as rays skip by them; the first block of each level and how many are in its
    rows, int32 [below + levels]: `below` more levels before these have no blocks."""
    first = np.cumsum([0] * (below + 1) + [level.shape[0] * level.shape[1] for level in levels[:-1]], dtype=np.int32)
    wide = np.array([0] * below + [level.shape[1] for level in levels], np.int32)
    return np.concatenate([level.ravel() for level in levels]), first, wide
