# SPDX-License-Identifier: GPL-3.0-or-later
"""The pyramid of prefiltered heights of a height field: made when first asked for, kept with the field.

Level 0 is the field's own samples, mapped or coded as they are; what is made is a third of them, as float32. A level of
a raster that does not fit ends with the sample at or beyond the rim.
"""

import numpy as np
import warp as wp

from ...kernels.effects import pyramid as kernels
from ..field import codes
from ..field.heightfield import HeightField
from ..field.lattice import Lattice
from ..field.store import shapes_of_effects as shapes  # rows and columns of each level
from ..run import launch
from ..run.buffers import flat
from ..run.locks import caching


def level_with(lattice: Lattice, most: int, finest: int = 0) -> int:
    """The finest level, from `finest` on, that has `most` samples at most; the coarsest if none has so few."""
    sizes = [rows * columns for rows, columns in shapes(lattice)]
    return next((level for level, size in enumerate(sizes) if level >= finest and size <= most), len(sizes) - 1)


def ground(field: HeightField, vertical_scale: float, vertical_offset: float, threads: int) -> kernels.Ground:
    """The pyramid as kernels read it; heights of the field become height * vertical_scale + vertical_offset."""
    with caching:
        if not field.prefiltered:
            field.prefiltered.append(_halved(field, threads))  # when it is complete: who is stopped leaves none
    found = packed(field, field.prefiltered[0])
    found.height_scale, found.height_offset = vertical_scale, vertical_offset
    return found


def _halved(field: HeightField, threads: int) -> np.ndarray:
    """Compute the coarser levels, float32, one behind the other."""
    count = sum(int(rows * columns) for rows, columns in shapes(field.lattice)[1:])
    made = np.empty(max(count, 1), np.float32)
    below = packed(field, made)
    for level in range(1, below.levels):
        rows, columns = shapes(field.lattice)[level]
        inputs = [below, level, below.coarser]
        launch.spread(kernels.halve, rows, inputs, step="prefilter", threads=threads, cost=columns)
    return made


def level_of(field: HeightField, level: int, threads: int = 1) -> np.ndarray:
    """float32 [rows, columns] metres: the heights of a level, row 0 south."""
    if level == 0:
        return field.heights()
    first = int(ground(field, 1.0, 0.0, threads).first.numpy()[level])
    rows, columns = shapes(field.lattice)[level]
    return field.prefiltered[0][first : first + rows * columns].reshape(rows, columns)


def packed(field: HeightField, coarser: np.ndarray) -> kernels.Ground:
    """The heights as they are, and the levels above them (float32 [n], the finest first) as kernels read them."""
    lattice = field.lattice
    sizes = np.array(shapes(lattice))
    found = kernels.Ground()
    found.samples = codes.packed(field.samples, field.steps)
    found.coarser = flat(coarser, wp.float32)
    first = np.concatenate([[0, 0], np.cumsum(sizes[1:].prod(axis=1))[:-1]])[: len(sizes)]
    found.first = wp.array(first, dtype=wp.int64, device=launch.DEVICE)
    found.rows = wp.array(sizes[:, 0], dtype=wp.int32, device=launch.DEVICE)
    found.columns = wp.array(sizes[:, 1], dtype=wp.int32, device=launch.DEVICE)
    found.levels = len(sizes)
    found.step_x, found.step_y = lattice.step_x, lattice.step_y
    found.per_x, found.per_y = 1.0 / lattice.step_x, 1.0 / lattice.step_y
    found.west, found.south, _, _ = lattice.rectangle()
    found.height_scale, found.height_offset = 1.0, 0.0
    return found
