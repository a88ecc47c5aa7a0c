# SPDX-License-Identifier: GPL-3.0-or-later
"""How much too coarse a diamond is: its error, its box, and what a view makes of them.

A diamond is known by its split vertex (x, y in lattice units) and its depth inside a root square. Its box covers every
vertex that can come below it, so the children's boxes lie inside it; heights of the box and its error are saturated the
same way. All that is done with them below is monotone, also in rounded arithmetic, so a child never exceeds a parent.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

# Layout of one view's row of float64 numbers.
KIND = wp.constant(0)  # 0 perspective, 1 orthographic, 2 panoramic
EYE = wp.constant(1)  # 3: the eye in the terrain's space, metres
WEIGHT = wp.constant(4)  # 3: squared metres of camera space per squared metre along each axis
DEPTH = wp.constant(7)  # 4: depth along the view = DEPTH . (x, y, z, 1)
PIXELS = wp.constant(11)  # pixels per unit tangent, per metre or per radian
SECANT = wp.constant(12)  # largest distance over depth inside the frame
NEAR = wp.constant(13)  # squared distance below which nothing is seen
VERTICAL = wp.constant(14)  # squared metres of camera space per squared metre of height
DIAGONAL = wp.constant(15)  # squared length of a lattice unit's diagonal, the longer one, in camera space
AXIS = wp.constant(16)  # squared length of a lattice unit's side, the longer one, in camera space
OFF_SCREEN = wp.constant(17)  # what the squared measures of a box outside the frustum are multiplied by
PLANES = wp.constant(18)  # number of planes
PLANE = wp.constant(19)  # 4 each: positive towards the frustum, in the terrain's space
VIEW_NUMBERS = wp.constant(19 + 4 * 6)


@wp.struct
class Domain:
    """The height field, its lattice and its place, as the walk reads them."""

    columns: wp.int32
    rows: wp.int32
    levels: wp.int32  # a root square has 2**levels raster cells a side
    unit_bits: wp.int32  # and 2**unit_bits lattice units
    width: wp.int32  # samples in a row
    height: wp.int32
    unit_x: wp.float64  # metres of a lattice unit
    unit_y: wp.float64
    west: wp.float64  # metres, x of lattice coordinate 0
    south: wp.float64
    height_scale: wp.float64
    height_offset: wp.float64
    range_base: wp.float64
    range_step: wp.float64
    extra_error: wp.float64  # metres, before scaling: what resampling at import has moved
    offsets: wp.array(dtype=wp.int64)
    error: wp.array(dtype=wp.float32)
    ranges: wp.array(dtype=wp.uint16)
    samples: wp.array(dtype=wp.float32)


@wp.struct
class Asked:
    """What is asked, as factors that make every squared measure 1 at the limit; 0 is off."""

    view_count: wp.int32
    measures_edges: wp.int32
    error: wp.float64
    edge: wp.float64
    area: wp.float64
    vertical: wp.float64
    limit: wp.float64  # above this a diamond is split: 1, or more to meet a budget
    views: wp.array(dtype=wp.float64)


@wp.func
def cell_error(domain: Domain, i: wp.int32, j: wp.int32) -> wp.float64:
    """Saturated error of the diamond in the middle of raster cell (i, j): the last level that is stored."""
    e = wp.float64(0.0)
    row = domain.columns << domain.levels
    if i >= 0 and j >= 0 and i < row and j < (domain.rows << domain.levels):
        e = wp.float64(domain.error[domain.offsets[2 * domain.levels + 1] + wp.int64(j) * wp.int64(row) + wp.int64(i)])
    return e


@wp.func
def node(domain: Domain, x: wp.int32, y: wp.int32, depth: wp.int32):
    """Error in metres, heights and half-width (lattice units) of the box of the diamond split at (x, y)."""
    half = (depth - 1) >> 1
    odd = depth & 1
    s = wp.int32(1) << (domain.unit_bits - half - 1)  # half a side of the cell, or half the edge
    # Offsets to the vertices below add up to 3 s from a cell's centre and 2 s from an edge's middle, in each axis.
    reach = 2 * s + odd * s
    error = wp.float64(0.0)
    low = wp.float64(0.0)
    high = wp.float64(0.0)
    if depth <= 2 * domain.levels:
        index = wp.int64(0)
        if odd == 1:
            shift = domain.unit_bits - half
            index = wp.int64(y >> shift) * wp.int64(domain.columns << half) + wp.int64(x >> shift)
        else:
            shift = domain.unit_bits - half - 1
            index = wp.int64(y >> shift) * wp.int64((domain.columns << half) + 1) + wp.int64(x >> (shift + 1))
        index += domain.offsets[depth]
        error = wp.float64(domain.error[index])
        low = domain.range_base + wp.float64(domain.ranges[index + index]) * domain.range_step
        high = domain.range_base + wp.float64(domain.ranges[index + index + wp.int64(1)]) * domain.range_step
    else:
        bits = domain.unit_bits - domain.levels
        i = x >> bits
        j = y >> bits
        error = cell_error(domain, i, j)
        finer = half - domain.levels
        if odd == 0:
            # the middle of an edge that two raster cells share
            if (i << bits) == x:
                error = wp.max(error, cell_error(domain, i - 1, j))
            if (j << bits) == y:
                error = wp.max(error, cell_error(domain, i, j - 1))
            finer += 1
        # A bilinear patch halved has a quarter of the twist.
        error = error / wp.float64(wp.int64(1) << wp.int64(2 * finer))
        i0 = wp.max((x - reach) >> bits, 0)
        j0 = wp.max((y - reach) >> bits, 0)
        ahead = (wp.int32(1) << bits) - 1
        i1 = wp.min((x + reach + ahead) >> bits, domain.width - 1)
        j1 = wp.min((y + reach + ahead) >> bits, domain.height - 1)
        first = domain.samples[wp.int64(j0) * wp.int64(domain.width) + wp.int64(i0)]
        least = first
        most = first
        for b in range(j0, j1 + 1):
            row = wp.int64(b) * wp.int64(domain.width)
            for a in range(i0, i1 + 1):
                h = domain.samples[row + wp.int64(a)]
                least = wp.min(least, h)
                most = wp.max(most, h)
        low = wp.float64(least)
        high = wp.float64(most)
    return error, low, high, reach


@wp.func
def measure(domain: Domain, asked: Asked, x: wp.int32, y: wp.int32, depth: wp.int32):
    """What the views make of the diamond split at (x, y).

    Returns squared pixels of geometric error, the same with what resampling moved, squared pixels of the longest edge,
    square pixels of area, and metres of vertical error; each the largest of all views.
    """
    error, low, high, reach = node(domain, x, y, depth)
    error_px2 = wp.float64(0.0)
    total_px2 = wp.float64(0.0)
    edge_px2 = wp.float64(0.0)
    area_px2 = wp.float64(0.0)
    scale = wp.abs(domain.height_scale)
    if asked.view_count > 0:
        x0 = domain.west + wp.float64(x - reach) * domain.unit_x
        x1 = domain.west + wp.float64(x + reach) * domain.unit_x
        y0 = domain.south + wp.float64(y - reach) * domain.unit_y
        y1 = domain.south + wp.float64(y + reach) * domain.unit_y
        z0 = low * domain.height_scale + domain.height_offset
        z1 = high * domain.height_scale + domain.height_offset
        if domain.height_scale < wp.float64(0.0):
            t = z0
            z0 = z1
            z1 = t
        e = error * scale
        total = (error + domain.extra_error) * scale
        for v in range(asked.view_count):
            o = v * VIEW_NUMBERS
            views = asked.views
            # Squared distance of camera space from the eye to the box.
            zero = wp.float64(0.0)
            dx = wp.max(wp.max(x0 - views[o + EYE], views[o + EYE] - x1), zero)
            dy = wp.max(wp.max(y0 - views[o + EYE + 1], views[o + EYE + 1] - y1), zero)
            dz = wp.max(wp.max(z0 - views[o + EYE + 2], views[o + EYE + 2] - z1), zero)
            far2 = views[o + WEIGHT] * (dx * dx) + views[o + WEIGHT + 1] * (dy * dy) + views[o + WEIGHT + 2] * (dz * dz)
            far2 = wp.max(far2, views[o + NEAR])
            # Pixels per metre: a segment of length e seen at depth z and distance d moves by at most f e d / z^2.
            per2 = views[o + PIXELS] * views[o + PIXELS]
            if views[o + KIND] == zero:
                deep = views[o + DEPTH + 3]
                deep += wp.min(views[o + DEPTH] * x0, views[o + DEPTH] * x1)
                deep += wp.min(views[o + DEPTH + 1] * y0, views[o + DEPTH + 1] * y1)
                deep += wp.min(views[o + DEPTH + 2] * z0, views[o + DEPTH + 2] * z1)
                deep = wp.max(deep, zero)
                secant2 = views[o + SECANT] * views[o + SECANT]
                per2 = per2 * secant2 / wp.max(deep * deep, far2 / secant2)
            elif views[o + KIND] == wp.float64(2.0):
                per2 = per2 / far2
            # Outside one of the frustum's planes?
            for p in range(wp.int32(views[o + PLANES])):
                q = o + PLANE + 4 * p
                side = views[q + 3] + wp.max(views[q] * x0, views[q] * x1)
                side += wp.max(views[q + 1] * y0, views[q + 1] * y1)
                side += wp.max(views[q + 2] * z0, views[q + 2] * z1)
                if side < zero:
                    per2 = per2 * views[o + OFF_SCREEN]
                    break
            vertical = views[o + VERTICAL]
            error_px2 = wp.max(error_px2, per2 * (vertical * (e * e)))
            total_px2 = wp.max(total_px2, per2 * (vertical * (total * total)))
            if asked.measures_edges == 1:
                half = (depth - 1) >> 1
                s = wp.float64(wp.int32(1) << (domain.unit_bits - half))  # side of the cell, or the edge
                long2 = views[o + DIAGONAL] * (s * s)
                legs2 = views[o + AXIS] * (s * s)
                if (depth & 1) == 0:
                    long2 = views[o + AXIS] * (s * s)
                    legs2 = views[o + DIAGONAL] * (s * s) * wp.float64(0.25)
                rise = z1 - z0
                if depth > 2 * domain.levels:
                    # Inside a bilinear patch heights change in proportion to |dx| + |dy|.
                    part = wp.float64(wp.int64(1) << wp.int64(half - domain.levels))
                    rise = rise * wp.min(wp.float64(1 + (depth & 1)) / part, wp.float64(1.0))
                edge_px2 = wp.max(edge_px2, per2 * (long2 + vertical * (rise * rise)))
                area_px2 = wp.max(area_px2, per2 * (legs2 + vertical * (rise * rise)) * wp.float64(0.5))
    return error_px2, total_px2, edge_px2, area_px2, error * scale


@wp.func
def excess(asked: Asked, error_px2: wp.float64, edge_px2: wp.float64, area_px2: wp.float64, metres: wp.float64):
    """The measures over what was asked, squared: criteria combine by max."""
    r = wp.max(error_px2 * asked.error, metres * metres * asked.vertical)
    return wp.max(r, wp.max(edge_px2 * asked.edge, area_px2 * asked.area))
