# SPDX-License-Identifier: GPL-3.0-or-later
"""The effect of the interpolation: the bilinear reference against a smooth surface through the same samples."""

import numpy as np

from ..field.heightfield import HeightField
from .mesh import Errors, errors_of

ROWS = 256


def interpolation(field: HeightField) -> Errors:
    """Return |bilinear - bicubic| in metres at the centres of the raster's cells and at the middles of their sides.

    The bicubic surface is the C1 cubic convolution with a = -1/2 (Keys 1981), known as Catmull-Rom: in the middle
    between two samples it weighs four by (-1, 9, 9, -1) / 16. Beyond the border heights go on straight. Only the
    samples of `field` count, not its own interpolation or detail.
    """
    distances, (height, width) = [], field.samples.shape
    for first_row in range(0, height, ROWS):
        # The rows of the block, one before it and two after it. Beyond the border, twice the nearest sample less the
        # one mirrored at it goes on straight; inside, both are the sample itself.
        nearest, mirrored = _with_mirrored(first_row - 1, min(first_row + ROWS + 2, height + 1), height)
        h = 2 * field.heights(nearest).astype(np.float64) - field.heights(mirrored)
        # The same with a column more on both sides, columns first.
        nearest, mirrored = _with_mirrored(-1, width + 1, width)
        columns = (2 * h[:, nearest] - h[:, mirrored]).T
        linear, cubic = _linear(columns).T, _cubic(columns).T  # in the middle between two columns of each row
        count = min(ROWS, height - first_row)
        # The middles of sides along rows, those of sides along columns, and the centres of cells. [1:] leaves out the
        # row before the block; `_linear` and `_cubic` leave it out themselves.
        distances += [linear[1:][:count] - cubic[1:][:count], _linear(h) - _cubic(h), _linear(linear) - _cubic(cubic)]
    return errors_of(np.concatenate([d.astype(np.float32).reshape(-1) for d in distances]))


def _with_mirrored(first: int, end: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return for numbers `first` .. `end` - 1 the nearest of `count` samples, and the sample mirrored at that one.

    Twice the height of the nearest minus that of the mirrored one continues the heights straight beyond the border;
    inside, both are the sample itself.
    """
    numbers = np.arange(first, end)
    nearest = np.clip(numbers, 0, count - 1)
    return nearest, 2 * nearest - numbers


def _linear(h: np.ndarray) -> np.ndarray:
    """Return heights in the middle between rows, linear, without the middles next to the first and the last row."""
    return (h[1:-2] + h[2:-1]) / 2


def _cubic(h: np.ndarray) -> np.ndarray:
    """Return heights in the middle between rows, cubic, without the middles next to the first and the last row."""
    return (9 * (h[1:-2] + h[2:-1]) - h[:-3] - h[3:]) / 16
