# SPDX-License-Identifier: GPL-3.0-or-later
"""How much too coarse a diamond is: its error, its box, and what a view makes of them.

A diamond is known by its split vertex (x, y in lattice units) and its depth inside a root square. Its box covers every
vertex that can come below it, so the children's boxes lie inside it; heights of the box and its error are saturated the
same way. All that is done with them below is monotone, also in rounded arithmetic, so a child never exceeds a parent.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

PERSPECTIVE = wp.constant(0)
ORTHOGRAPHIC = wp.constant(1)
PANORAMIC = wp.constant(2)
MAX_PLANES = wp.constant(6)
planes_type = wp.types.matrix(shape=(6, 4), dtype=wp.float64)


@wp.struct
class LocalView:
    """A view from the terrain's own space."""

    kind: wp.int32
    plane_count: wp.int32
    eye: wp.vec3d  # metres
    weight: wp.vec3d  # squared metres of camera space per squared metre along each axis
    depth: wp.vec4d  # depth along the view = depth . (x, y, z, 1), metres
    pixels2: wp.float64  # squared pixels per unit tangent, per metre or per radian
    secant2: wp.float64  # squared largest distance over depth inside the frame
    cosine2: wp.float64  # its inverse
    near2: wp.float64  # squared distance below which nothing is seen
    vertical2: wp.float64  # squared metres of camera space per squared metre of height
    diagonal2: wp.float64  # squared length of a lattice unit's diagonal, the longer one, in camera space
    axis2: wp.float64  # squared length of a lattice unit's side, the longer one, in camera space
    off_screen2: wp.float64  # what the squared measures of a box outside the frustum are multiplied by
    planes: planes_type  # positive towards the frustum


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
    view: LocalView  # the first view
    views: wp.array(dtype=LocalView)  # all of them


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
def excess(asked: Asked, error_px2: wp.float64, edge_px2: wp.float64, area_px2: wp.float64, metres: wp.float64):
    """The measures over what was asked, squared: criteria combine by max."""
    r = wp.max(error_px2 * asked.error, metres * metres * asked.vertical)
    return wp.max(r, wp.max(edge_px2 * asked.edge, area_px2 * asked.area))


@wp.struct
class Diamond:
    """What a view needs to know of a diamond."""

    low: wp.vec3d  # its box, metres of the terrain's space
    high: wp.vec3d
    error: wp.float64  # metres, as the criterion weighs it
    total: wp.float64  # metres, all of it
    odd: wp.int32  # 1: its longest edge is a cell's diagonal, 0: a side
    side2: wp.float64  # squared lattice units of that cell's side, or of the edge
    rise: wp.float64  # metres, the most that an edge of it can climb


@wp.func
def measure_in(view: LocalView, asked: Asked, d: Diamond):
    """Squared pixels of weighed error, of all error and of the longest edge, square pixels of area."""
    zero = wp.float64(0.0)
    # Squared distance of camera space from the eye to the box.
    dx = wp.max(wp.max(d.low[0] - view.eye[0], view.eye[0] - d.high[0]), zero)
    dy = wp.max(wp.max(d.low[1] - view.eye[1], view.eye[1] - d.high[1]), zero)
    dz = wp.max(wp.max(d.low[2] - view.eye[2], view.eye[2] - d.high[2]), zero)
    far2 = view.weight[0] * (dx * dx) + view.weight[1] * (dy * dy) + view.weight[2] * (dz * dz)
    far2 = wp.max(far2, view.near2)
    # Squared pixels per metre: a segment of length e at depth z and distance d moves by at most f e d / z^2.
    per2 = view.pixels2
    if view.kind == PERSPECTIVE:
        deep = view.depth[3] + wp.min(view.depth[0] * d.low[0], view.depth[0] * d.high[0])
        deep += wp.min(view.depth[1] * d.low[1], view.depth[1] * d.high[1])
        deep += wp.min(view.depth[2] * d.low[2], view.depth[2] * d.high[2])
        deep = wp.max(deep, zero)
        per2 = per2 * view.secant2 / wp.max(deep * deep, far2 * view.cosine2)
    elif view.kind == PANORAMIC:
        per2 = per2 / far2
    error_px2 = per2 * (view.vertical2 * (d.error * d.error))
    total_px2 = per2 * (view.vertical2 * (d.total * d.total))
    edge_px2 = zero
    area_px2 = zero
    if asked.measures_edges == 1:
        long2 = view.diagonal2 * d.side2
        legs2 = view.axis2 * d.side2
        if d.odd == 0:
            long2 = legs2
            legs2 = view.diagonal2 * d.side2 * wp.float64(0.25)
        rise2 = view.vertical2 * (d.rise * d.rise)
        edge_px2 = per2 * (long2 + rise2)
        area_px2 = per2 * (legs2 + rise2) * wp.float64(0.5)
    # Outside one of the frustum's planes? It matters only where the diamond would be split.
    if excess(asked, error_px2, edge_px2, area_px2, zero) > asked.limit:
        for p in range(view.plane_count):
            plane = view.planes[p]
            side = plane[3] + wp.max(plane[0] * d.low[0], plane[0] * d.high[0])
            side += wp.max(plane[1] * d.low[1], plane[1] * d.high[1])
            side += wp.max(plane[2] * d.low[2], plane[2] * d.high[2])
            if side < zero:
                error_px2 *= view.off_screen2
                total_px2 *= view.off_screen2
                edge_px2 *= view.off_screen2
                area_px2 *= view.off_screen2
                break
    return error_px2, total_px2, edge_px2, area_px2


@wp.func
def measure(domain: Domain, asked: Asked, x: wp.int32, y: wp.int32, depth: wp.int32):
    """What the views make of the diamond split at (x, y).

    Returns squared pixels of weighed error and of all error, squared pixels of the longest edge, square pixels of area,
    and metres of both errors; each the largest of all views.

    All error is the diamond's own and what resampling moved. The second part cannot be refined away: where it alone
    comes near what was asked, the weighed error asks for a quarter of that from the first, and no more.
    """
    error, low, high, reach = node(domain, x, y, depth)
    scale = wp.abs(domain.height_scale)
    total = (error + domain.extra_error) * scale
    weighed = wp.min(total, wp.float64(4.0) * error * scale)
    error_px2 = wp.float64(0.0)
    total_px2 = wp.float64(0.0)
    edge_px2 = wp.float64(0.0)
    area_px2 = wp.float64(0.0)
    if asked.view_count > 0:
        d = Diamond()
        z0 = low * domain.height_scale + domain.height_offset
        z1 = high * domain.height_scale + domain.height_offset
        d.low = wp.vec3d(
            domain.west + wp.float64(x - reach) * domain.unit_x,
            domain.south + wp.float64(y - reach) * domain.unit_y,
            wp.min(z0, z1),
        )
        d.high = wp.vec3d(
            domain.west + wp.float64(x + reach) * domain.unit_x,
            domain.south + wp.float64(y + reach) * domain.unit_y,
            wp.max(z0, z1),
        )
        d.error = weighed
        d.total = total
        half = (depth - 1) >> 1
        d.odd = depth & 1
        side = wp.float64(wp.int32(1) << (domain.unit_bits - half))
        d.side2 = side * side
        d.rise = d.high[2] - d.low[2]
        if depth > 2 * domain.levels:
            # Inside a bilinear patch heights change in proportion to |dx| + |dy|.
            part = wp.float64(wp.int64(1) << wp.int64(half - domain.levels))
            d.rise = d.rise * wp.min(wp.float64(1 + d.odd) / part, wp.float64(1.0))
        # The first view is at hand; further ones are looked up.
        error_px2, total_px2, edge_px2, area_px2 = measure_in(asked.view, asked, d)
        for v in range(1, asked.view_count):
            e2, t2, l2, a2 = measure_in(asked.views[v], asked, d)
            error_px2 = wp.max(error_px2, e2)
            total_px2 = wp.max(total_px2, t2)
            edge_px2 = wp.max(edge_px2, l2)
            area_px2 = wp.max(area_px2, a2)
    return error_px2, total_px2, edge_px2, area_px2, weighed, total
