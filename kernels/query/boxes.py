# SPDX-License-Identifier: GPL-3.0-or-later
"""Lowest and highest heights of a box, metres after vertical scaling."""

import warp as wp

from ..field.codes import bilinear, corners_of
from ..field.layout import tile_index
from .crossing import HeightRanges, range_at
from .surface import QueriedSurface, is_ground


@wp.kernel
def row_ranges(
    offset: int,
    surface: QueriedSurface,
    blocks: HeightRanges,
    first_column: int,
    first_row: int,
    west: wp.float64,
    south: wp.float64,
    east: wp.float64,
    north: wp.float64,
    found: wp.array(dtype=wp.vec2d),
):
    """Write the lowest and highest height (metres) in row first_row + offset + tid of cells, inside a box.

    west .. north: sides of the box in cells from the raster's corner. Holes do not count.
    """
    n = offset + wp.tid()
    j = first_row + n
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    t0 = wp.clamp(south - wp.float64(j), zero, one)
    t1 = wp.clamp(north - wp.float64(j), zero, one)
    low = wp.float64(wp.inf)
    high = -wp.float64(wp.inf)
    i = first_column
    while i < surface.samples.columns - 1 and wp.float64(i) <= east:
        if is_ground(surface, i, j, wp.bool(False), wp.bool(False)):
            if surface.bicubic == 1:
                a, b = range_at(blocks, blocks.cells + tile_index(i, j, blocks.cell_pages))
                low = wp.min(low, a)
                high = wp.max(high, b)
            else:
                s0 = wp.clamp(west - wp.float64(i), zero, one)
                s1 = wp.clamp(east - wp.float64(i), zero, one)
                p = corners_of(surface.samples, i, j)
                z = wp.vec4d(bilinear(p, s0, t0), bilinear(p, s1, t0), bilinear(p, s0, t1), bilinear(p, s1, t1))
                z = z * surface.scale
                low = wp.min(low, wp.min(z) + surface.offset)
                high = wp.max(high, wp.max(z) + surface.offset)
        i += 1
    found[n] = wp.vec2d(low, high)
