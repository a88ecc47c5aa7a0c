# SPDX-License-Identifier: GPL-3.0-or-later
"""The scale of attributes: a level of the pyramid for each point.

Level 0 is the raster's samples, and level j has 2^j times their spacing; levels below 0 exist in finer tiles. Levels
have steps of 1/8, so that most values keep their bits under a slow camera.
"""

import math
from collections.abc import Sequence

import numpy as np
import warp as wp

from ...kernels.effects import footprint as kernels
from ..errors import TerrainError
from ..field.derived_arrays import samples_by_level
from ..field.heightfield import HeightField
from ..run import launch
from ..run.buffers import flat, shared
from ..view.linear import add_up, length, product, round_last_bits
from ..view.view import ORTHOGRAPHIC, View
from .finer_pyramid import finer_places, min_level

STEPS_PER_LEVEL = 8


def fixed_level(field: HeightField, metres: float) -> float:
    """Return the pyramid level with samples `metres` apart in the terrain's space, the finest one for 0 metres.

    A level below 0 is one of finer tiles; `limit_levels` raises it where there are none. Raises TerrainError for an
    invalid distance.
    """
    if not 0.0 <= metres < math.inf:
        problem = f"The scale of effects for geometry is {metres} m"
        raise TerrainError(problem, expected="a distance, or 0 for the raster's")
    finest = 2.0 ** min_level(field.raster)
    # The last bits of the C library's logarithms differ by machine.
    steps = round_last_bits(math.log2(max(metres / _spacing(field), finest))) * STEPS_PER_LEVEL
    return min(math.floor(steps + 0.5) / STEPS_PER_LEVEL, _max_level(field))


def footprint_levels(
    field: HeightField,
    positions: np.ndarray,
    views: Sequence[View],
    placement: np.ndarray | None = None,
    threads: int = 1,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Return the level of each point whose spacing is the finest pixel footprint of any view, float32 [n].

    positions: float32 [n, 3], metres in the terrain's space, which `placement` (4 x 4) maps to the world. out: array
    for the result, None for a new one. The footprint is across the line of sight and depends on the distance, not on
    the depth, so that rotating the camera changes nothing. For an unevenly scaled terrain it is that along the axis of
    least scale, the largest. Without views it is the finest level.
    """
    levels = np.empty(len(positions), np.float32) if out is None else out
    finest = min_level(field.raster)
    if not views:
        levels[:] = finest
        limit_levels(field, positions, levels, threads)  # not below 0 where only the raster is known
        return levels
    placement = np.eye(4) if placement is None else np.asarray(placement, np.float64)
    levels[:] = np.inf  # the kernel takes the minimum over the views
    eyes = wp.array(
        [_footprint_eye(field, view, placement) for view in views], dtype=kernels.FootprintEye, device=launch.DEVICE
    )
    inputs = [shared(positions, wp.vec3f), eyes, finest, _max_level(field), flat(levels, wp.float32)]
    blocks = -(-len(positions) // kernels.BLOCK)
    launch.spread(kernels.footprint_levels, blocks, inputs, step="footprint", threads=threads, cost=0.1 * kernels.BLOCK)
    limit_levels(field, positions, levels, threads)
    return levels


def limit_levels(field: HeightField, positions: np.ndarray, levels: np.ndarray, threads: int = 1) -> None:
    """Raise the levels of points, in place, to the finest level that the heights have there.

    It is 0 where only the raster is known, and falls to that of finer tiles within a quarter of a tile from their
    border. So values of attributes are continuous over the border. positions: float32 [n, 3], metres in the terrain's
    space. levels: float32 [n], none below the field's finest level.
    """
    if field.raster.finer is not None:
        inputs = [finer_places(field.raster), shared(positions, wp.vec3f), flat(levels, wp.float32)]
        launch.spread(kernels.limit_levels, len(levels), inputs, step="footprint", threads=threads, cost=1)


def _footprint_eye(field: HeightField, view: View, placement: np.ndarray) -> kernels.FootprintEye:
    """Convert a view for the footprint kernel: at distance d a pixel covers d sqrt(pixel2) spacings of samples.

    placement: float64 [4, 4], maps the terrain's space to the world.
    """
    to_camera = product(view.world_to_camera, placement)
    eye = kernels.FootprintEye()
    # The distance of a point p from the camera is the length of linear p + shift.
    eye.linear, eye.shift = wp.mat33d(to_camera[:3, :3]), wp.vec3d(to_camera[:3, 3])
    if view.kind == ORTHOGRAPHIC:  # all points are at unit distance
        eye.linear, eye.shift = wp.mat33d(), wp.vec3d(1.0, 0.0, 0.0)
    samples_per_pixel = 1.0 / (view.pixels_per_unit * _min_stretch(to_camera[:3, :2]) * _spacing(field))
    eye.pixel2 = samples_per_pixel * samples_per_pixel
    return eye


def _min_stretch(across: np.ndarray) -> float:
    """Return the smallest length of a level unit vector in camera space, the smaller singular value of [3, 2].

    across: the images of the unit vectors along x and y, its two columns.
    """
    a, b = length(across[:, 0]), length(across[:, 1])
    dot = float(add_up(across[:, 0] * across[:, 1]))
    # Square of the larger singular value. The squares of both multiply to a^2 b^2 - dot^2.
    largest2 = (a * a + b * b + length((a * a - b * b, 2 * dot))) / 2
    return math.sqrt(max(a * a * b * b - dot * dot, 0.0) / largest2)


def _spacing(field: HeightField) -> float:
    """Return the larger spacing of samples in metres."""
    return max(field.lattice.step_x, field.lattice.step_y)


def _max_level(field: HeightField) -> int:
    """Return the number of the coarsest level of the field's height pyramid."""
    return len(samples_by_level(field.lattice)) - 1
