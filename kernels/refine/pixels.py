# SPDX-License-Identifier: GPL-3.0-or-later
"""The criterion, and pixel footprints: metres of height that a pixel spans on a diamond's box in each view.

Footprints are coarser outside the frustum and on hidden ground. Boxes are nested, and all functions are monotone, also
in rounded arithmetic: no footprint on a child's box is finer than on its parent's.
"""

import warp as wp

from .diamond import Diamond, larger, smaller
from .hiding import Rings, covered, is_hidden
from .local_view import ORTHOGRAPHIC, PERSPECTIVE, LocalView, fringe_at, max_inside, max_of, min_inside, min_of


@wp.struct
class CriterionArrays:
    """The criterion: squared limits; infinity switches one off."""

    view_count: wp.int32
    measures_edges: wp.int32
    error_px2: wp.float64
    metres2: wp.float64
    edge_px2: wp.float64
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
    """Return the squared longest edge and twice the area of a level triangle at `depth`, in camera space (metres)."""
    side = wp.float64(wp.int32(1) << (unit_bits - ((depth - 1) >> 1)))
    side2 = side * side
    long2 = criterion.diagonal2 * side2
    legs2 = criterion.axis2 * side2
    if (depth & 1) == 0:
        long2 = legs2
        legs2 = criterion.diagonal2 * side2 * wp.float64(0.25)
    return long2, legs2


@wp.func
def far2_at(view: LocalView, dx: wp.float64, dy: wp.float64, dz: wp.float64, deep: wp.float64) -> wp.float64:
    """Return the squared depth (perspective) or distance, metres of camera space, of a point.

    dx, dy, dz: metres from the eye. deep: its depth. In the frame a depth is at least the distance times a cosine.
    """
    far2 = view.weight[0] * (dx * dx) + view.weight[1] * (dy * dy) + view.weight[2] * (dz * dz)
    far2 = larger(far2, view.near2)
    if view.kind == PERSPECTIVE:
        ahead = larger(deep, wp.float64(0.0))
        far2 = larger(ahead * ahead, far2 * view.cosine2)
    return far2


@wp.func
def ends_of(row: wp.vec2d, low: wp.vec2d, high: wp.vec2d) -> wp.vec2d:
    """Return the smallest and the largest value of row . (x, y) in a rectangle."""
    lower = smaller(row[0] * low[0], row[0] * high[0]) + smaller(row[1] * low[1], row[1] * high[1])
    upper = larger(row[0] * low[0], row[0] * high[0]) + larger(row[1] * low[1], row[1] * high[1])
    return wp.vec2d(lower, upper)


@wp.func
def sizes_of(ends: wp.vec2d) -> wp.vec2d:
    """Return the smallest and the largest absolute value of numbers between two ends."""
    return wp.vec2d(larger(larger(ends[0], -ends[1]), wp.float64(0.0)), larger(ends[1], -ends[0]))


@wp.func
def slants2_of(slant_x: wp.vec2d, slant_y: wp.vec2d, eye: wp.vec3d, low: wp.vec3d, high: wp.vec3d) -> wp.vec2d:
    """Return the smallest and the largest squared slant times depth in a box, over the frame's largest slant."""
    near = wp.vec2d(low[0] - eye[0], low[1] - eye[1])
    far = wp.vec2d(high[0] - eye[0], high[1] - eye[1])
    x = sizes_of(ends_of(slant_x, near, far))
    y = sizes_of(ends_of(slant_y, near, far))
    return wp.vec2d(x[0] * x[0] + y[0] * y[0], x[1] * x[1] + y[1] * y[1])


@wp.func
def gain2_at(view: LocalView, far2: wp.float64, slants2: wp.float64) -> wp.float64:
    """Return the squared factor by which footprints of heights are coarser than those of edges.

    far2: squared depth or distance. slants2: squared product of slant and depth. A height e at depth z and slant s
    moves a point by f e s / z pixels. s is clamped to the shading floor and to the largest slant in the frame.
    """
    return larger(smaller(far2 / slants2, view.max_gain2), wp.float64(1.0))


@wp.func
def nearest_far2(view: LocalView, low: wp.vec3d, high: wp.vec3d, deep: wp.float64) -> wp.float64:
    """Return the smallest squared distance from the eye to a box; of a perspective the squared depth.

    deep: smallest depth in the box.
    """
    zero = wp.float64(0.0)
    dx = larger(larger(low[0] - view.eye[0], view.eye[0] - high[0]), zero)
    dy = larger(larger(low[1] - view.eye[1], view.eye[1] - high[1]), zero)
    dz = larger(larger(low[2] - view.eye[2], view.eye[2] - high[2]) - view.unsure, zero)
    return far2_at(view, dx, dy, dz, deep)


@wp.func
def farthest_far2(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return the largest squared depth (perspective) or distance in a box, metres of camera space: see `far2_at`.

    `view.unsure`: metres by which heights in the box may be off.
    """
    dx = larger(high[0] - view.eye[0], view.eye[0] - low[0])
    dy = larger(high[1] - view.eye[1], view.eye[1] - low[1])
    dz = larger(high[2] - view.eye[2], view.eye[2] - low[2]) + view.unsure
    return far2_at(view, dx, dy, dz, max_of(view.depth, low, high))


@wp.func
def nearest_pixel2(view: LocalView, low: wp.vec3d, high: wp.vec3d, deep: wp.float64):
    """Return the squared finest footprints of heights and of edges anywhere in a box, metres.

    deep: its smallest depth.
    """
    edge2 = view.pixel2
    gain2 = wp.float64(1.0)
    if view.kind != ORTHOGRAPHIC:
        far2 = nearest_far2(view, low, high, deep)
        edge2 = view.pixel2 * far2
        if view.max_gain2 > wp.float64(1.0):
            slants2 = slants2_of(view.slant_x, view.slant_y, view.eye, low, high)
            gain2 = gain2_at(view, far2, slants2[1])
    return edge2 * gain2, edge2


@wp.func
def farthest_pixel2(view: LocalView, d: Diamond):
    """Return the squared coarsest footprints of heights and of edges in any box inside this one, metres."""
    edge2 = view.pixel2
    gain2 = wp.float64(1.0)
    if view.kind != ORTHOGRAPHIC:
        far2 = farthest_far2(view, d.low, d.high)
        edge2 = view.pixel2 * far2
        if view.max_gain2 > wp.float64(1.0):
            slants2 = slants2_of(view.slant_x, view.slant_y, view.eye, d.low, d.high)
            gain2 = gain2_at(view, far2, slants2[0])
    return edge2 * gain2, edge2


@wp.func
def cover_of(
    rings: Rings, ramp: wp.float64, slopes: wp.array(dtype=wp.float32), low: wp.vec3d, high: wp.vec3d
) -> wp.float64:
    """Return how much nearer ground hides a box, 0 .. 1; with a ramp it grows gradually.

    low, high: of the box, metres from the eye. slopes: map of horizons.
    """
    part = wp.float64(0.0)
    if ramp > part:
        part = covered(rings, ramp, slopes, low, high)
    elif is_hidden(rings, slopes, low, high):
        part = wp.float64(1.0)
    return part


@wp.func
def hidden_factor2(hidden2: wp.float64, occlusion_fade: wp.float64, part: wp.float64) -> wp.float64:
    """Return the squared factor by which footprints are coarser on ground that is hidden to the degree `part`, above 0.

    hidden2: the factor of wholly hidden ground, squared. occlusion_fade: see LocalView.
    """
    coarser2 = hidden2
    if part < wp.float64(1.0):
        factor = wp.float64(1.0) + occlusion_fade * part
        factor2 = factor * factor
        factor4 = factor2 * factor2
        coarser2 = smaller(factor4 * factor4, coarser2)
    return coarser2


@wp.func
def faded2(view: LocalView, inner: wp.float64, deep: wp.float64) -> wp.float64:
    """Return the squared factor by which footprints are coarser outside the frustum, within and beyond its fringe.

    inner: metres inside the nearest plane, below 0. deep: depth, metres. The factor falls as either of them rises, also
    in rounded arithmetic.
    """
    coarser2 = view.off_screen2
    outer = inner + fringe_at(view, deep)
    if outer > wp.float64(0.0):
        one = wp.float64(1.0)
        factor = one + view.fade / (one - outer / inner)
        factor2 = factor * factor
        factor4 = factor2 * factor2
        coarser2 = smaller(factor4 * factor4, coarser2)
    return coarser2


@wp.func
def finest_in(view: LocalView, slopes: wp.array(dtype=wp.float32), d: Diamond, in_frame: wp.int32):
    """Compute the squared finest footprints of heights and of edges, metres, of a view on a box.

    They are coarser off screen and on hidden ground. in_frame: 1 if the frustum is known to contain the box.
    """
    zero = wp.float64(0.0)
    coarser2 = wp.float64(1.0)
    if in_frame == 0:
        inner = max_inside(view, d.low, d.high)
        if inner < zero:
            coarser2 = faded2(view, inner, max_of(view.depth, d.low, d.high))
    if view.rings.count > 0 and coarser2 < view.hidden2:
        part = cover_of(view.rings, view.ramp, slopes, d.low - view.eye, d.high - view.eye)
        if part > zero:
            coarser2 = larger(hidden_factor2(view.hidden2, view.occlusion_fade, part), coarser2)
    pixel2, edge2 = nearest_pixel2(view, d.low, d.high, min_of(view.depth, d.low, d.high))
    return pixel2 * coarser2, edge2 * coarser2


@wp.func
def coarsest_in(view: LocalView, d: Diamond, in_frame: wp.int32):
    """Compute the squared coarsest footprints of heights and of edges, metres, in any box inside this one.

    The third result is 1 if the frustum contains the box.
    """
    coarser2 = wp.float64(1.0)
    inside = wp.int32(1)
    if in_frame == 0:
        outer = min_inside(view, d.low, d.high)
        if outer < wp.float64(0.0):
            inside = 0
            coarser2 = faded2(view, outer, min_of(view.depth, d.low, d.high))
    if view.rings.count > 0:
        coarser2 = larger(coarser2, view.hidden2)
    pixel2, edge2 = farthest_pixel2(view, d)
    return pixel2 * coarser2, edge2 * coarser2, inside


@wp.func
def finest(criterion: CriterionArrays, d: Diamond, in_frame: wp.int32):
    """Compute the squared finest footprints of heights and of edges, metres, of all views on a diamond.

    They are infinite beyond the raster's border. The first view is read from the struct, not from the array: most
    terrains have only one.
    """
    pixel2 = wp.float64(wp.inf)
    edge2 = wp.float64(wp.inf)
    if criterion.view_count > 0 and d.border < 2:
        pixel2, edge2 = finest_in(criterion.view, criterion.slopes, d, in_frame)
        for v in range(1, criterion.view_count):
            p2, e2 = finest_in(criterion.views[v], criterion.slopes, d, in_frame)
            pixel2 = smaller(pixel2, p2)
            edge2 = smaller(edge2, e2)
    return pixel2, edge2


@wp.func
def coarsest(criterion: CriterionArrays, d: Diamond, in_frame: wp.int32):
    """Compute the minima of `coarsest_in` over all views; and 1 if the frustums of all views contain the diamond.

    They are infinite for a diamond that extends beyond the raster's border: some of its descendants are wholly outside,
    so none is certain to be split.
    """
    pixel2 = wp.float64(wp.inf)
    edge2 = wp.float64(wp.inf)
    inside = wp.int32(1)
    if criterion.view_count > 0:
        pixel2, edge2, inside = coarsest_in(criterion.view, d, in_frame)
        for v in range(1, criterion.view_count):
            p2, e2, also = coarsest_in(criterion.views[v], d, in_frame)
            pixel2 = smaller(pixel2, p2)
            edge2 = smaller(edge2, e2)
            inside = wp.min(inside, also)
    if d.border > 0:
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

    All arguments are squared. pixel2, edge2: footprints of heights and of edges, metres. metres2: weighed error.
    climb2: height difference along its edges, metres.
    """
    found = larger(metres2 / criterion.metres2, metres2 / (pixel2 * criterion.error_px2))
    if criterion.measures_edges == 1:
        long2, legs2 = sizes(criterion, unit_bits, depth)
        found = larger((long2 + climb2) / (edge2 * criterion.edge_px2), found)
        found = larger((legs2 + climb2) / (edge2 * criterion.area_px2), found)
    return found


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

    All arguments are squared. pixel2, edge2: footprints of heights and of edges, metres. metres2: weighed error.
    long2, legs2: longest edge and twice the area.
    """
    coarse = metres2 > limit * pixel2 * criterion.error_px2 or metres2 > limit * criterion.metres2
    px2 = limit * edge2
    return coarse or long2 > px2 * criterion.edge_px2 or legs2 > px2 * criterion.area_px2
