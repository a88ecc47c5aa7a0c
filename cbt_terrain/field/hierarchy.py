# SPDX-License-Identifier: GPL-3.0-or-later
"""The error hierarchy and the ranges of heights of a raster, one entry for each diamond of its lattice.

The reference surface is bilinear between the samples. The error of a diamond is the largest vertical distance between
the surface and the planes of its two triangles over their area. It is found at the samples, and along the diagonals of
cells on the triangles' borders, where the surface is a parabola (elsewhere it has no extremum relative to a plane). The
error is then saturated, that is raised to the largest error of its children, so that a parent's error is never smaller,
as the nested criterion of the refinement requires. If a raster does not fill its lattice, only the area inside its
border counts. Border lines are lines of samples, and above the cells they cut triangles at samples or along diagonals
of cells.

In one cell of the raster the surface is a saddle with the twist T = |h00 + h11 - h10 - h01|. The diamond at its centre
has the error T/4, and each two bisections divide it by four. A side's diamond covers a part of the next cell, so twists
are saturated too: T is at least a quarter of that of the four neighbours, hence T(a) = max over b of T(b) 4^-|a - b|,
with the distance in steps from neighbour to neighbour.

Saturated errors after Lindstrom and Pascucci (2002), "Terrain simplification simplified", sections 3 and 4.

A `Depth` is where the arrays hold the diamonds of one depth: the middles of `columns` x `rows` cells (`sides` 0) or of
the sides of such cells (`sides` 1). Diamond (x, y) is the vertex (first + x step, first + y step) of an image, which
has `pages` pages of 32 x 32 vertices a row and begins at the entry `base`.
"""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import warp as wp

from ...kernels.field import hierarchy as kernels
from ...kernels.field import ranges as range_kernels
from ...kernels.field.layout import Depth
from ..run import launch
from ..run.buffers import flat
from .codes import pack_samples
from .lattice import Lattice

COLUMN_BLOCK = 64  # columns of cells of a work item


def stored_at(lattice: Lattice, depth: int) -> Depth:
    """Return where the errors of a depth (1 to cell_depth) are in the error hierarchy."""
    return _layout_of(lattice.extent(depth), *lattice.layout(), lattice.cell_depth - depth)


def ranges_at(lattice: Lattice, depth: int) -> Depth:
    """Return the layout of the ranges of one depth (1 .. range_depth, and cell_depth)."""
    bisections = lattice.range_depth + 1 - depth if depth < lattice.cell_depth else 0
    return _layout_of(lattice.extent(depth), *lattice.range_layout(), bisections)


def _layout_of(extent: tuple[int, int], base: np.ndarray, pages: np.ndarray, bisections: int) -> Depth:
    """Return the layout of a depth, `bisections` above the cells of the stored lattice; 0: of the cells themselves.

    That lattice is the raster's for errors, and every other sample's for ranges. extent: columns and rows of the depth.
    base, pages: first entry and pages a row of each group (four depths that share an image, kernels/field/layout.py),
    and of the raster's cells.
    """
    group = (bisections - 1) // 4 if bisections else len(pages) - 1
    layout = Depth()
    (layout.columns, layout.rows), layout.sides = extent, int(bisections % 2)
    layout.base, layout.pages, layout.first, layout.step = int(base[group]), int(pages[group]), 0, 1
    if bisections:
        # Half a cell's side in vertices of the image: 1, or 2 in the two coarser depths of the group. Middles of sides
        # have positions in half sides from a corner on, and centres in whole sides from the first centre on.
        half_side = 1 << (bisections - 1) // 2 % 2
        layout.first, layout.step = (0, half_side) if bisections % 2 else (half_side, 2 * half_side)
    return layout


def upward(finest: int, layout_of: Callable[[int], Depth]) -> Iterator[tuple[int, Depth, Depth, int]]:
    """Yield all depths above `finest`, the deepest first: its number, the layout below it, its layout, and its `items`.

    layout_of(depth): layout of a depth. items: number of items of a launch over its diamonds.
    """
    finer = layout_of(finest)
    for depth in range(finest - 1, 0, -1):
        coarser = layout_of(depth)
        yield depth, finer, coarser, items(coarser)
        finer = coarser


def items(depth: Depth) -> int:
    """Return the number of items of a launch over the diamonds of a depth; some of them have none (`holds`)."""
    return (depth.columns // 2 + 1) * (depth.rows + 1) if depth.sides else depth.columns * depth.rows


def build_errors(
    samples: np.ndarray,
    lattice: Lattice,
    errors: np.ndarray,
    threads: int,
    on_progress: Callable[[float], None] = lambda _fraction: None,
    measured: np.ndarray | None = None,
) -> None:
    """Fill `errors` with the error of every diamond of a raster's lattice: float32 [lattice.node_count] metres, zeroed.

    samples: float32 [height, width] metres, holes filled. measured: the same with NaN where samples do not count,
    as in holes; None if all count.
    """
    build_twists(samples if measured is None else measured, stored_at(lattice, lattice.cell_depth), errors, threads)
    measure_triangles(samples, lattice, errors, threads, on_progress, measured)


def build_twists(measured: np.ndarray, cells: Depth, errors: np.ndarray, threads: int) -> None:
    """Fill the entries `cells` of `errors` (float32, zeroed) with a quarter of each cell's saturated twist, metres.

    A cell's twist is |h00 + h11 - h10 - h01|; a quarter is the error of its two triangles. measured: float32 [height,
    width] metres, NaN where samples do not count.
    """
    out, (height, width) = flat(errors, wp.float32), measured.shape
    inputs = [pack_samples(measured, steps=None), cells, out]
    launch.spread(kernels.twists, height - 1, inputs, step="error hierarchy", threads=threads, cost=0.4 * (width - 1))
    saturate_cells(cells, part=0.25, out=out, step="error hierarchy", threads=threads)


def measure_triangles(
    samples: np.ndarray,
    lattice: Lattice,
    errors: np.ndarray,
    threads: int,
    on_progress: Callable[[float], None] = lambda _fraction: None,
    measured: np.ndarray | None = None,
    coarsest: int = 1,
) -> None:
    """Fill `errors` of the diamonds above the raster's cells, up to the depth `coarsest`.

    The errors of the cells must be in it (`build_twists`). samples: float32 [height, width] metres, holes filled.
    measured: the same with NaN where samples do not count; None if all count. coarsest: more than 1 for a tile of a
    large raster, which knows only a part of the coarser diamonds.
    """
    out = flat(errors, wp.float32)
    raster = pack_samples(samples, steps=None)
    counted = pack_samples(samples if measured is None else measured, steps=None)
    # How far blocks of BLOCK x BLOCK cells are from bilinear patches between their corners: the kernels below skip
    # blocks that cannot raise an error.
    patches = kernels.PatchDistances()
    rows, patches.columns = ((count - 1) // kernels.BLOCK for count in samples.shape)
    patches.metres = wp.empty(rows * patches.columns, dtype=wp.float32, device="cpu")

    def spread(kernel: wp.Kernel, count: int, inputs: list, cost: float) -> None:
        """Launch a kernel over `count` items as the step "error hierarchy", with `errors` as its last argument."""
        launch.spread(kernel, count, [*inputs, out], step="error hierarchy", threads=threads, cost=cost)

    if patches.columns:
        inputs = [counted, patches]
        launch.spread(
            kernels.patch_distances, rows, inputs, step="error hierarchy", threads=threads, cost=samples.shape[1]
        )
    # From fine to coarse; diamonds are at sides of cells and at middles of cells at alternating depths. `finer` and
    # `coarser` are the layouts of the depth below and of this one, `side` is the side of this depth's cells in samples.
    for depth, finer, coarser, count in upward(lattice.cell_depth, partial(stored_at, lattice)):
        if depth < coarsest:
            break
        side = 1 << (lattice.levels - (depth - 1) // 2)
        cost = 1.0 + 0.05 * side * side  # estimate, relative: it decides how the items are spread over threads
        if coarser.sides:
            spread(kernels.side_errors, count, [raster, counted, patches, side // 2, finer, coarser], 2 * cost)
        else:
            is_root = int(depth == 1)
            spread(kernels.centre_errors, count, [raster, counted, patches, side, is_root, finer, coarser], 4 * cost)
        on_progress(1.0 - (depth - 1) / (2 * lattice.levels))


def saturate_cells(cells: Depth, part: float, out: wp.array, step: str, threads: int) -> None:
    """Raise each cell's value to at least part^n times the value of any cell n steps away.

    n counts steps between neighbours in a row or a column. cells: layout of the cells in `out`, the array of all
    values, which is changed in place. part: 0 .. 1. step: name of the timed step.
    """
    spread = partial(launch.spread, step=step, threads=threads)
    inputs = [wp.float32(part), cells, out]
    # Rows and then columns reach all cells: n is the sum of the steps along both.
    spread(kernels.saturate_rows, cells.rows, inputs, cost=0.2 * cells.columns)
    blocks, cost = -(-cells.columns // COLUMN_BLOCK), 0.2 * COLUMN_BLOCK * cells.rows
    spread(kernels.saturate_columns, blocks, [COLUMN_BLOCK, *inputs], cost=cost)


def range_scale(low: float, high: float) -> tuple[float, float]:
    """Return base and step (metres) such that base + q * step covers `low` .. `high` for q in 0 .. 65535.

    The step is 1 if both heights are equal.
    """
    step = (high - low) / 65535.0
    while low + 65535.0 * step < high:
        step = np.nextafter(step, np.inf)
    return float(low), float(step) if step > 0.0 else 1.0


def climbs(samples: np.ndarray) -> tuple[float, float]:
    """Return the largest differences, metres, rounded up, between neighbours in a row and in a column of `samples`."""
    x = y = 0.0
    for first in range(0, samples.shape[0] - 1, 64):  # blocks that fit into the cache
        rows = samples[first : first + 65]
        x = max(x, float(np.abs(np.diff(rows, axis=1)).max()))
        y = max(y, float(np.abs(np.diff(rows, axis=0)).max()))
    return x * (1 + 1e-6), y * (1 + 1e-6)


def build_ranges(
    samples: np.ndarray,
    lattice: Lattice,
    base: float,
    step: float,
    ranges: np.ndarray,
    threads: int,
    before: tuple[int, int] = (0, 0),
) -> None:
    """Fill `ranges` (uint16 [lattice.range_count, 2], zeroed): base + q * step encloses the surface.

    The two finest depths, three quarters of all diamonds, are not stored. Refinement intersects the ranges of their
    parents instead. These are nested, too, but wider: meshes have about one triangle in a thousand more. Nothing is
    filled if there are no coarser depths. before: columns and rows of `samples` before the lattice's first ones.
    """
    if lattice.range_depth == 0:
        return
    finest = ranges_at(lattice, lattice.range_depth)
    scale = wp.float64(base), wp.float64(step)
    inputs = [pack_samples(samples, steps=None), *before, *scale, finest, flat(ranges, wp.uint16)]
    cost = 6.0 * lattice.width
    # An item is a row of the finest stored diamonds. They are on sides of cells, of which there is one row more.
    launch.spread(
        range_kernels.finest_ranges, finest.rows + 1, inputs, step="height ranges", threads=threads, cost=cost
    )
    unite_ranges(lattice, ranges, threads)


def unite_ranges(lattice: Lattice, ranges: np.ndarray, threads: int) -> None:
    """Fill the ranges of heights above the finest stored depth, depth by depth. Those of that depth must be in it."""
    out = flat(ranges, wp.uint16)
    for _, finer, coarser, count in upward(lattice.range_depth, partial(ranges_at, lattice)):
        launch.spread(range_kernels.unite_children, count, [finer, coarser, out], step="height ranges", threads=threads)
