# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground that hides light: the raster and the maxima of its blocks, by which rays skip blocks.

Between samples the ground is the raster's profile from line to line, whatever the surface; holes are filled.
"""

import numpy as np
import warp as wp

from ...kernels.effects import horizon as kernels
from ..field.blocks import fill_levels, level_offsets, level_shapes, over_cells
from ..field.codes import pack_samples
from ..field.derived_arrays import derive_large
from ..field.heightfield import HeightField
from ..field.store import derived_arrays as derived_shapes
from ..run import launch
from ..run.buffers import flat, shared
from ..run.locks import cached
from .attribute import SamplePoints

# Points of one launch; the work can be stopped between two launches.
AT_ONCE = 1 << 14
# Fraction of the largest height, more than the rounding of a height of the profile in float64.
MARGIN = 1e-9


def occluder_of(places: SamplePoints) -> kernels.Occluder:
    """Return the ground of a field at the vertical scale of `places`; its blocks are cached with the field."""
    occluder = every_crossing(places.field, places.vertical_scale)
    reduce, field = np.minimum if occluder.scale < 0.0 else np.maximum, places.field
    tops, first, wide = cached(field.cache.results, ("tops", reduce), lambda: find_tops(field, reduce))
    occluder.tops, occluder.first, occluder.wide = flat(tops, wp.float32), flat(first, wp.int64), flat(wide, wp.int32)
    occluder.levels = len(wide)
    return occluder


def every_crossing(field: HeightField, scale: float) -> kernels.Occluder:
    """Return the ground for rays, without the tree of blocks by which others skip ground below a ray."""
    lattice, occluder = field.lattice, kernels.Occluder()
    occluder.samples = pack_samples(field.samples, field.steps)
    occluder.west, occluder.south, _, _ = lattice.rectangle()
    occluder.step_x, occluder.step_y = lattice.step_x, lattice.step_y
    occluder.scale = scale
    low, high = field.min_height * scale, field.max_height * scale
    occluder.margin = MARGIN * max(abs(low), abs(high))
    occluder.highest = max(low, high)
    occluder.levels = 0
    return occluder


def find_tops(field: HeightField, reduce: np.ufunc) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the maxima of all blocks (minima with np.minimum), float32, level after level from FINEST on.

    Also the first index of each level, int64 [levels], and the blocks in its rows, int32 [levels], 0 below FINEST.
    Those of a large raster are cached in its store.
    """
    lattice, side, name = field.lattice, 1 << kernels.FINEST, "tops" if reduce is np.maximum else "bottoms"
    rows, columns = (-(-cells // side) for cells in (lattice.cells_y, lattice.cells_x))

    def finest(some: slice) -> np.ndarray:
        """Read the samples of some rows of blocks."""
        return over_cells(field.heights(slice(some.start * side, some.stop * side + 1)), side, reduce)

    def fill(arrays: dict[str, np.ndarray]) -> None:
        """Compute all levels."""
        fill_levels(arrays[name], rows, columns, reduce, finest)

    found = derive_large(field.raster, {name: derived_shapes(lattice)[name]}, fill)[name]
    return found, *level_offsets(level_shapes(rows, columns), int(kernels.FINEST))


def launch_at_points(kernel: wp.Kernel, places: SamplePoints, inputs: list, out: np.ndarray, cost: float) -> None:
    """Launch a kernel over points, AT_ONCE at a time, and let it fill `out`, float32 [n].

    inputs: its arguments before the points and the result. cost: nanoseconds a point, over a base.
    """
    for first in range(0, len(places), AT_ONCE):
        some = slice(first, first + AT_ONCE)
        where = np.ascontiguousarray(places.positions[some], np.float32)
        values = [*inputs, shared(where, wp.vec3f), flat(out[some], wp.float32)]
        launch.spread(kernel, len(where), values, step="light", threads=places.threads, cost=cost)
