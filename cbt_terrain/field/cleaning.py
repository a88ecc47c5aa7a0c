# SPDX-License-Identifier: GPL-3.0-or-later
"""Preparation of a raster's samples: heights in float32, and missing samples filled."""

import numpy as np
import warp as wp

from ...kernels.field import fill as fill_kernels
from ..errors import TerrainError
from ..run import launch
from ..run.buffers import flat

COLUMN_BLOCK = 64
# Differences of larger heights overflow float32; an undeclared no-data value is the usual cause.
LARGEST_HEIGHT = 1e30


def clean_rows(rows: np.ndarray, name: str = "The raster") -> tuple[np.ndarray, int]:
    """Return rows as float32 with NaN for missing samples and no negative zeros, and the number of missing samples."""
    with np.errstate(over="ignore"):
        rows = rows.astype(np.float32) + np.float32(0.0)
    missing = ~np.isfinite(rows)
    count = int(np.count_nonzero(missing))
    if count:
        rows[missing] = np.nan
    if count < rows.size and np.nanmax(np.abs(rows)) > LARGEST_HEIGHT:
        height = float(rows.flat[np.nanargmax(np.abs(rows))])
        raise TerrainError(
            f"{name} holds a height of {height:.8g} m",
            expected="at most 1e30 m above or below 0",
            fix="if it marks missing data, give it as the no-data value",
        )
    return rows, count


def fill_missing(samples: np.ndarray, threads: int) -> None:
    """Replace every NaN in `samples` (float32, in place) by the nearest valid sample, counted in samples."""
    height, width = samples.shape
    nearest = wp.empty(height * width, dtype=wp.int32, device=launch.DEVICE)
    h = flat(samples, wp.float32)
    inputs = [h, width, height, COLUMN_BLOCK, nearest]
    cost = 0.5 * COLUMN_BLOCK * height
    blocks = -(-width // COLUMN_BLOCK)
    launch.spread(fill_kernels.nearest_in_columns, blocks, inputs, step="fill no-data", threads=threads, cost=cost)
    jobs = []
    for first, end in launch.ranges(height, threads):
        apex = wp.empty(width, dtype=wp.int32, device=launch.DEVICE)
        start = wp.empty(width, dtype=wp.float64, device=launch.DEVICE)
        jobs.append([h, width, first, end, nearest, apex, start])
    launch.slices(fill_kernels.fill_rows, jobs, step="fill no-data")


def repeat_single_line(samples: np.ndarray) -> np.ndarray:
    """Repeat the samples of a raster that is one sample wide or high, because one row is a legitimate profile.

    Raises TerrainError for an empty raster.
    """
    height, width = samples.shape
    if height == 0 or width == 0:
        raise TerrainError(f"The raster has {width} x {height} samples", expected="at least one")
    return np.repeat(np.repeat(samples, 2 if height == 1 else 1, axis=0), 2 if width == 1 else 1, axis=1)
