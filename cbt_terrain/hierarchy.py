# SPDX-License-Identifier: GPL-3.0-or-later
"""The error hierarchy and the ranges of heights of a raster, one entry for each diamond of its lattice.

The reference surface is bilinear between the samples. The error of a diamond is the largest vertical distance between
the surface and the planes of its two triangles over everything that they cover: at all samples, and along the diagonals
of cells on the triangles' borders, where the surface is a parabola (nowhere else has it an extremum against a plane).
It is then saturated, that is raised to the largest error of its children, so that a parent's error is never less: the
nested criterion of which the refinement lives.

In one cell of the raster the surface is a saddle with the twist T = |h00 + h11 - h10 - h01|: its centre's diamond has
the error T/4, and each two bisections divide it by four. A side's diamond reaches into the next cell, so twists are
saturated too: T is at least a quarter of that of the four neighbours, hence T(a) = max over b of T(b) 4^-|a - b|, with
the distance in steps from neighbour to neighbour.

Saturated errors after Lindstrom and Pascucci (2002), "Terrain simplification simplified", sections 3 and 4.
"""

from collections.abc import Callable

import numpy as np
import warp as wp

from ..kernels import expand as expand_kernels
from ..kernels import hierarchy as kernels
from ..kernels import ranges as range_kernels
from . import launch
from .lattice import Lattice

COLUMN_BLOCK = 64

Progress = Callable[[float], None]


def _ignore(_fraction: float) -> None:
    pass


def _shared(array: np.ndarray, dtype) -> wp.array:
    """The array's memory as Warp sees it, flat."""
    return wp.array(array.reshape(-1), dtype=dtype, device=launch.DEVICE, copy=False)


def _levels(lattice: Lattice, values: np.ndarray, dtype, deepest: int) -> list:
    """Warp views of depths 1 .. deepest of `values` (entry 0 unused)."""
    offsets = lattice.offsets()
    return [None] + [_shared(values[offsets[d] : offsets[d + 1]], dtype) for d in range(1, deepest + 1)]


def build_errors(
    samples: np.ndarray, lattice: Lattice, errors: np.ndarray, threads: int, on_progress: Progress = _ignore
) -> None:
    """Fill `errors` (float32 [lattice.node_count], metres) for `samples` (float32 [height, width], metres)."""
    h = _shared(samples, wp.float32)
    width = lattice.width
    level = _levels(lattice, errors, wp.float32, lattice.cell_depth)

    def spread(kernel, count: int, inputs: list, cost: float) -> None:
        launch.spread(kernel, count, inputs, step="error hierarchy", threads=threads, cost=cost)

    cells_x, cells_y = lattice.width - 1, lattice.height - 1
    cells = level[lattice.cell_depth]
    spread(kernels.twists, cells_y, [h, width, cells], 0.5 * cells_x)
    blocks = -(-cells_x // COLUMN_BLOCK)
    spread(kernels.saturate_columns, blocks, [cells_x, cells_y, COLUMN_BLOCK, cells], 0.2 * COLUMN_BLOCK * cells_y)
    for j in reversed(range(lattice.levels)):
        half = 1 << (lattice.levels - j - 1)
        columns, rows = lattice.columns << (j + 1), lattice.rows << (j + 1)
        count = level[2 * j + 2].size
        cost = 1.0 + 0.2 * half * half
        spread(
            kernels.side_errors, count, [h, width, columns, rows, half, level[2 * j + 3], level[2 * j + 2]], 2 * cost
        )
        columns, rows = columns // 2, rows // 2
        inputs = [h, width, columns, 2 * half, int(j == 0), level[2 * j + 2], level[2 * j + 1]]
        spread(kernels.centre_errors, columns * rows, inputs, 4 * cost)
        on_progress(1.0 - j / lattice.levels)


def expand_errors(lattice: Lattice, errors: np.ndarray, meshlet: int, threads: int) -> None:
    """Turn `errors` in place into those of leaves that are drawn `2 * meshlet` bisections finer than they are.

    Each pass gives a diamond the largest error of its children, which keeps parents above children.
    """
    level = _levels(lattice, errors, wp.float32, lattice.cell_depth)
    cells = level[lattice.cell_depth]
    columns, rows = lattice.width - 1, lattice.height - 1
    for step in range(2 * meshlet):
        for depth in range(1, lattice.cell_depth):
            across = lattice.columns << ((depth - 1) // 2)
            if depth % 2:
                kernel, inputs = expand_kernels.raise_centres, [across]
            else:
                kernel, inputs = expand_kernels.raise_sides, [2 * across, lattice.rows << (depth // 2)]
            inputs += [level[depth + 1], level[depth]]
            launch.spread(kernel, level[depth].size, inputs, step="meshlet errors", threads=threads)
        # A cell's diamond and the side diamonds one bisection below it have the same error, so cells move in every
        # other pass, by two bisections at once.
        if step % 2 == 0:
            old = wp.clone(cells)
            launch.spread(
                expand_kernels.raise_cells,
                cells.size,
                [columns, rows, old, cells],
                step="meshlet errors",
                threads=threads,
            )


def range_scale(low: float, high: float) -> tuple[float, float]:
    """Base and step (metres) such that base + q * step covers `low` .. `high` for q in 0 .. 65535."""
    step = (high - low) / 65535.0
    while low + 65535.0 * step < high:
        step = np.nextafter(step, np.inf)
    return float(low), float(step) if step > 0.0 else 1.0


def build_ranges(
    samples: np.ndarray, lattice: Lattice, base: float, step: float, ranges: np.ndarray, threads: int
) -> None:
    """Fill `ranges` (uint16 [diamonds above the raster's cells, 2]): base + q * step encloses the surface."""
    if lattice.levels == 0:
        return
    level = _levels(lattice, ranges, wp.uint16, lattice.cell_depth - 1)

    def spread(kernel, count: int, inputs: list, cost: float = 1.0) -> None:
        launch.spread(kernel, count, inputs, step="height ranges", threads=threads, cost=cost)

    finest = level[-1]
    inputs = [_shared(samples, wp.float32), lattice.width, lattice.height, wp.float64(base), wp.float64(step), finest]
    spread(range_kernels.finest_ranges, lattice.height, inputs, 3.0 * lattice.width)
    for depth in range(lattice.cell_depth - 2, 0, -1):
        across = lattice.columns << ((depth - 1) // 2)
        if depth % 2:
            kernel, inputs = range_kernels.centre_ranges, [across]
        else:
            kernel, inputs = range_kernels.side_ranges, [2 * across, lattice.rows << (depth // 2)]
        spread(kernel, level[depth].size // 2, [*inputs, level[depth + 1], level[depth]])
