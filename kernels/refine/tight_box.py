# SPDX-License-Identifier: GPL-3.0-or-later
"""The tight box of a triangle, and the pixel footprints on the part of it in view.

Refinement judges a diamond by its whole box, which contains the boxes of its neighbours' children, too. The search for
the excess uses a tighter box: that of the triangle alone, inside the raster's cells with the heights that the surface
has there, and clipped to the frame: a triangle that extends from below the camera into the frame counts from where it
enters.
"""

import warp as wp

from ..field.codes import bilinear, corners_of
from ..field.domain import Domain
from ..field.finer import limits_over
from .diamond import Diamond, larger, smaller
from .local_view import CROSSED, OUTSIDE, PERSPECTIVE, LocalView, classify_box, min_over_box
from .pixels import farthest_pixel2, nearest_pixel2

# A part of a leaf is small enough if squared pixel footprints differ by less than the first factor in it; at the
# frame's sides, where it may be out of view, by less than the second.
NEARLY_EQUAL = wp.constant(wp.float64(1.2))
NEARLY_EQUAL_CROSSED = wp.constant(wp.float64(1.02))
# Relative; far above what rounding does to a sum of a few terms.
MARGIN = wp.constant(wp.float64(1e-12))
NESTED = wp.constant(wp.float64(1e-13))  # of heights, for each bisection; rounding is a thousandth of it


@wp.func
def heights_between(domain: Domain, x0: wp.int32, y0: wp.int32, x1: wp.int32, y1: wp.int32):
    """Return the lowest and highest metres, before scaling, of the bilinear surface over (x0, y0) .. (x1, y1).

    The rectangle is in lattice units. In each cell the extremes are at corners of the intersection of cell and
    rectangle. The result is (infinity, -infinity) beyond the raster's border.
    """
    bits = domain.unit_bits - domain.levels
    per_unit = wp.float64(1.0) / wp.float64(wp.int32(1) << bits)  # exact: a power of two
    low = wp.float64(wp.inf)
    high = wp.float64(-wp.inf)
    for j in range(wp.max(y0, 0) >> bits, wp.min((y1 - 1) >> bits, domain.samples.rows - 2) + 1):
        y = j << bits
        south = wp.float64(wp.max(y0, y) - y) * per_unit
        north = wp.float64(wp.min(y1 - y, wp.int32(1) << bits)) * per_unit
        for i in range(wp.max(x0, 0) >> bits, wp.min((x1 - 1) >> bits, domain.samples.columns - 2) + 1):
            x = i << bits
            west = wp.float64(wp.max(x0, x) - x) * per_unit
            east = wp.float64(wp.min(x1 - x, wp.int32(1) << bits)) * per_unit
            corners = corners_of(domain.samples, i, j)
            a = bilinear(corners, west, south)
            b = bilinear(corners, east, south)
            c = bilinear(corners, west, north)
            d = bilinear(corners, east, north)
            low = smaller(smaller(a, b), smaller(smaller(c, d), low))
            high = larger(larger(a, b), larger(larger(c, d), high))
    return low, high


@wp.func
def box_between(
    domain: Domain, d: Diamond, x0: wp.int32, y0: wp.int32, x1: wp.int32, y1: wp.int32, depth: wp.int32
) -> Diamond:
    """Return the part of a diamond's box over the lattice rectangle (x0, y0) .. (x1, y1).

    Inside a bilinear cell it has the surface's heights there, with a bound of the displacement. d: the diamond; of the
    result only the box is set. depth: the diamond's depth.
    """
    box = Diamond()
    low = d.low[2]
    high = d.high[2]
    if depth > 2 * domain.levels and domain.bicubic == 0:  # inside a bilinear cell
        min_height, max_height = heights_between(domain, x0, y0, x1, y1)
        displacement = domain.max_detail
        if domain.has_finer == 1:  # plus the largest change by finer tiles
            shift = domain.unit_bits - domain.levels - domain.finer[0].bits
            log2_width = domain.unit_bits - ((depth - 1) >> 1)  # a triangle is at most one side of its square wide
            displacement += wp.float64(limits_over(domain.finer[0], x0, y0, x1, y1, shift, log2_width)[0])
        min_height -= displacement
        max_height += displacement
        z0 = min_height * domain.height_scale + domain.height_offset
        z1 = max_height * domain.height_scale + domain.height_offset
        # For nested boxes, margins shrink with each depth by more than rounding can do to the heights of the surface.
        margin = domain.rounding + NESTED * wp.float64(64 - depth) * larger(wp.abs(z0), wp.abs(z1))
        low = larger(low, smaller(z0, z1) - margin)
        high = smaller(high, larger(z0, z1) + margin)
    west = domain.west + wp.float64(x0) * domain.unit_x
    south = domain.south + wp.float64(y0) * domain.unit_y
    box.low = wp.vec3d(west, south, low)
    east = domain.west + wp.float64(x1) * domain.unit_x
    north = domain.south + wp.float64(y1) * domain.unit_y
    box.high = wp.vec3d(east, north, high)
    return box


@wp.func
def min_depth_in(view: LocalView, d: Diamond) -> wp.float64:
    """Return a lower bound of the depth, metres, of all points in the box of d and in the frustum.

    This is linear programming with one frustum plane at a time. For any multiplier >= 0, the minimum over the box of
    depth - multiplier * (distance from the plane) is a lower bound (weak duality). The bound is largest if the
    multiplier cancels a coordinate. The result is -infinity if no multiplier does.
    """
    largest = wp.float64(-wp.inf)
    for p in range(view.plane_count):
        plane = view.planes[p]
        for axis in range(3):
            multiplier = view.depth[axis] / plane[axis]
            if multiplier > wp.float64(0.0) and multiplier < wp.float64(wp.inf):
                bound = view.depth[3] - multiplier * plane[3]
                # Sum of the terms' magnitudes, which bounds the rounding of `bound`.
                magnitude = wp.abs(view.depth[3]) + wp.abs(multiplier * plane[3])
                for k in range(3):
                    reach = larger(wp.abs(d.low[k]), wp.abs(d.high[k]))
                    magnitude += (wp.abs(view.depth[k]) + wp.abs(multiplier * plane[k])) * reach
                    if k != axis:
                        factor = view.depth[k] - multiplier * plane[k]
                        bound += smaller(factor * d.low[k], factor * d.high[k])
                largest = larger(largest, bound - MARGIN * magnitude)
    return largest


@wp.func
def finest_seen_in(view: LocalView, d: Diamond, of_edges: wp.bool):
    """Return the squared finest and coarsest pixel footprint, metres, on the part of the box of d that is in view.

    of_edges: whether footprints of edges are measured, or those of heights. Out of view they are infinity and 0. The
    caller takes footprints as equal if the coarsest is below NEARLY_EQUAL times the finest. For a box that the
    frustum's border crosses it must be below NEARLY_EQUAL_CROSSED times that, so there the coarsest is scaled up.
    """
    pixel2 = wp.float64(wp.inf)
    coarse2 = wp.float64(0.0)
    frustum_class = classify_box(view, d.low, d.high, wp.float64(0.0))
    if frustum_class != OUTSIDE:
        min_depth = min_over_box(view.depth, d.low, d.high)
        if view.kind == PERSPECTIVE:
            min_depth = larger(min_depth_in(view, d), min_depth)
        pixel2, edge2 = nearest_pixel2(view, d.low, d.high, min_depth)
        coarse2, coarse_edge2 = farthest_pixel2(view, d)
        if of_edges:
            pixel2 = edge2
            coarse2 = coarse_edge2
        if frustum_class == CROSSED:
            coarse2 = coarse2 * NEARLY_EQUAL / NEARLY_EQUAL_CROSSED
    return pixel2, coarse2
