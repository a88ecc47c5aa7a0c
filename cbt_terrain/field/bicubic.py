# SPDX-License-Identifier: GPL-3.0-or-later
"""The error hierarchy and the ranges of heights of the C1 bicubic surface through a height field's samples.

The surface is a Bezier patch in each cell of the raster (kernels/bicubic/patches.py), and a patch lies between its
lowest and highest control height; so does the difference of two patches, and each derivative.

Above the cells all corners of triangles are samples, so a triangle is as far from the bicubic surface as from the
bilinear one and, at most, as far more as the two are apart in the cells that it covers: a diamond's error is its
bilinear error and the largest such distance below it. The two triangles of a cell err by a quarter of the twist and
that distance.

Below, a triangle lies inside one patch. In cells, let N be the largest norm of the patch's second derivatives and L the
triangle's longest edge, about whose middle a circle of the radius L / 2 holds the triangle. Taylor's formula about any
point p of it, with the weights w of p at the corners v, bounds the error by N sum w |v - p|^2 / 2, and the sum is at
most (L / 2)^2: N L^2 / 8 (S. Waldron, "The error in linear interpolation at the vertices of a simplex", SIAM J. Numer.
Anal. 35, 1998). In a cell's own triangles that is N / 4, its *bend*, and it halves with each bisection. A side's
diamond reaches into the next cell, so a bend is at least half of that of the four neighbours, and a cell's own error at
least half of the bends of its own and of theirs.

Ranges of heights are those of control heights, of each patch too: a box below the cells touches a few. Samples that the
source has rounded move the surface between them by more than themselves: the magnitudes of their weights in a row add
up to 1 + t (1 - t) at t of the way between two of them, 5/4 at most, and so do the columns'.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import warp as wp

from ...kernels.bicubic import patches as kernels
from ...kernels.field import expand as expand_kernels
from ...kernels.field import ranges as range_kernels
from ..errors import TerrainError
from ..run import launch
from ..run.buffers import flat
from ..run.locks import cached
from . import codes, hierarchy, store
from .codes import LEAST_EXPONENT, MOST_EXPONENT
from .heightfield import BICUBIC_KEY, INTERPOLATIONS, HeightField, with_detail
from .hierarchy import items, ranges_at, stored_at, upward

# Indices of Warp's arrays are int32.
MOST_ENTRIES = 2**31 - 1
# How far samples that move by 1 at most can move the surface.
LEVERAGE = 25.0 / 16.0
# What of a height field follows from its surface, beside arrays.
NUMBERS = ("range_base", "range_step", "min_height", "max_height", "steepest_x", "steepest_y")


def interpolated(field: HeightField, name: str) -> HeightField:
    """The same samples with another surface between them, one of INTERPOLATIONS; `field` itself if it is its own.

    Computed once and kept in the store if the field has one. Raises TerrainError for another name.
    """
    if name not in INTERPOLATIONS:
        known = " or ".join(INTERPOLATIONS)
        raise TerrainError(f"The interpolation is {name!r}; expected {known}.")
    if name == field.interpolation:
        return field
    if field.detail:
        return with_detail(interpolated(with_detail(field, None), name), field.detail)
    return cached(field.surfaces, name, lambda: bicubic(field))


def bicubic(field: HeightField) -> HeightField:
    """The bicubic surface through the samples of a bilinear field; kept in its store, if it has one."""
    lattice = field.lattice
    if 2 * lattice.node_count > MOST_ENTRIES:
        raise TerrainError(
            f"The terrain has {lattice.width} x {lattice.height} samples, more than an index of 31 bits can number for "
            "a bicubic surface (about 22,000 x 22,000): choose bilinear interpolation or import it smaller."
        )
    kept = _load(field)
    if kept is None:
        field.check_samples()
        made = build(field, launch.default_threads())
        for name, array in made.items():
            store.keep(field, name, array)
        kept = _load(field) or made  # of a store mapped, so that the memory of what was made is free again
    return replace(
        field,
        interpolation="bicubic",
        error=kept["error_c"],
        ranges=kept["ranges_c"],
        source_max=LEVERAGE * field.source_max,
        **dict(zip(NUMBERS, kept["numbers_c"].tolist(), strict=False)),
        exponents=[int(exponent) for exponent in kept["numbers_c"][len(NUMBERS) :]],
        key=field.key + BICUBIC_KEY,
        expanded={},
        surfaces={"bilinear": field},
        detailed={},
    )


def _arrays(field: HeightField) -> dict[str, tuple]:
    """Names, shapes and dtypes of the arrays of a bicubic surface."""
    arrays = store.kept_arrays(field.lattice)
    return {name: arrays[name] for name in ("error_c", "ranges_c", "numbers_c")}


def _load(field: HeightField) -> dict[str, np.ndarray] | None:
    """What the field's store has kept, if it has one and all of it is there."""
    kept = {name: store.load_kept(field, name, *of) for name, of in _arrays(field).items()}
    missing = any(array is None for array in kept.values())
    return None if missing or not _sound(kept["numbers_c"]) else kept


def _sound(numbers: np.ndarray) -> bool:
    """Whether numbers from a file can be what was written."""
    _, step, low, high, steep_x, steep_y, *exponents = numbers
    known = all(LEAST_EXPONENT <= exponent <= MOST_EXPONENT for exponent in exponents)
    return bool(np.isfinite(numbers).all() and step > 0 and low <= high and steep_x >= 0 and steep_y >= 0 and known)


def build(field: HeightField, threads: int) -> dict[str, np.ndarray]:
    """The arrays of a bicubic surface, by name; the same bytes for any number of threads."""
    made = {name: np.zeros(shape, dtype) for name, (shape, dtype) in _arrays(field).items()}
    numbers, errors = _numbers(field, threads), np.zeros(len(made["error_c"]), np.float32)
    _fill_ranges(field, *numbers[:2], made["ranges_c"], threads)
    _fill_errors(field, errors, threads)
    made["numbers_c"][:] = [*numbers, *codes.encode(field.lattice, errors, made["error_c"], threads)]
    return made


def _launch(kernel, count: int, inputs: list, threads: int, cost: float = 1.0) -> None:
    launch.spread(kernel, count, inputs, step="bicubic hierarchy", threads=threads, cost=cost)


def _numbers(field: HeightField, threads: int) -> list[float]:
    """NUMBERS of a bicubic surface; slopes are rounded up."""
    lattice = field.lattice
    rows = lattice.cells_y
    found = np.zeros((rows, 4))
    inputs = [codes.packed(field.heights(), None), wp.array(found, dtype=wp.vec4d, device=launch.DEVICE, copy=False)]
    _launch(kernels.extents, rows, inputs, threads, 10.0 * lattice.cells_x)
    low, high = float(found[:, 0].min()), float(found[:, 1].max())
    steepest = found[:, 2:].max(axis=0) * (1 + 1e-6) / (lattice.step_x, lattice.step_y)
    return [*hierarchy.range_scale(low, high), low, high, *steepest.tolist()]


def _fill_ranges(field: HeightField, base: float, step: float, ranges: np.ndarray, threads: int) -> None:
    """Ranges of the patches, and above them of all that they touch."""
    lattice, out = field.lattice, flat(ranges, wp.uint16)
    columns, rows = lattice.cells_x, lattice.cells_y
    own = ranges_at(lattice, lattice.cell_depth)
    inputs = [codes.packed(field.heights(), None), wp.float64(base), wp.float64(step), own, out]
    _launch(kernels.patch_ranges, rows, inputs, threads, 10.0 * columns)
    if lattice.range_depth:
        finest = ranges_at(lattice, lattice.range_depth)
        inputs = [columns, rows, own, finest, out]
        _launch(range_kernels.patches_around, finest.rows + 1, inputs, threads, 4.0 * columns)
        hierarchy.unite_ranges(lattice, ranges, threads)


def _fill_errors(field: HeightField, errors: np.ndarray, threads: int) -> np.ndarray:
    """Errors and bends; returns how far the bicubic surface is from the bilinear one, as errors but not with bends."""
    lattice, off = field.lattice, np.zeros(field.lattice.node_count, np.float32)
    known = codes.decode(lattice, field.error, field.table)
    out, apart, plain = (flat(array, wp.float32) for array in (errors, off, known))
    own, below = stored_at(lattice, lattice.cell_depth), stored_at(lattice, lattice.cell_depth)
    below.base = lattice.node_count
    inputs = [codes.packed(field.heights(), None), own, own, below, apart, out]
    _launch(kernels.patch_errors, lattice.cells_y, inputs, threads, 20.0 * lattice.cells_x)
    hierarchy.saturate_cells(below, 0.5, out, "bicubic hierarchy", threads)
    _launch(expand_kernels.cover_sides, items(own), [below, own, out], threads)
    for _, finer, coarser, count in upward(lattice.cell_depth, partial(stored_at, lattice)):
        _launch(expand_kernels.add_errors, count, [finer, coarser, plain, apart, out], threads)
    return off
