# SPDX-License-Identifier: GPL-3.0-or-later
"""The built-in island: a terrain at any resolution that needs no file."""

import numpy as np

from ..run import launch
from ..run.buffers import flat

SIDE = 8192.0  # metres of the island's square
DEFAULT_SIZE = 4097
DEFAULT_SEED = 7


def island(size: int, seed: int = DEFAULT_SEED) -> np.ndarray:
    """Return heights of the island over a square of SIDE metres, float32 [size, size] metres, row 0 south."""
    from ...kernels import wp
    from ...kernels.field.island import raise_island

    samples = np.empty((size, size), np.float32)
    first_row = 0
    inputs = [size, first_row, wp.uint32(seed & 0xFFFFFFFF), flat(samples, wp.float32)]
    launch.spread(raise_island, size, inputs, step="island", threads=None, cost=30.0 * size)
    return samples
