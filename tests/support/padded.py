# SPDX-License-Identifier: GPL-3.0-or-later
"""A raster of any size, for tests of what does not fill its lattice."""

import numpy as np


def raster(width: int, height: int) -> np.ndarray:
    """Smooth and rough ground with spikes, some of them on the rim."""
    y, x = np.mgrid[:height, :width]
    random = np.random.default_rng(width)
    heights = 90.0 * np.sin(x / 17.0) * np.cos(y / 13.0) + 2.0 * random.standard_normal((height, width))
    heights[random.integers(height, size=9), random.integers(width, size=9)] += 40.0
    heights[-1, width // 3] = heights[height // 2, -1] = 120.0
    return heights.astype(np.float32)
