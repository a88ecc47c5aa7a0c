# SPDX-License-Identifier: GPL-3.0-or-later
"""The criterion, and pixel footprints: metres of height that a pixel spans on a diamond's box in each view.

Footprints are coarser outside the frustum and on hidden ground. Boxes are nested, and all functions are monotone, also
in rounded arithmetic: no footprint on a child's box is finer than on its parent's.

`low`, `high`: corners of a box, metres in terrain space. Range: distance from the eye in metres of camera space; in a
perspective the depth, or the distance times the smallest cosine in the frame if that is larger. Slant: fraction of a
height that the view sees. Gain: factor by which footprints of heights are coarser than those of edges.

Names that end in 2 are squared. `view.pixel2`: footprint at range 1, or everywhere in an orthographic view.
`view.max_gain2`: the largest gain. `criterion` has limits of the error in pixels and in metres, and of the longest edge
and twice the area in pixels (`error_px2`, `metres2`, `edge_px2`, `area_px2`); infinity switches one off.
"""

import warp as wp

from .diamond import Diamond, larger, smaller
from .hiding import Rings, covered, is_hidden
from .local_view import (
    ORTHOGRAPHIC,
    PERSPECTIVE,
    LocalView,
    fringe_at,
    max_inside,
    max_over_box,
    min_inside,
    min_over_box,
)


@wp.struct
class CriterionArrays:
    """The criterion: squared limits, of which infinity switches one off, and the views."""

    view_count: wp.int32
    measures_edges: wp.int32  # 1: edges or areas are limited
    error_px2: wp.float64  # error in pixels
    metres2: wp.float64  # error in metres
    edge_px2: wp.float64  # longest edge in pixels
    area_px2: wp.float64  # twice the area: squared legs of a right triangle
    limit: wp.float64  # factor on the limits above: 1, or more to meet a budget
    diagonal2: wp.float64  # squared length of a lattice unit's diagonal, the longer one, in camera space
    axis2: wp.float64  # squared length of a lattice unit's side, the longer one, in camera space
    view: LocalView  # the first view
    views: wp.array(dtype=LocalView)  # all of them
    slopes: wp.array(dtype=wp.float32)  # their horizons, see hiding.py


def unlimited() -> CriterionArrays:
    """Return a criterion without views and limits, which nothing exceeds."""
    criterion = CriterionArrays()
    criterion.error_px2 = criterion.metres2 = criterion.edge_px2 = criterion.area_px2 = wp.inf
    criterion.limit = 1.0
    return criterion


@wp.func
def sizes(criterion: CriterionArrays, unit_bits: wp.int32, depth: wp.int32):
    """Return the squared longest edge and twice the area of a horizontal triangle at `depth`, in camera space (metres).

    Twice the area is the squared legs. At an odd depth the legs are parallel to the axes, at an even one the longest
    edge is. unit_bits: a root square has 2^unit_bits lattice units a side. criterion.diagonal2, axis2: squared length
    of a lattice unit's diagonal and side in camera space.
    """
    side = wp.float64(wp.int32(1) << (unit_bits - ((depth - 1) >> 1)))
    side2 = side * side
    long2 = criterion.diagonal2 * side2
    legs2 = criterion.axis2 * side2
    if (depth & 1) == 0:
        long2 = legs2
        legs2 = criterion.diagonal2 * side2 * wp.float64(0.25)
    return long2, legs2


@wp.func
def range2_at(view: LocalView, dx: wp.float64, dy: wp.float64, dz: wp.float64, depth: wp.float64) -> wp.float64:
    """Return the squared range of a point: its distance from the eye, or its depth in a perspective, metres.

    dx, dy, dz: metres from the eye along each axis of terrain space; `view.weight` scales their squares to camera
    space. depth: the point's depth, metres. The squared distance counts as at least `view.near2`: nothing nearer is
    visible. In the frame a depth is at least the distance times the smallest cosine, whose square is `view.cosine2`.
    """
    range2 = view.weight[0] * (dx * dx) + view.weight[1] * (dy * dy) + view.weight[2] * (dz * dz)
    range2 = larger(range2, view.near2)
    if view.kind == PERSPECTIVE:
        ahead = larger(depth, wp.float64(0.0))
        range2 = larger(ahead * ahead, range2 * view.cosine2)
    return range2


@wp.func
def ends_of(row: wp.vec2d, low: wp.vec2d, high: wp.vec2d) -> wp.vec2d:
    """Return the smallest and the largest value of row . (x, y) in the rectangle with the corners low and high."""
    lower = smaller(row[0] * low[0], row[0] * high[0]) + smaller(row[1] * low[1], row[1] * high[1])
    upper = larger(row[0] * low[0], row[0] * high[0]) + larger(row[1] * low[1], row[1] * high[1])
    return wp.vec2d(lower, upper)


@wp.func
def sizes_of(ends: wp.vec2d) -> wp.vec2d:
    """Return the smallest and the largest absolute value of the numbers between ends[0] and ends[1]."""
    return wp.vec2d(larger(larger(ends[0], -ends[1]), wp.float64(0.0)), larger(ends[1], -ends[0]))


@wp.func
def slants2_of(slant_x: wp.vec2d, slant_y: wp.vec2d, eye: wp.vec3d, low: wp.vec3d, high: wp.vec3d) -> wp.vec2d:
    """Return the smallest and the largest (slant * depth / largest slant in the frame)^2 in a box.

    slant_x, slant_y: coefficients, from LocalView, of the two components of that product, which are linear in the
    offset from the eye. eye, low, high: metres.
    """
    low_corner = wp.vec2d(low[0] - eye[0], low[1] - eye[1])
    high_corner = wp.vec2d(high[0] - eye[0], high[1] - eye[1])
    # Smallest and largest magnitude of both components, across and along the view: `ends_of` has the extreme values in
    # the rectangle, `sizes_of` turns them to magnitudes.
    across = sizes_of(ends_of(slant_x, low_corner, high_corner))
    along = sizes_of(ends_of(slant_y, low_corner, high_corner))
    return wp.vec2d(across[0] * across[0] + along[0] * along[0], across[1] * across[1] + along[1] * along[1])


@wp.func
def gain2_at(view: LocalView, range2: wp.float64, slants2: wp.float64) -> wp.float64:
    """Return the squared factor by which footprints of heights are coarser than those of edges, at least 1.

    range2: squared range. slants2: squared product of slant and depth, over the frame's largest slant. A height e at
    depth z and slant s moves a point by f e s / z pixels, with the focal length f in pixels. s is clamped between the
    smallest slant that counts (the shading floor) and the largest in the frame.
    """
    return larger(smaller(range2 / slants2, view.max_gain2), wp.float64(1.0))


@wp.func
def min_range2(view: LocalView, low: wp.vec3d, high: wp.vec3d, min_depth: wp.float64) -> wp.float64:
    """Return the squared smallest range of a box: its distance from the eye, or its depth in a perspective, metres.

    min_depth: the smallest depth in the box, metres. The heights of the box may be off by `view.unsure` metres.
    """
    zero = wp.float64(0.0)
    dx = larger(larger(low[0] - view.eye[0], view.eye[0] - high[0]), zero)
    dy = larger(larger(low[1] - view.eye[1], view.eye[1] - high[1]), zero)
    dz = larger(larger(low[2] - view.eye[2], view.eye[2] - high[2]) - view.unsure, zero)
    return range2_at(view, dx, dy, dz, min_depth)


@wp.func
def max_range2(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return the squared largest range of a box: its distance from the eye, or its depth in a perspective, metres.

    The heights of the box may be off by `view.unsure` metres.
    """
    dx = larger(high[0] - view.eye[0], view.eye[0] - low[0])
    dy = larger(high[1] - view.eye[1], view.eye[1] - low[1])
    dz = larger(high[2] - view.eye[2], view.eye[2] - low[2]) + view.unsure
    return range2_at(view, dx, dy, dz, max_over_box(view.depth, low, high))


@wp.func
def nearest_pixel2(view: LocalView, low: wp.vec3d, high: wp.vec3d, min_depth: wp.float64):
    """Return the squared finest footprints of heights and of edges, metres, anywhere in a box, as if it was in view.

    min_depth: the smallest depth in the box, metres.
    """
    edge2 = view.pixel2
    gain2 = wp.float64(1.0)
    if view.kind != ORTHOGRAPHIC:
        range2 = min_range2(view, low, high, min_depth)
        edge2 = view.pixel2 * range2
        if view.max_gain2 > wp.float64(1.0):
            slants2 = slants2_of(view.slant_x, view.slant_y, view.eye, low, high)
            gain2 = gain2_at(view, range2, slants2[1])
    return edge2 * gain2, edge2


@wp.func
def farthest_pixel2(view: LocalView, d: Diamond):
    """Return the squared coarsest footprints of heights and of edges, metres, in boxes inside that of d, as in view."""
    edge2 = view.pixel2
    gain2 = wp.float64(1.0)
    if view.kind != ORTHOGRAPHIC:
        range2 = max_range2(view, d.low, d.high)
        edge2 = view.pixel2 * range2
        if view.max_gain2 > wp.float64(1.0):
            slants2 = slants2_of(view.slant_x, view.slant_y, view.eye, d.low, d.high)
            gain2 = gain2_at(view, range2, slants2[0])
    return edge2 * gain2, edge2


@wp.func
def cover_of(
    rings: Rings, ramp: wp.float64, slopes: wp.array(dtype=wp.float32), low: wp.vec3d, high: wp.vec3d
) -> wp.float64:
    """Return how far nearer ground hides a box, 0 .. 1: gradually over `ramp`, a slope, or at once if that is 0.

    low, high: the box, metres relative to the eye. slopes: the map of horizons, in which `rings` locates the view's.
    """
    fraction = wp.float64(0.0)
    if ramp > fraction:
        fraction = covered(rings, ramp, slopes, low, high)
    elif is_hidden(rings, slopes, low, high):
        fraction = wp.float64(1.0)
    return fraction


@wp.func
def hidden_factor2(hidden2: wp.float64, occlusion_fade: wp.float64, fraction: wp.float64) -> wp.float64:
    """Return the squared factor by which footprints are coarser where nearer ground hides a `fraction` (`cover_of`).

    The factor is (1 + occlusion_fade * fraction)^4. fraction: above 0, up to 1. hidden2: the squared factor of wholly
    hidden ground, which is not exceeded.
    """
    coarser2 = hidden2
    if fraction < wp.float64(1.0):
        factor = wp.float64(1.0) + occlusion_fade * fraction
        factor2 = factor * factor  # the footprint is factor^4 coarser
        factor4 = factor2 * factor2
        coarser2 = smaller(factor4 * factor4, coarser2)
    return coarser2


@wp.func
def faded2(view: LocalView, inner: wp.float64, depth: wp.float64) -> wp.float64:
    """Return the squared factor by which footprints are coarser outside the frustum, within and beyond its fringe.

    inner: metres inside the nearest plane, below 0. depth: metres. The factor falls as either of them rises, also in
    rounded arithmetic.
    """
    coarser2 = view.off_screen2
    outer = inner + fringe_at(view, depth)  # metres inside the fringe's outer border
    if outer > wp.float64(0.0):
        one = wp.float64(1.0)
        # 1 + fade * (-inner / width of the fringe), in a form that stays monotone when it is rounded.
        factor = one + view.fade / (one - outer / inner)
        factor2 = factor * factor  # the footprint is factor^4 coarser
        factor4 = factor2 * factor2
        coarser2 = smaller(factor4 * factor4, coarser2)
    return coarser2


@wp.func
def finest_in(view: LocalView, slopes: wp.array(dtype=wp.float32), d: Diamond, in_frame: wp.int32):
    """Compute the squared finest footprints of heights and of edges, metres, of a view on the box of diamond d.

    They are coarser off screen and on hidden ground. slopes: the map of horizons. in_frame: 1 if the frustum is known
    to contain the box.
    """
    zero = wp.float64(0.0)
    coarser2 = wp.float64(1.0)
    if in_frame == 0:
        inner = max_inside(view, d.low, d.high)
        if inner < zero:
            coarser2 = faded2(view, inner, max_over_box(view.depth, d.low, d.high))
    if view.rings.count > 0 and coarser2 < view.hidden2:  # hidden ground would be coarser
        hidden_fraction = cover_of(view.rings, view.ramp, slopes, d.low - view.eye, d.high - view.eye)
        if hidden_fraction > zero:
            coarser2 = larger(hidden_factor2(view.hidden2, view.occlusion_fade, hidden_fraction), coarser2)
    pixel2, edge2 = nearest_pixel2(view, d.low, d.high, min_over_box(view.depth, d.low, d.high))
    return pixel2 * coarser2, edge2 * coarser2


@wp.func
def coarsest_in(view: LocalView, d: Diamond, in_frame: wp.int32):
    """Compute the squared coarsest footprints of heights and of edges, metres, in any box inside that of diamond d.

    The third result is 1 if the frustum contains the box. in_frame: 1 if that is known, 0 to find out.
    """
    coarser2 = wp.float64(1.0)
    inside = wp.int32(1)
    if in_frame == 0:
        outer = min_inside(view, d.low, d.high)
        if outer < wp.float64(0.0):
            inside = 0
            coarser2 = faded2(view, outer, min_over_box(view.depth, d.low, d.high))
    if view.rings.count > 0:  # any box inside may be hidden
        coarser2 = larger(coarser2, view.hidden2)
    pixel2, edge2 = farthest_pixel2(view, d)
    return pixel2 * coarser2, edge2 * coarser2, inside


@wp.func
def finest(criterion: CriterionArrays, d: Diamond, in_frame: wp.int32):
    """Compute the squared finest footprints of heights and of edges, metres, of all views on the box of diamond d.

    They are infinite beyond the raster's border and without views. The first view is read from the struct, not from the
    array: most terrains have only one. in_frame: 1 if all frustums are known to contain the diamond's box.
    """
    pixel2 = wp.float64(wp.inf)
    edge2 = wp.float64(wp.inf)
    if criterion.view_count > 0 and d.border < 2:  # not beyond the raster's border
        pixel2, edge2 = finest_in(criterion.view, criterion.slopes, d, in_frame)
        for v in range(1, criterion.view_count):
            p2, e2 = finest_in(criterion.views[v], criterion.slopes, d, in_frame)
            pixel2 = smaller(pixel2, p2)
            edge2 = smaller(edge2, e2)
    return pixel2, edge2


@wp.func
def coarsest(criterion: CriterionArrays, d: Diamond, in_frame: wp.int32):
    """Return limits of the squared footprints of heights and of edges, metres, for all boxes inside that of d.

    `coarsest_in` gives the largest squared footprints of one view in such a box; these are the least of all views. The
    third result is 1 if the frustums of all views contain the diamond's box. in_frame: 1 if that is known, 0 to find
    out. Footprints are infinite without views, and for a diamond that extends beyond the raster's border: some of its
    descendants are wholly outside, so none is certain to be split.
    """
    pixel2 = wp.float64(wp.inf)
    edge2 = wp.float64(wp.inf)
    inside = wp.int32(1)
    if criterion.view_count > 0:
        pixel2, edge2, inside = coarsest_in(criterion.view, d, in_frame)
        for v in range(1, criterion.view_count):
            p2, e2, view_inside = coarsest_in(criterion.views[v], d, in_frame)
            pixel2 = smaller(pixel2, p2)
            edge2 = smaller(edge2, e2)
            inside = wp.min(inside, view_inside)
    if d.border > 0:  # it extends beyond the raster's border
        pixel2 = wp.float64(wp.inf)
        edge2 = wp.float64(wp.inf)
    return pixel2, edge2, inside


@wp.func
def ratio2_at(
    criterion: CriterionArrays,
    unit_bits: wp.int32,
    depth: wp.int32,
    pixel2: wp.float64,
    edge2: wp.float64,
    metres2: wp.float64,
    climb2: wp.float64,
) -> wp.float64:
    """Return the largest squared ratio of a diamond at `depth` to the criteria.

    unit_bits: a root square has 2^unit_bits lattice units a side. Floats are squared. pixel2, edge2: footprints of
    heights and of edges, metres. metres2: the error that the criterion compares, metres. climb2: height difference
    along the diamond's edges, metres.
    """
    largest = larger(metres2 / criterion.metres2, metres2 / (pixel2 * criterion.error_px2))
    if criterion.measures_edges == 1:
        long2, legs2 = sizes(criterion, unit_bits, depth)
        largest = larger((long2 + climb2) / (edge2 * criterion.edge_px2), largest)
        largest = larger((legs2 + climb2) / (edge2 * criterion.area_px2), largest)
    return largest


@wp.func
def too_coarse_at(
    criterion: CriterionArrays,
    limit: wp.float64,
    pixel2: wp.float64,
    edge2: wp.float64,
    metres2: wp.float64,
    long2: wp.float64,
    legs2: wp.float64,
):
    """Return whether a diamond exceeds the criterion times `limit`.

    All arguments are squared. pixel2, edge2: footprints of heights and of edges, metres. metres2: the error that the
    criterion compares, metres. long2, legs2: longest edge and twice the area, metres.
    """
    coarse = metres2 > limit * pixel2 * criterion.error_px2 or metres2 > limit * criterion.metres2
    limit_edge2 = limit * edge2
    return coarse or long2 > limit_edge2 * criterion.edge_px2 or legs2 > limit_edge2 * criterion.area_px2
