# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a leaf can be in the frame: the part of the ground that a bound in pixels speaks of.

A diamond is refined for its whole box, which must be nested. Its leaves are smaller, and one that reaches from under
the camera into the frame is seen no nearer than where it enters.
"""

import warp as wp

from .criterion import PERSPECTIVE, Asked, Diamond, Domain, LocalView, finest_in, larger, smaller

wp.set_module_options({"enable_backward": False})

# Relative; far above what rounding does to a sum of a few terms.
MARGIN = wp.constant(wp.float64(1e-12))


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
def triangles_box(domain: Domain, d: Diamond, x: wp.int32, y: wp.int32, depth: wp.int32) -> Diamond:
    """The box of the diamond's two triangles alone, inside `d`, that of all below it. Inside the raster's cells with
    the heights that a bilinear surface has there."""
    half = wp.int32(1) << (domain.unit_bits - ((depth - 1) >> 1) - 1)
    low = d.low[2]
    high = d.high[2]
    if depth > 2 * domain.levels and domain.bicubic == 0:
        least, most = heights_between(domain, x - half, y - half, x + half, y + half)
        z0 = least * domain.height_scale + domain.height_offset
        z1 = most * domain.height_scale + domain.height_offset
        low = larger(low, smaller(z0, z1) - domain.rounding)
        high = smaller(high, larger(z0, z1) + domain.rounding)
    tight = Diamond()
    west = domain.west + wp.float64(x - half) * domain.unit_x
    east = domain.west + wp.float64(x + half) * domain.unit_x
    tight.low = wp.vec3d(west, domain.south + wp.float64(y - half) * domain.unit_y, low)
    tight.high = wp.vec3d(east, domain.south + wp.float64(y + half) * domain.unit_y, high)
    return tight


@wp.func
def least_depth(view: LocalView, d: Diamond, off: wp.float64) -> wp.float64:
    """Metres of depth that whatever is in the box, and `off` metres of height from the frustum at most, has at least.

    Linear programming with one plane of the frustum at a time: for any multiplier that is not negative, the least of
    depth less multiplier times distance from the plane, over the box, is a lower bound (weak duality). It is greatest
    where the multiplier cancels a coordinate.
    """
    found = wp.float64(-wp.inf)
    for p in range(view.plane_count):
        plane = view.planes[p]
        offset = plane[3] + wp.abs(plane[2]) * off
        for axis in range(3):
            multiplier = view.depth[axis] / plane[axis]
            if multiplier > wp.float64(0.0) and multiplier < wp.float64(wp.inf):
                least = view.depth[3] - multiplier * offset
                size = wp.abs(view.depth[3]) + wp.abs(multiplier * offset)
                for k in range(3):
                    if k != axis:
                        factor = view.depth[k] - multiplier * plane[k]
                        reach = larger(wp.abs(d.low[k]), wp.abs(d.high[k]))
                        least += smaller(factor * d.low[k], factor * d.high[k])
                        size += (wp.abs(view.depth[k]) + wp.abs(multiplier * plane[k])) * reach
                found = larger(found, least - MARGIN * size)
    return found


@wp.func
def finest_framed_in(view: LocalView, d: Diamond, off: wp.float64) -> wp.float64:
    """As `finest_in`, of what may be in the frustum where a part of the box is."""
    pixel2 = finest_in(view, d, 0)
    if view.kind == PERSPECTIVE:
        ahead = least_depth(view, d, off)
        if ahead > wp.float64(0.0):
            pixel2 = larger(pixel2, view.pixel2 * (ahead * ahead))
    return pixel2


@wp.func
def finest_framed(asked: Asked, d: Diamond, off: wp.float64) -> wp.float64:
    """Squared metres of the finest pixel that any view has on what it sees of the surface in the box; true heights may
    be `off` metres from it."""
    pixel2 = wp.float64(wp.inf)
    if asked.view_count > 0:
        pixel2 = finest_framed_in(asked.view, d, off)
        for v in range(1, asked.view_count):
            pixel2 = smaller(pixel2, finest_framed_in(asked.views[v], d, off))
    return pixel2
