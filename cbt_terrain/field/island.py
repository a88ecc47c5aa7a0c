# SPDX-License-Identifier: GPL-3.0-or-later
"""The built-in island: a terrain at any resolution that needs no file."""

import numpy as np
import warp as wp

from ...kernels.field.island import raise_island
from ..run import launch
from ..run.buffers import flat

# Metres: the side of the island's square.
SIDE = 8192.0
DEFAULT_SIZE = 4097
DEFAULT_SEED = 7


def island_rows(
    size: int, first_row: int, rows: np.ndarray, seed: int = DEFAULT_SEED, threads: int | None = None
) -> None:
    """Fill `rows` (float32 [n, size], metres) with rows first_row .. first_row + n of the island, row 0 south.

    Heights depend only on the seed and on the place, so that resolutions agree where their samples coincide.
    """
    launch.spread(
        raise_island,
        rows.shape[0],
        [size, first_row, wp.uint32(seed & 0xFFFFFFFF), flat(rows, wp.float32)],
        step="island",
        threads=threads or launch.default_threads(),
        cost=30.0 * size,
    )


def island(size: int = DEFAULT_SIZE, seed: int = DEFAULT_SEED) -> np.ndarray:
    """float32 [size, size] heights in metres of the island over a square of SIDE metres, row 0 south."""
    samples = np.empty((size, size), np.float32)
    island_rows(size, 0, samples, seed)
    return samples
