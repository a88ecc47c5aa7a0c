# SPDX-License-Identifier: GPL-3.0-or-later
"""The densities of views over squares of the plan, whose boxes come from the stored ranges of heights.

`q`: the size and position of the squares, and the ranges that are read for them: of lattice cells of q.cell_x by
q.cell_y metres, at least as large as a square; `q.low` and `q.high` are the range of the whole surface.
"""

import warp as wp

from ..field.domain import Domain
from ..field.layout import Depth, entry, stored_entry
from ..refine.diamond import larger, smaller
from ..unchecked import item_at
from .seen import Views, density_bounds

# Relative to the largest coordinate, more than the rounding of positions to float32 and to the lattice.
ROUNDING = wp.constant(wp.float64(1e-6))


@wp.struct
class ScatterSquares:
    """Squares of one size, by column and row, and the stored ranges from which their heights come."""

    west: wp.float64  # south-west corner of square (0, 0), metres
    south: wp.float64
    side: wp.float64  # of a square, metres
    ranges: Depth  # height ranges of lattice cells at least as large as a square; no columns: `low` and `high` hold
    cell_x: wp.float64  # size of these cells, metres
    cell_y: wp.float64
    low: wp.float64  # lowest and highest height of the surface with displacement, metres before scaling
    high: wp.float64


@wp.func
def heights_over(domain: Domain, q: ScatterSquares, x0: wp.float64, y0: wp.float64, x1: wp.float64, y1: wp.float64):
    """Return bounds of the height, lower and upper, in a rectangle of at most a square's size, metres before scaling.

    Displacement is included. x0 .. y1: sides of the rectangle inside the raster, metres.
    """
    low = q.low  # of the whole surface, if no cells with stored ranges are as large as a square
    high = q.high
    if q.ranges.columns > 0:
        low = wp.float64(wp.inf)
        high = -low
        i1 = wp.min(wp.int32((x1 - domain.west) / q.cell_x), q.ranges.columns - 1)
        j1 = wp.min(wp.int32((y1 - domain.south) / q.cell_y), q.ranges.rows - 1)
        for j in range(wp.min(wp.int32((y0 - domain.south) / q.cell_y), j1), j1 + 1):
            for i in range(wp.min(wp.int32((x0 - domain.west) / q.cell_x), i1), i1 + 1):
                index = wp.int64(2) * stored_entry(domain.range_places, entry(q.ranges, i, j))
                low = smaller(low, wp.float64(item_at(domain.ranges, index)))
                high = larger(high, wp.float64(item_at(domain.ranges, index + wp.int64(1))))
        low = domain.range_base + low * domain.range_step - domain.max_change
        high = domain.range_base + high * domain.range_step + domain.max_change
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
    """Write to `wanted` bounds (upper, lower) of the density of points that views want in square numbers[offset + tid].

    They are 0 outside the raster. east, north: border of the raster, metres. numbers: column and row of each square.
    """
    k = offset + wp.tid()
    margin = ROUNDING * (wp.abs(east) + wp.abs(domain.west) + wp.abs(north) + wp.abs(domain.south))
    x0 = q.west + wp.float64(numbers[k][0]) * q.side
    y0 = q.south + wp.float64(numbers[k][1]) * q.side
    x1 = smaller(x0 + q.side + margin, east)
    y1 = smaller(y0 + q.side + margin, north)
    x0 = larger(x0 - margin, domain.west)
    y0 = larger(y0 - margin, domain.south)
    bounds = wp.vec2d()
    if x0 <= x1 and y0 <= y1:  # it meets the raster
        low, high = heights_over(domain, q, x0, y0, x1, y1)
        z0 = low * domain.height_scale + domain.height_offset
        z1 = high * domain.height_scale + domain.height_offset
        height_margin = ROUNDING * (wp.abs(z0) + wp.abs(z1))
        high_density, low_density = density_bounds(
            views,
            wp.vec3d(x0 - margin, y0 - margin, smaller(z0, z1) - height_margin),
            wp.vec3d(x1 + margin, y1 + margin, larger(z0, z1) + height_margin),
        )
        bounds = wp.vec2d(high_density, low_density)
    wanted[k] = bounds
