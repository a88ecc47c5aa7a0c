# SPDX-License-Identifier: GPL-3.0-or-later
"""Pyramids of blocks: the maximum or minimum of 2 x 2 values, of 2 x 2 of those, and so on to a single one."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np

ROWS = 256  # rows of blocks that are computed together; even


def over_cells(samples: np.ndarray, side: int, reduce: np.ufunc, around: int = 0) -> np.ndarray:
    """Return the maximum or minimum of the samples of every `side` x `side` cells, an entry for each block of cells.

    samples: [rows, columns], at least 2 x 2. reduce: np.maximum or np.minimum. A block includes its border samples and
    `around` more on each side. A last block is cut off at the raster's end.
    """
    for axis in (0, 1):
        last = samples.shape[axis] - 1
        first = np.arange(0, last, side)
        reduced = np.take(samples, first, axis)
        for k in range(-around, side + 1 + around):
            reduce(reduced, np.take(samples, np.clip(first + k, 0, last), axis), out=reduced)
        samples = reduced
    return samples


def level_shapes(rows: int, columns: int) -> list[tuple[int, int]]:
    """Return rows and columns of all levels of a pyramid, whose finest one has `rows` and `columns` blocks."""
    shapes = [(rows, columns)]
    while shapes[-1] != (1, 1):
        shapes.append(((shapes[-1][0] + 1) // 2, (shapes[-1][1] + 1) // 2))
    return shapes


def halve(level: np.ndarray, reduce: np.ufunc) -> np.ndarray:
    """Return the maximum or minimum of each 2 x 2 blocks of a level, [rows, columns, ...].

    reduce: np.maximum or np.minimum. A last odd row or column is copied.
    """
    for axis in (0, 1):
        level = level.swapaxes(0, axis)
        half, odd = level[::2].copy(order="K"), level[1::2]
        reduce(half[: len(odd)], odd, out=half[: len(odd)])
        level = half.swapaxes(0, axis)
    return level


def halvings(finest: np.ndarray, reduce: np.ufunc) -> list[np.ndarray]:
    """Return `finest`, [rows, columns, ...], and the levels above it, down to one value (1 x 1).

    Each level has the maximum or minimum of each 2 x 2 values of the one before. reduce: np.maximum or np.minimum.
    """
    levels = [finest]
    while levels[-1].shape[:2] != (1, 1):
        levels.append(halve(levels[-1], reduce))
    return levels


def fill_levels(
    levels: np.ndarray, rows: int, columns: int, reduce: np.ufunc, finest: Callable[[slice], np.ndarray]
) -> None:
    """Fill all levels of a pyramid, concatenated in one flat array, some rows at a time.

    rows, columns: blocks of the finest level. finest(some): returns these rows of it, at most ROWS, [rows, columns].
    reduce: np.maximum or np.minimum, which joins blocks to coarser ones.
    """
    shapes = level_shapes(rows, columns)
    ends = np.cumsum([rows * columns for rows, columns in shapes])
    views = [levels[end - a * b : end].reshape(a, b) for end, (a, b) in zip(ends, shapes, strict=True)]
    for row in range(0, rows, ROWS):
        views[0][row : row + ROWS] = finest(slice(row, min(row + ROWS, rows)))
    for below, above in pairwise(views):
        for row in range(0, len(below), ROWS):
            above[row // 2 : (row + ROWS) // 2] = halve(below[row : row + ROWS], reduce)


def concatenate_levels(levels: list[np.ndarray], below: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the levels of a pyramid in one flat array, from the finest on, and each level's first entry and width.

    The last two are arrays of `level_offsets`, with `below` entries for finer levels that are not stored.
    """
    return np.concatenate([level.ravel() for level in levels]), *level_offsets(
        [(len(level), level.shape[1]) for level in levels], below
    )


def level_offsets(shapes: list[tuple[int, int]], below: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the first entry and the width of each level of a flat pyramid, int64 and int32 [below + levels].

    Rays read them to skip empty space. shapes: rows and columns of the stored levels, the finest first. The first
    `below` entries, 0, are for finer levels without blocks.
    """
    first = np.cumsum([0] * (below + 1) + [rows * columns for rows, columns in shapes[:-1]], dtype=np.int64)
    return first, np.array([0] * below + [columns for _, columns in shapes], np.int32)
