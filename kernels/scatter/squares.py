# SPDX-License-Identifier: GPL-3.0-or-later
"""The densities of views over squares of the plan, whose boxes come from the stored ranges of heights."""

import warp as wp

from ..field.domain import Domain
from ..field.layout import Depth, entry
from ..refine.diamond import larger, smaller
from ..unchecked import item_at
from .seen import Views, density_bounds

# Relative to the largest coordinate, more than the rounding of positions to float32 and to the lattice.
ROUNDING = wp.constant(wp.float64(1e-6))


@wp.struct
class ScatterSquares:
    """Squares of one size; the south-western corner of (0, 0) is at `west`, `south` in metres."""

    west: wp.float64
    south: wp.float64
    side: wp.float64
    # Height ranges of lattice cells of at least this size, `cell_x` by `cell_y` metres; without any, `low` and `high`.
    ranges: Depth
    cell_x: wp.float64
    cell_y: wp.float64
    low: wp.float64  # metres, before scaling
    high: wp.float64


@wp.func
def heights_over(domain: Domain, q: ScatterSquares, x0: wp.float64, y0: wp.float64, x1: wp.float64, y1: wp.float64):
    """Return the lowest and highest height in a rectangle of at most a square's size, metres before scaling.

    x0 .. y1: metres.
    """
    low = q.low
    high = q.high
    if q.ranges.columns > 0:
        low = wp.float64(wp.inf)
        high = -low
        i1 = wp.min(wp.int32((x1 - domain.west) / q.cell_x), q.ranges.columns - 1)
        j1 = wp.min(wp.int32((y1 - domain.south) / q.cell_y), q.ranges.rows - 1)
        for j in range(wp.min(wp.int32((y0 - domain.south) / q.cell_y), j1), j1 + 1):
            for i in range(wp.min(wp.int32((x0 - domain.west) / q.cell_x), i1), i1 + 1):
                at = wp.int64(2) * entry(q.ranges, i, j)
                low = smaller(low, wp.float64(item_at(domain.ranges, at)))
                high = larger(high, wp.float64(item_at(domain.ranges, at + wp.int64(1))))
        low = domain.range_base + low * domain.range_step - domain.max_detail
        high = domain.range_base + high * domain.range_step + domain.max_detail
    return low, high


@wp.kernel
def density_range(
    offset: int,
    domain: Domain,
    views: Views,
    q: ScatterSquares,
    east: wp.float64,
    north: wp.float64,
    numbers: wp.array(dtype=wp.vec2i),
    wanted: wp.array(dtype=wp.vec2d),
):
    """Write the bounds (upper, lower) of the density that views want in square numbers[offset + tid].

    They are 0 outside the raster. east, north: border of the raster, metres.
    """
    t = offset + wp.tid()
    more = ROUNDING * (wp.abs(east) + wp.abs(domain.west) + wp.abs(north) + wp.abs(domain.south))
    x0 = q.west + wp.float64(numbers[t][0]) * q.side
    y0 = q.south + wp.float64(numbers[t][1]) * q.side
    x1 = smaller(x0 + q.side + more, east)
    y1 = smaller(y0 + q.side + more, north)
    x0 = larger(x0 - more, domain.west)
    y0 = larger(y0 - more, domain.south)
    found = wp.vec2d()
    if x0 <= x1 and y0 <= y1:
        low, high = heights_over(domain, q, x0, y0, x1, y1)
        z0 = low * domain.height_scale + domain.height_offset
        z1 = high * domain.height_scale + domain.height_offset
        beside = ROUNDING * (wp.abs(z0) + wp.abs(z1))
        high_density, low_density = density_bounds(
            views,
            wp.vec3d(x0 - more, y0 - more, smaller(z0, z1) - beside),
            wp.vec3d(x1 + more, y1 + more, larger(z0, z1) + beside),
        )
        found = wp.vec2d(high_density, low_density)
    wanted[t] = found
