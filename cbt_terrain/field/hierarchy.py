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

from ...kernels.field import expand as expand_kernels
from ...kernels.field import hierarchy as kernels
from ...kernels.field import ranges as range_kernels
from ...kernels.field import resample as resample_kernels
from ...kernels.field.layout import Depth
from ..run import launch
from .lattice import Lattice

COLUMN_BLOCK = 64

Progress = Callable[[float], None]


def _ignore(_fraction: float) -> None:
    pass


def flat(array: np.ndarray, dtype) -> wp.array:
    """The array's memory as Warp sees it, flat."""
    return wp.array(array.reshape(-1), dtype=dtype, device=launch.DEVICE, copy=False)


def stored_at(lattice: Lattice, depth: int) -> Depth:
    """Where the errors hold the diamonds of one depth (1 .. cell_depth)."""
    return _place(*lattice.layout(), lattice.cell_depth - depth)


def ranges_at(lattice: Lattice, depth: int) -> Depth:
    """Where the ranges do (1 .. range_depth, and cell_depth)."""
    finer = lattice.range_depth + 1 - depth if depth < lattice.cell_depth else 0
    return _place(*lattice.range_layout(), finer)


def _place(base: np.ndarray, pages: np.ndarray, finer: int) -> Depth:
    """Where images hold the diamonds `finer` bisections above the raster's cells."""
    group = (finer - 1) // 4 if finer else len(pages) - 1
    place = Depth()
    place.base, place.pages, place.first, place.step = int(base[group]), int(pages[group]), 0, 1
    if finer:
        # Vertices of the group from a corner to the middle of a side: one, or two in the coarser half of the group.
        half = 1 << (finer - 1) // 2 % 2
        place.first, place.step = (0, half) if finer % 2 else (half, 2 * half)
    return place


def extent_of(lattice: Lattice, depth: int) -> tuple[int, int, int]:
    """Columns and rows of the cells whose centres are at a depth or its children, and the items of a launch over it."""
    columns, rows = lattice.columns << depth // 2, lattice.rows << depth // 2
    return columns, rows, columns * rows if depth % 2 else (columns // 2 + 1) * (rows + 1)


def build_errors(
    samples: np.ndarray, lattice: Lattice, errors: np.ndarray, threads: int, on_progress: Progress = _ignore
) -> None:
    """Fill `errors` (float32 [lattice.node_count], zeroed, metres) for `samples` (float32 [height, width], metres)."""
    h, out = flat(samples, wp.float32), flat(errors, wp.float32)
    width = lattice.width

    def spread(kernel, count: int, inputs: list, cost: float) -> None:
        launch.spread(kernel, count, [*inputs, out], step="error hierarchy", threads=threads, cost=cost)

    cells_x, cells_y = lattice.width - 1, lattice.height - 1
    finer = stored_at(lattice, lattice.cell_depth)
    spread(kernels.twists, cells_y, [h, width, finer], 0.5 * cells_x)
    blocks = -(-cells_x // COLUMN_BLOCK)
    inputs = [cells_x, cells_y, COLUMN_BLOCK, wp.float32(0.25), finer]
    spread(kernels.saturate_columns, blocks, inputs, 0.2 * COLUMN_BLOCK * cells_y)
    for depth in range(lattice.cell_depth - 1, 0, -1):
        own = stored_at(lattice, depth)
        columns, rows, count = extent_of(lattice, depth)
        side = 1 << (lattice.levels - (depth - 1) // 2)
        cost = 1.0 + 0.05 * side * side
        if depth % 2:
            spread(kernels.centre_errors, count, [h, width, columns, side, int(depth == 1), finer, own], 4 * cost)
        else:
            spread(kernels.side_errors, count, [h, width, columns, rows, side // 2, finer, own], 2 * cost)
        finer = own
        on_progress(1.0 - (depth - 1) / (2 * lattice.levels))


def expand_errors(lattice: Lattice, errors: np.ndarray, meshlet: int, threads: int) -> None:
    """Turn `errors` in place into those of leaves that are drawn `2 * meshlet` bisections finer than they are.

    Each pass gives a diamond the largest error of its children, which keeps parents above children. `errors` may have
    bends behind them, as bicubic.py makes them.
    """
    bicubic = len(errors) > lattice.node_count
    out = flat(errors, wp.float32)
    cells, before = stored_at(lattice, lattice.cell_depth), stored_at(lattice, lattice.cell_depth)
    before.base = 0

    def spread(kernel, count: int, inputs: list) -> None:
        launch.spread(kernel, count, [*inputs, out], step="meshlet errors", threads=threads)

    for step in range(2 * meshlet):
        for depth in range(1, lattice.cell_depth):
            columns, rows, count = extent_of(lattice, depth)
            places = [stored_at(lattice, depth + 1), stored_at(lattice, depth)]
            if depth % 2:
                spread(expand_kernels.raise_centres, count, [columns, *places])
            else:
                spread(expand_kernels.raise_sides, count, [columns, rows, *places])
        # Of a bilinear surface a cell's diamond and the side diamonds one bisection below it have the same error, so
        # cells move in every other pass, by two bisections at once. Bends halve with each.
        if step % 2 == 0:
            columns, rows, count = extent_of(lattice, lattice.cell_depth)
            first, part = (lattice.node_count, 0.5) if bicubic else (lattice.cell_base, 0.25)
            old = wp.clone(out[first:])
            spread(expand_kernels.raise_cells, count, [columns, rows, before, old, cells, wp.float32(part)])
            if bicubic:
                errors[lattice.node_count :] = errors[lattice.cell_base : lattice.node_count]
        elif bicubic:
            errors[lattice.cell_base :] *= np.float32(0.5)


def build_moved(raster: np.ndarray, samples: np.ndarray, lattice: Lattice, moved: np.ndarray, threads: int) -> None:
    """Fill `moved` (float32 [lattice.node_count], zeroed): metres that resampling moved the raster below a diamond.

    raster, samples: before and after, float32, over the same rectangle. Of the raster's cells what each holds itself;
    above them saturated over what `moved_at` in kernels/refine/diamond.py finds below.
    """
    cells = stored_at(lattice, lattice.cell_depth)
    cells.base = 0
    held = np.zeros(lattice.node_count - lattice.cell_base, np.float32)
    inputs = [flat(raster, wp.float32), *raster.shape[::-1], flat(samples, wp.float32), *samples.shape[::-1]]
    inputs += [cells, flat(held, wp.float32)]
    cost = 2.0 * lattice.width
    launch.spread(
        resample_kernels.moved_in_cells, lattice.height - 1, inputs, step="resample", threads=threads, cost=cost
    )
    raise_moved(held, lattice, moved, threads)


def raise_moved(held: np.ndarray, lattice: Lattice, moved: np.ndarray, threads: int) -> None:
    """Fill `moved` with what the raster's cells hold themselves (float32, in the order of the last of the images)."""
    out = flat(moved, wp.float32)
    cells, own = stored_at(lattice, lattice.cell_depth), stored_at(lattice, lattice.cell_depth)
    cells.base = 0

    def spread(kernel, count: int, inputs: list) -> None:
        launch.spread(kernel, count, inputs, step="resample", threads=threads)

    columns, rows, count = extent_of(lattice, lattice.cell_depth)
    spread(expand_kernels.widen_cells, count, [columns, rows, cells, flat(held, wp.float32), own, out])
    for depth in range(lattice.cell_depth - 1, 0, -1):
        columns, rows, count = extent_of(lattice, depth)
        places = [stored_at(lattice, depth + 1), stored_at(lattice, depth), out]
        if depth % 2:
            spread(expand_kernels.raise_centres, count, [columns, *places])
        else:
            spread(expand_kernels.raise_sides, count, [columns, rows, *places])
    moved[lattice.cell_base :] = held


def range_scale(low: float, high: float) -> tuple[float, float]:
    """Base and step (metres) such that base + q * step covers `low` .. `high` for q in 0 .. 65535."""
    step = (high - low) / 65535.0
    while low + 65535.0 * step < high:
        step = np.nextafter(step, np.inf)
    return float(low), float(step) if step > 0.0 else 1.0


def climbs(samples: np.ndarray) -> tuple[float, float]:
    """Largest differences in metres, rounded up, between neighbours in a row and in a column of `samples`."""
    x = y = 0.0
    for first in range(0, samples.shape[0] - 1, 64):  # blocks stay in the cache
        rows = samples[first : first + 65]
        x = max(x, float(np.abs(np.diff(rows, axis=1)).max()))
        y = max(y, float(np.abs(np.diff(rows, axis=0)).max()))
    return x * (1 + 1e-6), y * (1 + 1e-6)


def build_ranges(
    samples: np.ndarray, lattice: Lattice, base: float, step: float, ranges: np.ndarray, threads: int
) -> None:
    """Fill `ranges` (uint16 [lattice.range_count, 2], zeroed): base + q * step encloses the surface.

    Those of the two finest depths, three quarters of all, are not stored: a walk takes what their parents have in
    common, which is nested, and costs one triangle in a thousand.
    """
    if lattice.range_depth == 0:
        return
    inputs = [flat(samples, wp.float32), lattice.width, lattice.height, wp.float64(base), wp.float64(step)]
    inputs += [ranges_at(lattice, lattice.range_depth), flat(ranges, wp.uint16)]
    rows, cost = (lattice.height + 1) // 2, 6.0 * lattice.width
    launch.spread(range_kernels.finest_ranges, rows, inputs, step="height ranges", threads=threads, cost=cost)
    unite_ranges(lattice, ranges, threads)


def unite_ranges(lattice: Lattice, ranges: np.ndarray, threads: int) -> None:
    """Fill the ranges of what is above the finest that are stored."""
    out, finer = flat(ranges, wp.uint16), ranges_at(lattice, lattice.range_depth)

    def spread(kernel, count: int, inputs: list) -> None:
        launch.spread(kernel, count, [*inputs, out], step="height ranges", threads=threads)

    for depth in range(lattice.range_depth - 1, 0, -1):
        own = ranges_at(lattice, depth)
        columns, rows, count = extent_of(lattice, depth)
        if depth % 2:
            spread(range_kernels.centre_ranges, count, [columns, finer, own])
        else:
            spread(range_kernels.side_ranges, count, [columns, rows, finer, own])
        finer = own
