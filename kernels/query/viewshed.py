# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples that an eye sees: a line of sight for each."""

import warp as wp

from .crossing import NOWHERE, HeightRanges
from .rays import first_hit, ray_of
from .surface import QueriedSurface, height_and_slopes, is_ground


@wp.kernel
def in_sight(
    offset: int,
    first: int,
    surface: QueriedSurface,
    height_ranges: HeightRanges,
    eye: wp.vec3d,
    target: wp.float64,
    radius2: wp.float64,
    slack: wp.float64,
    seen: wp.array(dtype=wp.bool),
):
    """Write whether the eye sees a point `target` metres above sample first + offset + tid.

    It does if no ground rises above the line between them; a sample inside a hole is not seen. seen: an entry for each
    sample of the raster. eye: metres, after vertical scaling. radius2: squared horizontal distance, m2, beyond which
    nothing is seen. slack: metres that ground must rise above the line to hide.
    """
    n = first + offset + wp.tid()
    row = n / surface.samples.columns
    column = n - row * surface.samples.columns
    i = wp.min(column, surface.samples.columns - 2)
    j = wp.min(row, surface.samples.rows - 2)
    s = wp.float64(column - i)
    t = wp.float64(row - j)
    p = wp.vec3d(
        surface.west + wp.float64(column) * surface.step_x,
        surface.south + wp.float64(row) * surface.step_y,
        wp.float64(0.0),
    )
    x = eye[0] - p[0]
    y = eye[1] - p[1]
    is_seen = x * x + y * y <= radius2
    if is_seen:
        is_seen = is_ground(surface, i, j, column == i, row == j)
    if is_seen:
        g = height_and_slopes(surface, i, j, s, t)
        p[2] = g[0] * surface.scale + surface.offset + target
        sight = eye - p
        far = wp.length(sight)
        if far > wp.float64(0.0):  # the eye is not at the point itself
            ray = ray_of(surface, p, sight / far)
            # The ray begins above the surface, and the first block that is tried is one cell.
            is_seen = first_hit(surface, height_ranges, ray, far, wp.float64(1.0), slack, 0) == NOWHERE
    seen[n] = is_seen
