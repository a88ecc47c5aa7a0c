# SPDX-License-Identifier: GPL-3.0-or-later
"""Lowest and highest heights of a box, metres after vertical scaling.

`height_ranges`: stored ranges of heights, and bounds of the curvature of a bicubic surface.
"""

import warp as wp

from ..field.codes import bilinear, corners_of
from ..field.finer import finer_corners
from ..field.layout import tile_index
from .crossing import HeightRanges, cell_curvature, range_at
from .surface import QueriedSurface, finer_cell, finer_tile, is_ground


@wp.func
def heights_in(surface: QueriedSurface, p: wp.vec4d, s0: wp.float64, t0: wp.float64, s1: wp.float64, t1: wp.float64):
    """Return the lowest and highest height, metres after scaling, of a part of the bilinear patch with the corners p.

    p: metres before scaling. s0, t0, s1, t1: the part's west, south, east and north side, 0 .. 1 of the patch.
    Displacement is not included.
    """
    z = wp.vec4d(bilinear(p, s0, t0), bilinear(p, s1, t0), bilinear(p, s0, t1), bilinear(p, s1, t1)) * surface.scale
    return wp.min(z) + surface.offset, wp.max(z) + surface.offset


@wp.func
def distance_from_corners(surface: QueriedSurface, height_ranges: HeightRanges, i: wp.int32, j: wp.int32) -> wp.float64:
    """Bound the distance, metres, of the surface from the bilinear one between finer samples of raster cell (i, j).

    It is 0 for a bilinear surface. Of a bicubic one it is at most (|f_xx| + |f_yy|) h^2 / 8 for finer cells of the side
    h, and it includes the displacement.
    """
    bound = wp.float64(0.0)
    if surface.bicubic == 1:
        finer_per_cell = wp.float64(wp.int64(1) << wp.int64(2 * surface.finer[0].bits))
        # A quarter of the norm of the second derivatives is not less than the sum over 8.
        bound = (
            cell_curvature(height_ranges, i, j) / finer_per_cell * wp.abs(surface.scale) + height_ranges.widening
        )  # the displacement
    return bound


@wp.kernel
def row_ranges(
    offset: int,
    surface: QueriedSurface,
    height_ranges: HeightRanges,
    first_column: int,
    first_row: int,
    west: wp.float64,
    south: wp.float64,
    east: wp.float64,
    north: wp.float64,
    found: wp.array(dtype=wp.vec2d),
):
    """Write to found[offset + tid] the lowest and highest height in row first_row + offset + tid of cells, in a box.

    They are metres after scaling, and (infinity, -infinity) without ground. west, south, east, north: sides of the box
    in cells from the raster's corner. first_column: first cell of the row. Holes do not count. A bilinear surface is
    exact and without displacement, which the caller adds; a bicubic one has the stored ranges of whole cells, or those
    of finer cells with a bound of its distance from them, displacement included.
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
        if is_ground(surface, i, j, wp.bool(False), wp.bool(False)):  # not on the cell's western or southern side
            tile = finer_tile(surface, i, j)
            s0 = wp.clamp(west - wp.float64(i), zero, one)
            s1 = wp.clamp(east - wp.float64(i), zero, one)
            if tile >= 0:
                x0, u0 = finer_cell(surface, i, s0)
                x1, u1 = finer_cell(surface, i, s1)
                y0, v0 = finer_cell(surface, j, t0)
                y1, v1 = finer_cell(surface, j, t1)
                off = distance_from_corners(surface, height_ranges, i, j)
                for y in range(y0, y1 + 1):
                    for x in range(x0, x1 + 1):
                        p = finer_corners(surface.finer[0], tile, x, y)
                        part_low, part_high = heights_in(
                            surface,
                            p,
                            wp.where(x == x0, u0, zero),
                            wp.where(y == y0, v0, zero),
                            wp.where(x == x1, u1, one),
                            wp.where(y == y1, v1, one),
                        )
                        low = wp.min(low, part_low - off)
                        high = wp.max(high, part_high + off)
            elif surface.bicubic == 1:
                part_low, part_high = range_at(
                    height_ranges, height_ranges.cells + tile_index(i, j, height_ranges.cell_pages)
                )
                low = wp.min(low, part_low)
                high = wp.max(high, part_high)
            else:
                part_low, part_high = heights_in(surface, corners_of(surface.samples, i, j), s0, t0, s1, t1)
                low = wp.min(low, part_low)
                high = wp.max(high, part_high)
        i += 1
    found[n] = wp.vec2d(low, high)
