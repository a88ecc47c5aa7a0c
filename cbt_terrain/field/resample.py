# SPDX-License-Identifier: GPL-3.0-or-later
"""What a raster goes through once, before its hierarchy: missing samples are filled, and it is put onto a lattice."""

import numpy as np
import warp as wp

from ...kernels.field import fill as fill_kernels
from ...kernels.field import resample as kernels
from ..errors import TerrainError
from ..run import launch
from .lattice import Lattice, fit

COLUMN_BLOCK = 64
CORRECTIONS = 8
# Samples (0.13 GB in the store) that a lattice may have to be made twice as fine as a raster that does not fit needs.
TWICE_AS_FINE_UP_TO = 1 << 23
# Distances between heights beyond this leave float32; an undeclared no-data value is the usual cause.
LARGEST_HEIGHT = 1e30


def _flat(array: np.ndarray, dtype) -> wp.array:
    return wp.array(array.reshape(-1), dtype=dtype, device=launch.DEVICE, copy=False)


def clean_rows(rows: np.ndarray, name: str = "The raster") -> tuple[np.ndarray, int]:
    """Rows as float32 with every missing sample NaN and zeros positive, and the count of missing samples."""
    with np.errstate(over="ignore"):
        rows = rows.astype(np.float32) + np.float32(0.0)
    missing = ~np.isfinite(rows)
    count = int(np.count_nonzero(missing))
    if count:
        rows[missing] = np.nan
    if count < rows.size and np.nanmax(np.abs(rows)) > LARGEST_HEIGHT:
        height = float(rows.flat[np.nanargmax(np.abs(rows))])
        raise TerrainError(
            f"{name} holds a height of {height:.8g} m, beyond +-1e30 m: if that stands for missing data, give it "
            "as the no-data value."
        )
    return rows, count


def fill_missing(samples: np.ndarray, threads: int) -> None:
    """Give every NaN in `samples` (float32, in place) the height of the nearest valid sample, counted in samples."""
    height, width = samples.shape
    nearest = wp.empty(height * width, dtype=wp.int32, device=launch.DEVICE)
    h = _flat(samples, wp.float32)
    inputs = [h, width, height, COLUMN_BLOCK, nearest]
    cost = 0.5 * COLUMN_BLOCK * height
    blocks = -(-width // COLUMN_BLOCK)
    launch.spread(fill_kernels.nearest_in_columns, blocks, inputs, step="fill no-data", threads=threads, cost=cost)
    cuts = [height * i // threads for i in range(threads + 1)]
    jobs = []
    for first, end in zip(cuts, cuts[1:], strict=False):
        apex = wp.empty(width, dtype=wp.int32, device=launch.DEVICE)
        start = wp.empty(width, dtype=wp.float64, device=launch.DEVICE)
        jobs.append([h, width, first, end, nearest, apex, start])
    launch.slices(fill_kernels.fill_rows, jobs, step="fill no-data")


def widen(samples: np.ndarray) -> np.ndarray:
    """A raster one sample wide or high becomes two wide or high, constant across: one row is a legitimate profile."""
    height, width = samples.shape
    if height == 0 or width == 0:
        raise TerrainError(f"The raster has {width} x {height} samples: a terrain needs at least one.")
    return np.repeat(np.repeat(samples, 2 if height == 1 else 1, axis=0), 2 if width == 1 else 1, axis=1)


def lattice_for(width: int, height: int, step_x: float, step_y: float, name: str = "The raster") -> Lattice:
    """The lattice over a raster of `width` x `height` samples that are `step_x`, `step_y` metres apart."""
    columns, rows, levels = fit(width, height)
    if ((columns << levels) + 1, (rows << levels) + 1) != (width, height):
        # From twice as fine on a lattice can pass through nearly all samples of the raster.
        if (columns << levels + 1) * (rows << levels + 1) <= TWICE_AS_FINE_UP_TO:
            levels += 1
    cells_x, cells_y = columns << levels, rows << levels
    lattice = Lattice(columns, rows, levels, step_x * (width - 1) / cells_x, step_y * (height - 1) / cells_y)
    if not lattice.can_be_numbered:
        raise TerrainError(
            f"{name} has {width} x {height} samples, more than an index of 31 bits can number (about 27,000 x "
            "27,000): cut it into tiles or reduce it first."
        )
    return lattice


def onto_lattice(raster: np.ndarray, samples: np.ndarray, threads: int) -> tuple[float, float]:
    """Bring `raster` into `samples` (both float32, over the same rectangle, `samples` at least as fine).

    Bilinear, then CORRECTIONS times each new sample takes its share of what its surface lacks at the raster's own
    samples, within the raster's heights around it. That leaves a quarter of bilinear's change where both are about
    equally fine, and next to nothing from twice as fine on (an algebraic reconstruction with a constraint; Andersen
    and Kak 1984). Returns the largest and the root mean square change in metres at the raster's own samples.
    """
    height, width = raster.shape
    new_height, new_width = samples.shape
    old, new = _flat(raster, wp.float32), _flat(samples, wp.float32)

    def rows(kernel, inputs: list, count: int, cost: float) -> None:
        launch.spread(kernel, count, inputs, step="resample", threads=threads, cost=cost)

    rows(kernels.resample, [old, width, height, new_width, new_height, new], new_height, 2.0 * new_width)
    misfit = wp.empty(raster.size, dtype=wp.float32, device=launch.DEVICE)
    for _ in range(CORRECTIONS):
        rows(kernels.misfits, [old, width, height, new, new_width, new_height, misfit], height, 2.0 * width)
        rows(kernels.correct, [old, misfit, width, height, new_width, new_height, new], new_height, 8.0 * new_width)
    largest, squares = np.empty(height), np.empty(height)
    measured = [_flat(largest, wp.float64), _flat(squares, wp.float64)]
    rows(kernels.measure_change, [old, width, height, new, new_width, new_height, *measured], height, 2.0 * width)
    return float(largest.max()), float(np.sqrt(squares.sum() / raster.size))
