# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples that an eye sees on a surface `height * vertical_scale + vertical_offset`."""

import math

import numpy as np
import warp as wp

from ...kernels.query import viewshed as kernels
from ...kernels.query.surface import QueriedSurface
from ..errors import TerrainError
from ..field.heightfield import HeightField
from ..plain_numbers import plain_number, vectors
from ..run import launch
from ..run.buffers import flat
from .surface import height_ranges_of, pack_surface

COST = 50.0
AT_ONCE = 1 << 17  # samples of one launch: between two the work can be stopped
# Of the greatest height: by so much the ground has to rise above a line of sight, more than float64 rounds.
MARGIN = 1e-9


def viewshed(
    field: HeightField,
    eye: np.ndarray,
    target_height: float = 0.0,
    radius: float | None = None,
    vertical_scale: float = 1.0,
    vertical_offset: float = 0.0,
    threads: int | None = None,
) -> np.ndarray:
    """Return which samples an eye sees: bool [rows, columns], row 0 south. Raises TerrainError.

    eye: x, y, z in metres in the terrain's own space. A sample is seen if nowhere the surface rises above the straight
    line from `target_height` metres over it to the eye. The whole line is searched: exact, as R3 of Franklin, Ray and
    Mehta (1994, "Geometric algorithms for siting of air defense missile batteries") but over the surface instead of its
    lines of samples. Only samples within `radius` metres in the plan are seen; None: no limit. Holes are not seen, and
    do not hide. The earth is flat.
    """
    eye = vectors(eye, 3, "eye")
    if len(eye) != 1:
        raise TerrainError(f"The eye came as {len(eye)} points", expected="one, x, y and z in metres")
    target_height = plain_number(target_height, float, "The height of targets")
    radius = math.inf if radius is None else plain_number(radius, float, "The radius")
    if not (math.isfinite(target_height) and radius >= 0.0):
        raise TerrainError(
            f"The height of targets is {target_height} m and the radius {radius} m",
            expected="a finite number and one that is not negative",
        )
    surface = pack_surface(field, vertical_scale, vertical_offset)
    height_ranges = height_ranges_of(field, surface)
    slack = MARGIN * max(abs(height_ranges.low_z), abs(height_ranges.high_z), abs(eye[0, 2]))
    seen = np.zeros(field.samples.shape, bool)
    numbers = map(wp.float64, (target_height, radius * radius, slack))
    inputs = [surface, height_ranges, wp.vec3d(*eye[0]), *numbers, flat(seen, wp.bool)]
    start, end = (surface.samples.columns * row for row in _rows_near(surface, float(eye[0, 1]), radius))
    for first in range(start, end, AT_ONCE):
        count = min(AT_ONCE, end - first)
        launch.spread(kernels.in_sight, count, [first, *inputs], step="query", threads=threads, cost=COST)
    return seen


def _rows_near(surface: QueriedSurface, y: float, radius: float) -> tuple[int, int]:
    """Return the first row of samples that may be within a radius of y, and the one after the last."""
    rows = (np.array([y - radius, y + radius]) - surface.south) / surface.step_y
    low, high = np.floor(np.clip(rows, -1, surface.samples.rows)).astype(int).tolist()
    return max(low, 0), min(high + 2, surface.samples.rows)
