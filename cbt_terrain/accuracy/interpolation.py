# SPDX-License-Identifier: GPL-3.0-or-later
"""What the choice of interpolation adds: the bilinear reference against a smooth surface through the same samples."""

import numpy as np

from ..field.heightfield import HeightField
from .mesh import Errors, errors_of

ROWS = 256


def interpolation(field: HeightField, vertical_scale: float = 1.0) -> Errors:
    """|bilinear - bicubic| in metres at the centres of the raster's cells and at the middles of their sides.

    The bicubic surface is the C1 cubic convolution with a = -1/2 (Keys 1981), known as Catmull-Rom: in the middle
    between two samples it weighs four by (-1, 9, 9, -1) / 16. Beyond the border heights go on straight.
    """
    distances = []
    height = field.samples.shape[0]
    for row in range(0, height, ROWS):
        # the block's own rows, one before and two behind
        picked = np.arange(row - 1, min(row + ROWS, height) + 2)
        inside = np.clip(picked, 0, height - 1)
        h = np.asarray(field.heights(inside), np.float64)
        if picked[0] < 0:
            h[0] = 2 * h[1] - h[2]
        beyond = height + 1 - row
        if beyond < len(h):
            h[beyond] = 2 * h[beyond - 1] - h[beyond - 2]
        linear, cubic = _middles(h)
        distances.append(linear[1:-2] - cubic[1:-2])  # sides along the rows
        if picked[-1] > height:
            h, linear, cubic = h[:-1], linear[:-1], cubic[:-1]
        distances.append(_across(h, "linear") - _across(h, "cubic"))
        distances.append(_across(linear, "linear") - _across(cubic, "cubic"))
    values = np.concatenate([d.astype(np.float32).reshape(-1) for d in distances])
    return errors_of(values * np.float32(abs(vertical_scale)))


def _middles(h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights in the middle of the cells of each row: linear and cubic."""
    before, behind = 2 * h[:, :1] - h[:, 1:2], 2 * h[:, -1:] - h[:, -2:-1]
    wide = np.concatenate([before, h, behind], axis=1)
    linear = (h[:, 1:] + h[:, :-1]) / 2
    return linear, (9 * (h[:, 1:] + h[:, :-1]) - wide[:, 3:] - wide[:, :-3]) / 16


def _across(h: np.ndarray, kind: str) -> np.ndarray:
    """Heights in the middle between rows, of rows that have one before and one behind."""
    linear = h[1:-2] + h[2:-1]
    return linear / 2 if kind == "linear" else (9 * linear - h[:-3] - h[3:]) / 16
