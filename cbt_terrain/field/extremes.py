# SPDX-License-Identifier: GPL-3.0-or-later
"""The lowest and highest samples of blocks of a raster, by which rays and horizons skip ground."""

import numpy as np

from ...kernels.effects import horizon as kernels
from ..run.locks import cached
from .blocks import fill_levels, level_offsets, level_shapes, over_cells
from .derived_arrays import derive_cached_if_large, derived_shapes
from .heightfield import HeightField


def extremes(field: HeightField, reduce: np.ufunc) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return `find_extremes` of a field: extremes of blocks, each level's first index, and its number of blocks a row.

    It is computed once for each `reduce`, np.maximum or np.minimum, and cached with the field.
    """
    return cached(field.cache.results, ("tops", reduce), lambda: find_extremes(field, reduce))


def find_extremes(field: HeightField, reduce: np.ufunc) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the maxima of all blocks, each level's first index among them, and its number of blocks in a row.

    Maxima (minima with np.minimum) are float32 metres, level after level from FINEST on. A block of level k has 2^k
    cells a side, with the samples on its border; detail and finer tiles do not count. The others are int64 and int32
    [levels], 0 below FINEST. Maxima of a large raster are cached in its store. reduce: np.maximum or np.minimum.
    """
    lattice, side, name = field.lattice, 1 << kernels.FINEST, "tops" if reduce is np.maximum else "bottoms"
    rows, columns = (-(-cells // side) for cells in (lattice.cells_y, lattice.cells_x))

    def finest(some: slice) -> np.ndarray:
        """Return the extremes of some rows of blocks."""
        return over_cells(field.heights(slice(some.start * side, some.stop * side + 1)), side, reduce)

    def fill(arrays: dict[str, np.ndarray]) -> None:
        """Compute all levels."""
        fill_levels(arrays[name], rows, columns, reduce, finest)

    extremes = derive_cached_if_large(field.raster, {name: derived_shapes(lattice)[name]}, fill)[name]
    return extremes, *level_offsets(level_shapes(rows, columns), int(kernels.FINEST))
