# SPDX-License-Identifier: GPL-3.0-or-later
"""The error hierarchy and the ranges of heights of the C1 bicubic surface through a height field's samples.

The surface is a Bezier patch in each cell of the raster (kernels/bicubic/patches.py). A patch, a difference of two
patches and each derivative are all between their lowest and highest control height.

The error hierarchy is computed in bicubic_errors.py.

Above the cells all corners of triangles are samples. So the distance of a triangle from the bicubic surface is at most
its distance from the bilinear one plus the largest distance between both surfaces in the cells that it covers. A
diamond's error is its bilinear error plus that distance below it. The error of the two triangles of a cell is a quarter
of the twist plus that distance.

Below the cells a triangle is inside one patch. In units of cells, let N be the largest norm of the patch's second
derivatives and L the triangle's longest edge. A circle of radius L / 2 around that edge's middle contains the triangle.
Taylor's formula at any point p of the triangle, with the weights w of p at the corners v, bounds the error by
N sum w |v - p|^2 / 2, and the sum is at most (L / 2)^2: N L^2 / 8 (S. Waldron, "The error in linear interpolation at
the vertices of a simplex", SIAM J. Numer. Anal. 35, 1998). For a cell's triangles this is N / 4, called its
*curvature*, and it halves with each bisection. A side's diamond covers a part of the next cell. So a curvature is at
least half of those of the four neighbours, and a cell's error at least half of its curvature and of theirs.

Ranges of heights are those of control heights, also of each patch, because a box below the cells touches several.
Rounded samples move the surface between them by more than themselves: the magnitudes of their weights in a row add up
to 1 + t (1 - t), 5/4 at most, at the fraction t between two of them, and those in a column likewise.
"""

from dataclasses import replace

import numpy as np
import warp as wp

from ...kernels.bicubic import patches as kernels
from ...kernels.field import ranges as range_kernels
from ..errors import TerrainError
from ..run import launch
from ..run.buffers import flat
from ..run.locks import cached
from . import bicubic_errors, codes, derived_arrays, hierarchy
from .codes import MAX_EXPONENT, MIN_EXPONENT
from .finer_bicubic import bicubic_tiles
from .heightfield import INTERPOLATIONS, HeightField, SurfaceSpec, with_detail
from .hierarchy import ranges_at
from .lattice import Lattice

# Largest change of the surface if samples change by 1 at most.
LEVERAGE = 25.0 / 16.0
# Fields of a height field, besides arrays, that depend on its surface.
NUMBERS = ("range_base", "range_step", "min_height", "max_height", "steepest_x", "steepest_y")


def interpolated(field: HeightField, name: str) -> HeightField:
    """Return a field with the same samples and another surface between them; `field` itself if it has that surface.

    A detail of the field stays. name: one of INTERPOLATIONS. The surface is computed once and cached in the field's
    store, if it has one. Raises TerrainError for another name or a sample that is not finite.
    """
    if name not in INTERPOLATIONS:
        raise TerrainError(f"The interpolation is {name!r}", expected=" or ".join(INTERPOLATIONS))
    if name == field.interpolation:
        return field
    plain, surfaces = with_detail(field, detail=None), field.cache.surfaces
    surfaces.setdefault(plain.surface, plain)  # so a bilinear field is always found here, never computed
    return with_detail(cached(surfaces, SurfaceSpec(name), lambda: bicubic(plain)), field.detail)


def bicubic(field: HeightField) -> HeightField:
    """Return the bicubic surface through the samples of a bilinear field, cached in its store, if it has one.

    field: without detail. Tiles with finer heights, if it has some, are added to the result. Raises TerrainError for a
    sample that is not finite.
    """
    arrays = derived_arrays.derive_cached(
        field.raster, arrays_of(field.lattice), lambda arrays: build(field, arrays), _are_valid
    )
    smooth = replace(
        field,
        surface=SurfaceSpec("bicubic"),
        error=arrays["error_c"],
        ranges=arrays["ranges_c"],
        source_max=LEVERAGE * field.source_max,  # errors of samples move the surface by more than themselves
        **dict(zip(NUMBERS, arrays["numbers_c"].tolist(), strict=False)),  # exponents of the error tables follow
        exponents=[int(exponent) for exponent in arrays["numbers_c"][len(NUMBERS) :]],
    )
    return smooth if field.raster.finer is None else _with_finer(smooth)


def _with_finer(smooth: HeightField) -> HeightField:
    """Return the bicubic surface with its finer tiles. smooth: without them, of a raster that has some."""
    tiles, low, high = bicubic_tiles(smooth)
    return replace(
        smooth,
        bicubic_finer=tiles,
        min_height=min(smooth.min_height, low),
        max_height=max(smooth.max_height, high),
        steepest_x=smooth.steepest_x + tiles.max_slope,
        steepest_y=smooth.steepest_y + tiles.max_slope,
    )


def arrays_of(lattice: Lattice) -> dict[str, tuple]:
    """Return shapes and dtypes of the arrays of a bicubic surface, by name."""
    arrays = derived_arrays.derived_shapes(lattice)
    return {name: arrays[name] for name in ("error_c", "ranges_c", "numbers_c")}


def _are_valid(arrays: dict[str, np.ndarray]) -> bool:
    """Return whether the numbers among arrays from files can be NUMBERS and, after them, exponents of error tables."""
    numbers = arrays["numbers_c"]
    _, step, low, high, steep_x, steep_y, *exponents = numbers
    known = all(MIN_EXPONENT <= exponent <= MAX_EXPONENT for exponent in exponents)
    return bool(np.isfinite(numbers).all() and step > 0 and low <= high and steep_x >= 0 and steep_y >= 0 and known)


def build(field: HeightField, arrays: dict[str, np.ndarray], threads: int | None = None) -> None:
    """Fill the zeroed arrays of a bicubic surface (`arrays_of`), by name; the same bytes for any number of threads.

    field: the bilinear one. threads: None for the default number. Raises TerrainError for a sample that is not finite.
    """
    threads = threads or launch.default_threads()
    field.raster.check_samples()
    numbers = _numbers(field, threads)  # base and step of the stored ranges, extremes of heights and slopes
    _fill_ranges(field, numbers[0], numbers[1], arrays["ranges_c"], threads)
    arrays["numbers_c"][:] = [*numbers, *bicubic_errors.fill_errors(field, arrays["error_c"], threads)]


def _numbers(field: HeightField, threads: int) -> list[float]:
    """Return the first six of `numbers_c`: range base and step, lowest and highest height, largest slope along x and y.

    A stored height n of a range stands for base + n step metres. Heights (metres) and slopes are bounds from control
    heights; those of slopes are rounded up. Holes do not count for heights.
    """
    lattice = field.lattice
    rows = lattice.cells_y
    extents = np.zeros((rows, 4))  # by row of cells: lowest and highest height, largest climb along x and y
    valid = np.ones(1, np.uint8) if field.valid is None else field.valid
    inputs = [
        codes.pack_samples(field.samples, field.steps),
        int(field.valid is not None),
        flat(valid, wp.uint8),
        wp.array(extents, dtype=wp.vec4d, device=launch.DEVICE, copy=False),
    ]
    bicubic_errors.launch_step(kernels.extents, rows, inputs, threads, 10.0 * lattice.cells_x)
    low, high = float(extents[:, 0].min()), float(extents[:, 1].max())
    steepest = extents[:, 2:].max(axis=0) * (1 + 1e-6) / (lattice.step_x, lattice.step_y)
    return [*hierarchy.range_scale(low, high), low, high, *steepest.tolist()]


def _fill_ranges(field: HeightField, base: float, step: float, ranges: np.ndarray, threads: int) -> None:
    """Compute the ranges of heights of all patches (cells), and for coarser diamonds of the patches that each touches.

    base, step: a range is two 16-bit numbers n that stand for base + n step metres. ranges: uint16 [n, 2], zeroed. A
    raster with a shorter side of one or two cells has ranges of patches alone.
    """
    lattice, out = field.lattice, flat(ranges, wp.uint16)
    columns, rows = lattice.cells_x, lattice.cells_y
    cells = ranges_at(lattice, lattice.cell_depth)
    inputs = [codes.pack_samples(field.samples, field.steps), wp.float64(base), wp.float64(step), cells, out]
    bicubic_errors.launch_step(kernels.patch_ranges, rows, inputs, threads, 10.0 * columns)
    if lattice.range_depth:
        finest = ranges_at(lattice, lattice.range_depth)
        # First the finest diamonds that are stored, on sides of cells (one more row than of cells), then the others.
        inputs = [columns, rows, cells, finest, out]
        bicubic_errors.launch_step(range_kernels.patches_around, finest.rows + 1, inputs, threads, 4.0 * columns)
        hierarchy.unite_ranges(lattice, ranges, threads)
