# SPDX-License-Identifier: GPL-3.0-or-later
"""Pyramids of blocks: the maximum or minimum of 2 x 2 values, of 2 x 2 of those, and so on to a single one."""

import numpy as np


def over_cells(samples: np.ndarray, side: int, reduce: np.ufunc, around: int = 0) -> np.ndarray:
    """Apply `reduce` (np.maximum, np.minimum) to the samples [rows, columns] of every `side` x `side` cells.

    A block includes its border samples and `around` more on each side. A last block is cut off at the raster's end.
    """
    for axis in (0, 1):
        last = samples.shape[axis] - 1
        first = np.arange(0, last, side)
        found = np.take(samples, first, axis)
        for k in range(-around, side + 1 + around):
            reduce(found, np.take(samples, np.clip(first + k, 0, last), axis), out=found)
        samples = found
    return samples


def halvings(finest: np.ndarray, reduce: np.ufunc) -> list[np.ndarray]:
    """Return `finest`, [rows, columns, ...], and the levels above it, each `reduce` (np.maximum, np.minimum) of 2 x 2.

    A last odd row or column is copied.
    """
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


def concatenate_levels(levels: list[np.ndarray], below: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the levels of a pyramid in one flat array, with the offset and the width of each level.

    These are int32 [below + levels]; the first `below` entries are for levels without blocks. Rays skip empty space
    with them.
    """
    first = np.cumsum([0] * (below + 1) + [level.shape[0] * level.shape[1] for level in levels[:-1]], dtype=np.int32)
    wide = np.array([0] * below + [level.shape[1] for level in levels], np.int32)
    return np.concatenate([level.ravel() for level in levels]), first, wide
