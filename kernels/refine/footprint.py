# SPDX-License-Identifier: GPL-3.0-or-later
"""Diamonds on level ground, where only edge lengths ask: a look at the footprint, without heights, decides most.

A pixel's span on a diamond grows with the distance of its box from the eye, and the heights around it say between
which two distances that lies. Where both decide alike, which is nearly everywhere, so would measuring; margins are far
above rounding. Spans are squared here, and in units of the span of a pixel at unit depth (a panorama's at unit
distance).
"""

import warp as wp

from .diamond import ORTHOGRAPHIC, PERSPECTIVE, Asked, Domain, larger, reach_of, sizes, smaller

wp.set_module_options({"enable_backward": False})

SURE = wp.constant(wp.float64(1.0 + 1e-5))


@wp.struct
class Plan:
    """The view over the lattice, from above."""

    usable: wp.int32  # 1: one view that is not orthographic asks for edges or areas, and not too near to the eye
    perspective: wp.int32
    x: wp.float64  # the eye, lattice units
    y: wp.float64
    weight_x: wp.float64  # squared metres of camera space per squared lattice unit
    weight_y: wp.float64
    depth_x: wp.float64  # metres of depth per lattice unit
    depth_y: wp.float64
    depth: wp.float64  # metres of depth at lattice coordinates (0, 0) and no height
    cosine2: wp.float64  # see LocalView
    near2: wp.float64


@wp.struct
class Heights:
    """What heights between two add: the least and the most."""

    least2: wp.float64  # to squared distances, metres of camera space
    most2: wp.float64
    least_depth: wp.float64  # to depths, metres
    most_depth: wp.float64


@wp.func
def plan_of(domain: Domain, asked: Asked, max_depth: wp.int32) -> Plan:
    """The first view's."""
    view = asked.view
    p = Plan()
    p.x = (view.eye[0] - domain.west) / domain.unit_x
    p.y = (view.eye[1] - domain.south) / domain.unit_y
    p.weight_x = view.weight[0] * domain.unit_x * domain.unit_x
    p.weight_y = view.weight[1] * domain.unit_y * domain.unit_y
    p.near2 = view.near2
    if view.kind == PERSPECTIVE:
        p.perspective = 1
        p.depth_x = view.depth[0] * domain.unit_x
        p.depth_y = view.depth[1] * domain.unit_y
        p.depth = view.depth[3] + view.depth[0] * domain.west + view.depth[1] * domain.south
        p.cosine2 = view.cosine2
    # Where splits end so near to the eye that rounding could be more than the margins, everything is measured: less
    # than a lattice unit away, or than a part of what depths are made of.
    long2, legs2 = sizes(asked, domain.unit_bits, max_depth)
    end2 = larger(long2 / asked.edge_px2, legs2 / asked.area_px2) / (asked.limit * view.pixel2)
    unit2 = larger(larger(p.weight_x, p.weight_y), larger(p.depth_x * p.depth_x, p.depth_y * p.depth_y))
    far = wp.float64(1e-9) * view.depth[3]
    one = asked.view_count == 1 and view.kind != ORTHOGRAPHIC
    one = one and wp.min(domain.east, domain.north) == 2147483647  # no padding
    p.usable = wp.int32(one and asked.measures_edges == 1 and end2 > unit2 and end2 > far * far)
    return p


@wp.func
def heights_between(asked: Asked, p: Plan, low: wp.float64, high: wp.float64) -> Heights:
    """low, high: metres."""
    view = asked.view
    h = Heights()
    near = larger(larger(low - view.eye[2], view.eye[2] - high), wp.float64(0.0))
    far = larger(high - view.eye[2], view.eye[2] - low)
    h.least2 = view.weight[2] * near * near
    h.most2 = view.weight[2] * far * far
    h.least_depth = p.depth + smaller(view.depth[2] * low, view.depth[2] * high)
    h.most_depth = p.depth + larger(view.depth[2] * low, view.depth[2] * high)
    return h


@wp.func
def put_limits(
    domain: Domain,
    asked: Asked,
    longest_px2: wp.float64,
    largest_px2: wp.float64,
    max_depth: wp.int32,
    limits: wp.array(dtype=wp.vec3d),
    first: wp.int32,
) -> wp.float64:
    """For diamonds of each depth: how far they reach, lattice units; up to which span level ones are split; and from
    which on they are not, and no new maxima besides longest_px2 and largest_px2.

    Returns what every squared metre that edges climb adds to the last.
    """
    per_px2 = wp.float64(1.0) / asked.view.pixel2
    per_edge = per_px2 / (asked.limit * asked.edge_px2)
    per_area = per_px2 / (asked.limit * asked.area_px2)
    per_longest = per_px2 / longest_px2
    per_largest = per_px2 / largest_px2
    for depth in range(1, max_depth + 1):
        long2, legs2 = sizes(asked, domain.unit_bits, depth)
        split_up_to = larger(long2 * per_edge, legs2 * per_area)
        leaf_from = larger(long2 * per_longest, legs2 * per_largest)
        if depth < max_depth:
            leaf_from = larger(leaf_from, split_up_to)
        else:
            split_up_to = wp.float64(0.0)
        reach = wp.float64(reach_of(domain.unit_bits, depth))
        limits[first + depth] = wp.vec3d(reach, split_up_to / SURE, leaf_from * SURE)
    return larger(larger(per_edge, per_area), larger(per_longest, per_largest)) * SURE


@wp.func
def spans(p: Plan, h: Heights, x: wp.int32, y: wp.int32, reach: wp.float64):
    """Between which the finest pixel's span lies on the diamond split at (x, y)."""
    zero = wp.float64(0.0)
    fx = wp.float64(x)
    fy = wp.float64(y)
    dx = larger(wp.abs(fx - p.x) - reach, zero)
    dy = larger(wp.abs(fy - p.y) - reach, zero)
    plan2 = p.weight_x * dx * dx + p.weight_y * dy * dy
    least = larger(plan2 + h.least2, p.near2)
    most = larger(plan2 + h.most2, p.near2)
    if p.perspective == 1:
        ahead = p.depth_x * fx + p.depth_y * fy - (wp.abs(p.depth_x) + wp.abs(p.depth_y)) * reach
        near = larger(h.least_depth + ahead, zero)
        far = larger(h.most_depth + ahead, zero)
        least = larger(near * near, least * p.cosine2)
        most = larger(far * far, most * p.cosine2)
    return least, most


@wp.func
def most_below(p: Plan, h: Heights, x: wp.int32, y: wp.int32, reach: wp.float64) -> wp.float64:
    """The most that a pixel spans on the diamond split at (x, y) or any below it."""
    fx = wp.float64(x)
    fy = wp.float64(y)
    dx = wp.abs(fx - p.x) + reach
    dy = wp.abs(fy - p.y) + reach
    most = larger(p.weight_x * dx * dx + p.weight_y * dy * dy + h.most2, p.near2)
    if p.perspective == 1:
        ahead = p.depth_x * fx + p.depth_y * fy + (wp.abs(p.depth_x) + wp.abs(p.depth_y)) * reach
        far = larger(h.most_depth + ahead, wp.float64(0.0))
        most = larger(far * far, most * p.cosine2)
    return most
