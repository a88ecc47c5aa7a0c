# SPDX-License-Identifier: GPL-3.0-or-later
"""The pyramid of prefiltered heights of a raster, computed on first use and cached with it.

Level 0 is the raster's samples, mapped or coded. The coarser levels are float32, a third as many samples; those of a
large raster are cached in its store, and mapped. A level of a raster of any size ends with the sample at or beyond the
border. On each level missing samples beside ground continue its slopes, as in the raster (field/continued_slopes.py).
"""

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..field import codes
from ..field.continued_slopes import continue_slopes
from ..field.derived_arrays import derive_cached_if_large, derived_shapes, samples_by_level, scratch_array
from ..field.heightfield import HeightRaster
from ..field.lattice import Lattice
from ..run import launch
from ..run.buffers import flat
from ..run.locks import caching

if TYPE_CHECKING:
    from ...kernels.effects import pyramid as kernels

# Name of the array in the store, and prefix of those of layers.
PYRAMID, BESIDE_HOLES = "pyramid", "pyramid_ground_beside_holes"
CONTINUED = 2  # samples
ROWS = 256  # rows that are computed together


def level_with(lattice: Lattice, max_samples: int, finest: int = 0) -> int:
    """Return the finest level from `finest` on with at most `max_samples`, the coarsest if there is none."""
    sizes = [rows * columns for rows, columns in samples_by_level(lattice)]
    return next((level for level, size in enumerate(sizes) if level >= finest and size <= max_samples), len(sizes) - 1)


def scaled_pyramid(
    raster: HeightRaster, vertical_scale: float, vertical_offset: float, threads: int, name: str = PYRAMID
) -> "kernels.Pyramid":
    """Return the raster's pyramid for kernels, with heights `height * vertical_scale + vertical_offset`.

    Coarser levels are computed on first use and cached with the raster. name: of their array in a store, always the
    same for one raster.
    """
    with caching:
        if not raster.cache.pyramid:
            raster.cache.pyramid.append(_coarser_levels(raster, threads, name))  # complete ones only
    packed = pack_pyramid(raster, raster.cache.pyramid[0])
    packed.height_scale, packed.height_offset = vertical_scale, vertical_offset
    return packed


def _coarser_levels(raster: HeightRaster, threads: int, name: str) -> np.ndarray:
    """Return the levels above the samples, float32, concatenated, the finest first.

    Each has half the resolution of the one before. Those of a large raster come from its store, or are cached there.
    name: of the array in the store.
    """
    from ...kernels.effects import pyramid as kernels

    def halve(arrays: dict[str, np.ndarray]) -> None:
        """Fill the array of the coarser levels, one of `arrays` by name, level by level."""
        packed = pack_pyramid(raster, arrays[name])
        for level in range(1, packed.levels):
            rows, columns = samples_by_level(raster.lattice)[level]
            inputs = [packed, level, packed.coarser]
            launch.spread(kernels.halve_level, rows, inputs, step="prefilter", threads=threads, cost=columns)
            _continue_slopes(raster, level, arrays[name])

    # Earlier versions computed those of rasters with holes otherwise, under the name that all others keep.
    name, shapes = name if raster.valid is None else BESIDE_HOLES, derived_shapes(raster.lattice)
    return derive_cached_if_large(raster, {name: shapes[PYRAMID]}, halve)[name]


def _continue_slopes(raster: HeightRaster, level: int, coarser: np.ndarray) -> None:
    """Continue the slopes of ground into missing samples of a level, in place. coarser: all levels, concatenated.

    A cell that is ground only in part may need samples up to CONTINUED steps from the ground.
    """
    if raster.valid is not None:
        sizes = samples_by_level(raster.lattice)[: level + 1]
        first = sum(int(rows * columns) for rows, columns in sizes[1:-1])
        heights = coarser[first : first + math.prod(sizes[-1])].reshape(sizes[-1])
        continue_slopes(lambda: heights, partial(holes_of_level, raster, level), sizes[-1], CONTINUED)


def level_of(raster: HeightRaster, level: int, threads: int = 1) -> np.ndarray:
    """Return the heights of a level, float32 [rows, columns] metres, row 0 south; level 0 is the raster."""
    if level == 0:
        if raster.steps is None:
            return raster.heights()
        heights = scratch_array(raster, raster.samples.shape, np.float32)
        for row in range(0, len(heights), ROWS):
            heights[row : row + ROWS] = raster.heights(slice(row, row + ROWS))
        return heights
    vertical_scale, vertical_offset = 1.0, 0.0  # heights as they are
    packed_levels = scaled_pyramid(raster, vertical_scale, vertical_offset, threads)  # fills the cache
    first = int(packed_levels.first.numpy()[level])
    rows, columns = samples_by_level(raster.lattice)[level]
    return raster.cache.pyramid[0][first : first + rows * columns].reshape(rows, columns)


def holes_of_level(raster: HeightRaster, level: int, rows: slice = slice(None)) -> np.ndarray:
    """Return which samples of some rows of a level are missing, bool [rows, columns]. raster: one with holes."""
    assert raster.valid is not None
    valid, (count, columns) = raster.valid[:: 2**level, :: 2**level], samples_by_level(raster.lattice)[level]
    first, end, _ = rows.indices(count)
    holes = valid[min(first, len(valid) - 1) : end] == 0
    # A level may end beyond the border.
    return np.pad(holes, ((0, end - first - holes.shape[0]), (0, columns - holes.shape[1])), mode="edge")


def missing_of_level(raster: HeightRaster, level: int) -> np.ndarray | None:
    """Return which samples of a level are missing, bool [rows, columns]; None for a raster without holes."""
    if raster.valid is None:
        return None
    missing = scratch_array(raster, samples_by_level(raster.lattice)[level], np.bool_)
    for row in range(0, len(missing), ROWS):
        missing[row : row + ROWS] = holes_of_level(raster, level, slice(row, row + ROWS))
    return missing


def pack_pyramid(raster: HeightRaster, coarser: np.ndarray) -> "kernels.Pyramid":
    """Return the samples and the coarser levels as kernels read them, without a scale.

    coarser: float32 [n], the levels concatenated, the finest first. Memory is shared.
    """
    from ...kernels import wp
    from ...kernels.effects import pyramid as kernels

    lattice = raster.lattice
    sizes = np.array(samples_by_level(lattice))
    packed = kernels.Pyramid()
    packed.samples = codes.pack_samples(raster.samples, raster.steps)
    packed.coarser = flat(coarser, wp.float32)
    # First sample of each level in `coarser`; level 0 is not in it.
    first = np.concatenate([[0, 0], np.cumsum(sizes[1:].prod(axis=1))[:-1]])[: len(sizes)]
    packed.first = wp.array(first, dtype=wp.int64, device=launch.DEVICE)
    packed.rows = wp.array(sizes[:, 0], dtype=wp.int32, device=launch.DEVICE)
    packed.columns = wp.array(sizes[:, 1], dtype=wp.int32, device=launch.DEVICE)
    packed.levels = len(sizes)
    packed.step_x, packed.step_y = lattice.step_x, lattice.step_y
    packed.per_x, packed.per_y = 1.0 / lattice.step_x, 1.0 / lattice.step_y
    packed.west, packed.south, _, _ = lattice.rectangle()
    packed.height_scale, packed.height_offset = 1.0, 0.0
    return packed
