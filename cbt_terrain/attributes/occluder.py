# SPDX-License-Identifier: GPL-3.0-or-later
"""The ground that hides light: the raster and the maxima of its blocks, by which rays skip blocks.

Between samples the ground is the raster's profile from line to line, whatever the surface. Holes hide nothing.
"""

import numpy as np
import warp as wp

from ...kernels.effects import horizon as kernels
from ..field.codes import pack_samples
from ..field.extremes import extremes
from ..field.heightfield import HeightField
from ..run import launch
from ..run.buffers import flat, shared
from .attribute import SamplePoints

# Points of one launch; the work can be stopped between two launches.
AT_ONCE = 1 << 14
# Fraction of the largest height, more than the rounding of a height of the profile in float64.
MARGIN = 1e-9


def occluder_of(points: SamplePoints) -> kernels.Occluder:
    """Return the ground of a field at the vertical scale of `points`, with a tree of blocks by which rays skip ground.

    The blocks are cached with the field. Heights are without the vertical offset, detail and finer tiles.
    """
    occluder = occluder_without_blocks(points.field, points.vertical_scale)
    # A negative scale turns the ground upside down.
    reduce, field = np.minimum if occluder.scale < 0.0 else np.maximum, points.field
    # Extremes of blocks, and the first block and the blocks a row of each level.
    tops, first, wide = extremes(field, reduce)
    occluder.tops, occluder.first, occluder.wide = flat(tops, wp.float32), flat(first, wp.int64), flat(wide, wp.int32)
    occluder.levels = len(wide)
    return occluder


def occluder_without_blocks(field: HeightField, scale: float) -> kernels.Occluder:
    """Return the ground without its tree of blocks, for rays that examine every line of samples that they cross.

    scale: vertical scale of the heights.
    """
    lattice, occluder = field.lattice, kernels.Occluder()
    occluder.samples = pack_samples(field.samples, field.steps)
    occluder.west, occluder.south, _, _ = lattice.rectangle()
    occluder.step_x, occluder.step_y = lattice.step_x, lattice.step_y
    occluder.scale = scale
    low, high = field.min_height * scale, field.max_height * scale
    occluder.margin = MARGIN * max(abs(low), abs(high))  # metres, more than the rounding of a height
    occluder.highest = max(low, high)
    occluder.levels = 0  # of blocks
    if field.valid is not None:
        occluder.holed, occluder.valid = 1, flat(field.valid, wp.uint8)
    return occluder


def launch_at_points(kernel: wp.Kernel, points: SamplePoints, inputs: list, out: np.ndarray, cost: float) -> None:
    """Launch a kernel over points, AT_ONCE at a time, and let it fill `out`, float32 [n].

    inputs: its arguments before the points and the result. cost: of a point, relative to a lookup and a few operations.
    """
    for first in range(0, len(points), AT_ONCE):
        block = slice(first, first + AT_ONCE)
        positions = np.ascontiguousarray(points.positions[block], np.float32)
        values = [*inputs, shared(positions, wp.vec3f), flat(out[block], wp.float32)]
        launch.spread(kernel, len(positions), values, step="light", threads=points.threads, cost=cost)
