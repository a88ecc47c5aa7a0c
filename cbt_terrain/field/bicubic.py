# SPDX-License-Identifier: GPL-3.0-or-later
"""The error hierarchy and the ranges of heights of the C1 bicubic surface through a height field's samples.

The surface is a Bezier patch in each cell of the raster (kernels/bicubic/patches.py). A patch, a difference of two
patches and each derivative are all between their lowest and highest control height.

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
from .codes import MAX_EXPONENT, MIN_EXPONENT
from .heightfield import INTERPOLATIONS, HeightField, SurfaceSpec, with_detail
from .hierarchy import items, ranges_at, stored_at, upward

# Indices of Warp's arrays are int32.
MAX_ENTRIES = 2**31 - 1
# Largest change of the surface if samples change by 1 at most.
LEVERAGE = 25.0 / 16.0
# Fields of a height field, besides arrays, that depend on its surface.
NUMBERS = ("range_base", "range_step", "min_height", "max_height", "steepest_x", "steepest_y")


def interpolated(field: HeightField, name: str) -> HeightField:
    """Return a field with the same samples and another surface between them; `field` itself if it has that surface.

    name: one of INTERPOLATIONS. The surface is computed once and cached in the field's store, if it has one. Raises
    TerrainError for another name.
    """
    if name not in INTERPOLATIONS:
        raise TerrainError(f"The interpolation is {name!r}", expected=" or ".join(INTERPOLATIONS))
    if name == field.interpolation:
        return field
    plain, surfaces = with_detail(field, None), field.cache.surfaces
    surfaces.setdefault(plain.surface, plain)
    return with_detail(cached(surfaces, SurfaceSpec(name), lambda: bicubic(plain)), field.detail)


def bicubic(field: HeightField) -> HeightField:
    """Return the bicubic surface through the samples of a bilinear field, cached in its store, if it has one."""
    lattice = field.lattice
    if 2 * lattice.node_count > MAX_ENTRIES:
        raise TerrainError(
            f"The terrain has {lattice.width} x {lattice.height} samples, more than an index of 31 bits can number for "
            "a bicubic surface",
            expected="about 22,000 x 22,000 at most",
            fix="choose bilinear interpolation or import it smaller",
        )
    arrays = _load(field)
    if arrays is None:
        field.raster.check_samples()
        built = build(field, launch.default_threads())
        for name, array in built.items():
            store.cache_derived(field, name, array)
        arrays = _load(field) or built  # mapped arrays of a store free the memory of the built ones
    return replace(
        field,
        surface=SurfaceSpec("bicubic"),
        error=arrays["error_c"],
        ranges=arrays["ranges_c"],
        source_max=LEVERAGE * field.source_max,
        **dict(zip(NUMBERS, arrays["numbers_c"].tolist(), strict=False)),
        exponents=[int(exponent) for exponent in arrays["numbers_c"][len(NUMBERS) :]],
    )


def _arrays(field: HeightField) -> dict[str, tuple]:
    """Return shapes and dtypes of the arrays of a bicubic surface, by name."""
    arrays = store.derived_arrays(field.lattice)
    return {name: arrays[name] for name in ("error_c", "ranges_c", "numbers_c")}


def _load(field: HeightField) -> dict[str, np.ndarray] | None:
    """Return the arrays cached in the field's store, None if any is missing or damaged."""
    found = {name: store.load_derived(field, name, *of) for name, of in _arrays(field).items()}
    arrays = {name: array for name, array in found.items() if array is not None}
    return arrays if len(arrays) == len(found) and _are_valid(arrays["numbers_c"]) else None


def _are_valid(numbers: np.ndarray) -> bool:
    """Return whether numbers from a file can be NUMBERS and exponents."""
    _, step, low, high, steep_x, steep_y, *exponents = numbers
    known = all(MIN_EXPONENT <= exponent <= MAX_EXPONENT for exponent in exponents)
    return bool(np.isfinite(numbers).all() and step > 0 and low <= high and steep_x >= 0 and steep_y >= 0 and known)


def build(field: HeightField, threads: int) -> dict[str, np.ndarray]:
    """Compute the arrays of a bicubic surface, by name; the same bytes for any number of threads."""
    arrays = {name: np.zeros(shape, dtype) for name, (shape, dtype) in _arrays(field).items()}
    numbers, errors = _numbers(field, threads), np.zeros(len(arrays["error_c"]), np.float32)
    _fill_ranges(field, numbers[0], numbers[1], arrays["ranges_c"], threads)
    _fill_errors(field, errors, threads)
    arrays["numbers_c"][:] = [*numbers, *codes.encode(field.lattice, errors, arrays["error_c"], threads)]
    return arrays


def _launch(kernel: wp.Kernel, count: int, inputs: list, threads: int, cost: float = 1.0) -> None:
    """Launch a kernel over `count` items as the step "bicubic hierarchy". cost: nanoseconds an item, over a base."""
    launch.spread(kernel, count, inputs, step="bicubic hierarchy", threads=threads, cost=cost)


def _numbers(field: HeightField, threads: int) -> list[float]:
    """Return range base and step, lowest and highest height (metres), and largest slopes along x and y, rounded up.

    They are NUMBERS of the bicubic surface.
    """
    lattice = field.lattice
    rows = lattice.cells_y
    found = np.zeros((rows, 4))
    inputs = [
        codes.pack_samples(field.heights(), None),
        wp.array(found, dtype=wp.vec4d, device=launch.DEVICE, copy=False),
    ]
    _launch(kernels.extents, rows, inputs, threads, 10.0 * lattice.cells_x)
    low, high = float(found[:, 0].min()), float(found[:, 1].max())
    steepest = found[:, 2:].max(axis=0) * (1 + 1e-6) / (lattice.step_x, lattice.step_y)
    return [*hierarchy.range_scale(low, high), low, high, *steepest.tolist()]


def _fill_ranges(field: HeightField, base: float, step: float, ranges: np.ndarray, threads: int) -> None:
    """Compute the ranges of heights of the patches, and above them those of all patches that they touch.

    base, step: a range is two 16-bit numbers n that stand for base + n step metres. ranges: uint16 [n, 2], filled.
    """
    lattice, out = field.lattice, flat(ranges, wp.uint16)
    columns, rows = lattice.cells_x, lattice.cells_y
    cells = ranges_at(lattice, lattice.cell_depth)
    inputs = [codes.pack_samples(field.heights(), None), wp.float64(base), wp.float64(step), cells, out]
    _launch(kernels.patch_ranges, rows, inputs, threads, 10.0 * columns)
    if lattice.range_depth:
        finest = ranges_at(lattice, lattice.range_depth)
        inputs = [columns, rows, cells, finest, out]
        _launch(range_kernels.patches_around, finest.rows + 1, inputs, threads, 4.0 * columns)
        hierarchy.unite_ranges(lattice, ranges, threads)


def _fill_errors(field: HeightField, errors: np.ndarray, threads: int) -> np.ndarray:
    """Compute errors and curvatures of the bicubic surface into `errors`, float32 metres.

    Return the distances between it and the bilinear surface, saturated like errors, float32 [node_count].
    """
    lattice, off = field.lattice, np.zeros(field.lattice.node_count, np.float32)
    known = codes.decode(lattice, field.error, field.table)
    out, apart, plain = (flat(array, wp.float32) for array in (errors, off, known))
    cells, curvatures = stored_at(lattice, lattice.cell_depth), stored_at(lattice, lattice.cell_depth)
    curvatures.base = lattice.node_count
    inputs = [codes.pack_samples(field.heights(), None), cells, curvatures, apart, out]
    _launch(kernels.patch_errors, lattice.cells_y, inputs, threads, 20.0 * lattice.cells_x)
    hierarchy.saturate_cells(curvatures, 0.5, out, "bicubic hierarchy", threads)
    _launch(expand_kernels.cover_sides, items(cells), [curvatures, cells, out], threads)
    for _, finer, coarser, count in upward(lattice.cell_depth, partial(stored_at, lattice)):
        _launch(expand_kernels.add_errors, count, [finer, coarser, plain, apart, out], threads)
    return off
