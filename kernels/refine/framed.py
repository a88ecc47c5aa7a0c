# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a leaf can be in the frame: the part of the ground that a bound in pixels speaks of.

A diamond is refined for its whole box, which must be nested. Its leaves are smaller, and one that reaches from under
the camera into the frame is seen no nearer than where it enters.
"""

import warp as wp

from .diamond import PERSPECTIVE, Asked, Diamond, Domain, LocalView, finest_in, larger, smaller

wp.set_module_options({"enable_backward": False})

# Relative; far above what rounding does to a sum of a few terms.
MARGIN = wp.constant(wp.float64(1e-12))
NESTED = wp.constant(wp.float64(1e-13))  # of heights, for each bisection; rounding is a thousandth of it


@wp.func
def patch_at(domain: Domain, i: wp.int32, j: wp.int32) -> wp.vec4f:
    """Heights at the corners of raster cell (i, j): south-west, south-east, north-west, north-east."""
    south = wp.int64(j) * wp.int64(domain.width) + wp.int64(i)
    north = south + wp.int64(domain.width)
    one = wp.int64(1)
    samples = domain.samples
    return wp.vec4f(samples[south], samples[south + one], samples[north], samples[north + one])


@wp.func
def height_in(domain: Domain, p: wp.vec4f, x: wp.int32, y: wp.int32) -> wp.float64:
    """Height of a bilinear patch, x and y lattice units from its south-west corner."""
    part = wp.float64(1.0) / wp.float64(wp.int32(1) << (domain.unit_bits - domain.levels))
    s = wp.float64(x) * part
    t = wp.float64(y) * part
    one = wp.float64(1.0)
    south = wp.float64(p[0]) * (one - s) + wp.float64(p[1]) * s
    north = wp.float64(p[2]) * (one - s) + wp.float64(p[3]) * s
    return south * (one - t) + north * t


@wp.func
def heights_between(domain: Domain, x0: wp.int32, y0: wp.int32, x1: wp.int32, y1: wp.int32):
    """Lowest and highest metres, before scaling, of the bilinear surface over a rectangle of the lattice.

    In each cell they are at corners of what the rectangle has of it.
    """
    bits = domain.unit_bits - domain.levels
    low = wp.float64(wp.inf)
    high = wp.float64(-wp.inf)
    for j in range(wp.max(y0, 0) >> bits, wp.min((y1 - 1) >> bits, domain.height - 2) + 1):
        y = j << bits
        south = wp.max(y0, y) - y
        north = wp.min(y1 - y, wp.int32(1) << bits)
        for i in range(wp.max(x0, 0) >> bits, wp.min((x1 - 1) >> bits, domain.width - 2) + 1):
            x = i << bits
            west = wp.max(x0, x) - x
            east = wp.min(x1 - x, wp.int32(1) << bits)
            p = patch_at(domain, i, j)
            a = height_in(domain, p, west, south)
            b = height_in(domain, p, east, south)
            c = height_in(domain, p, west, north)
            d = height_in(domain, p, east, north)
            low = smaller(smaller(a, b), smaller(smaller(c, d), low))
            high = larger(larger(a, b), larger(larger(c, d), high))
    return low, high


@wp.func
def box_between(
    domain: Domain, d: Diamond, x0: wp.int32, y0: wp.int32, x1: wp.int32, y1: wp.int32, depth: wp.int32
) -> Diamond:
    """The part of a diamond's box that is over a rectangle of the lattice. Inside the raster's cells it has the heights
    that a bilinear surface has there."""
    box = Diamond()
    low = d.low[2]
    high = d.high[2]
    if depth > 2 * domain.levels and domain.bicubic == 0:
        least, most = heights_between(domain, x0, y0, x1, y1)
        z0 = least * domain.height_scale + domain.height_offset
        z1 = most * domain.height_scale + domain.height_offset
        # Margins shrink from depth to depth by more than rounding can do to the heights of the surface.
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
def least_depth(view: LocalView, d: Diamond) -> wp.float64:
    """Metres of depth that whatever is in the box and in the frustum has at least.

    Linear programming with one plane of the frustum at a time: for any multiplier that is not negative, the least of
    depth less multiplier times distance from the plane, over the box, is a lower bound (weak duality). It is greatest
    where the multiplier cancels a coordinate.
    """
    found = wp.float64(-wp.inf)
    for p in range(view.plane_count):
        plane = view.planes[p]
        for axis in range(3):
            multiplier = view.depth[axis] / plane[axis]
            if multiplier > wp.float64(0.0) and multiplier < wp.float64(wp.inf):
                least = view.depth[3] - multiplier * plane[3]
                size = wp.abs(view.depth[3]) + wp.abs(multiplier * plane[3])
                for k in range(3):
                    reach = larger(wp.abs(d.low[k]), wp.abs(d.high[k]))
                    size += (wp.abs(view.depth[k]) + wp.abs(multiplier * plane[k])) * reach
                    if k != axis:
                        factor = view.depth[k] - multiplier * plane[k]
                        least += smaller(factor * d.low[k], factor * d.high[k])
                found = larger(found, least - MARGIN * size)
    return found


@wp.func
def finest_framed_in(view: LocalView, d: Diamond, clear: wp.int32) -> wp.float64:
    """As `finest_in`, of what may be in the frustum where a part of the box is."""
    pixel2 = finest_in(view, d, clear)
    if clear == 0 and view.kind == PERSPECTIVE:
        ahead = least_depth(view, d)
        if ahead > wp.float64(0.0):
            pixel2 = larger(pixel2, view.pixel2 * (ahead * ahead))
    return pixel2


@wp.func
def finest_framed(
    domain: Domain,
    asked: Asked,
    d: Diamond,
    left: wp.vec2i,
    right: wp.vec2i,
    depth: wp.int32,
    clear: wp.int32,
) -> wp.float64:
    """Squared metres of the finest pixel that any view has on what it sees of the two triangles at the longest edge
    from left to right, the diamond's.

    Both triangles fill a cell, or one each side of an edge along an axis, which may be on the terrain's border. Of a
    triangle's box, not the diamond's, what is below it has no more. `clear`: the frustum is known to hold the diamond.
    """
    x0 = wp.min(left[0], right[0])
    x1 = wp.max(left[0], right[0])
    y0 = wp.min(left[1], right[1])
    y1 = wp.max(left[1], right[1])
    half_x = wp.where(x0 == x1, (y1 - y0) >> 1, 0)
    half_y = wp.where(y0 == y1, (x1 - x0) >> 1, 0)
    pixel2 = wp.float64(wp.inf)
    for side in range(wp.where(half_x + half_y > 0, 2, 1)):
        west = x0 - (1 - side) * half_x
        south = y0 - (1 - side) * half_y
        east = x1 + side * half_x
        north = y1 + side * half_y
        inside = east <= domain.columns << domain.unit_bits and north <= domain.rows << domain.unit_bits
        inside = inside and west < domain.east and south < domain.north
        if west >= 0 and south >= 0 and inside:
            box = box_between(domain, d, west, south, east, north, depth)
            pixel2 = smaller(finest_framed_in(asked.view, box, clear), pixel2)
            for v in range(1, asked.view_count):
                pixel2 = smaller(finest_framed_in(asked.views[v], box, clear), pixel2)
    return pixel2
