# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame coherence: cached subtrees, and a test whether they are still valid after the camera has moved.

Every decision below a triangle compares a pixel footprint with a number that does not depend on the camera. So a cached
subtree stores two margins: by how much footprints may fall or rise before a decision changes (as the deferred priority
lists of ROAM; Duchaineau et al. 1997). While the margins last, the next frame copies the subtree's leaves. The mesh is
the same as without a cache.

`motion`: the movement of the view since the last frame. `low`, `high`: corners of a box, metres in terrain space.
Slant: fraction of a height that the view sees, here over the frame's largest. Slant times depth is the length of a
vector whose two components are linear in the position: `slant_x` and `slant_y` are their rows of coefficients. Gain:
factor by which footprints of heights are coarser than those of edges. `view.depth` and `view.planes` have the
coefficients of the depth and of the distance inside each frustum plane; the fringe is a zone beyond the planes over
which footprints become coarser gradually. Camera space: terrain space scaled as the camera sees it; `view.weight`
scales squared offsets.
"""

import warp as wp

from .diamond import larger, smaller
from .local_view import (
    CLEAR,
    CROSSED,
    ORTHOGRAPHIC,
    OUTSIDE,
    PERSPECTIVE,
    LocalView,
    classify_box_steadily,
    fringe_at,
    max_over_box,
    min_over_box,
    planes_type,
)
from .pixels import CriterionArrays, ends_of, max_range2, min_range2, sizes_of, slants2_of

NEAR = wp.constant(wp.float64(1.01))  # factor on the squared near distance, which covers the largest `Motion.drift`
FADED = wp.constant(2)  # class of a subtree of which a part or all is in the fringe of the frustum
ROUNDED = wp.constant(wp.float64(1e-9))  # relative: far above what rounding does to footprints


@wp.struct
class Subtree:
    """The cached leaves below a triangle, and the margins of pixel footprints within which they are valid."""

    cell: wp.uint64  # first deepest cell, all squares in a row
    depth: wp.int32
    frustum_class: wp.int32  # in the frustum, outside or across its fringe: CLEAR, OUTSIDE or FADED
    leaves: wp.int32
    vertices: wp.int32  # new ones
    edges: wp.int32
    first_leaf: wp.int64  # entries in the arrays of the walk
    first_vertex: wp.int64
    low: wp.vec3d  # the box of all its diamonds, metres in terrain space
    high: wp.vec3d
    fine: wp.float64  # finest pixel footprint on any of their boxes, metres
    coarse: wp.float64  # coarsest one
    fall: wp.float64  # margin, metres: footprints may shrink by less than this
    rise: wp.float64  # ... and grow by less than this
    stopped: wp.int32  # 1: one of its leaves is too coarse at the depth limit


@wp.struct
class Motion:
    """The movement of the view since the last frame, which has cached all subtrees or updated their margins."""

    eye: wp.vec3d  # before, as in LocalView
    depth: wp.vec4d
    planes: planes_type
    step: wp.float64  # metres of camera space that the eye has moved
    slant_x: wp.vec2d  # before, as in LocalView
    slant_y: wp.vec2d
    max_gain2: wp.float64
    ratio: wp.float64  # footprint at unit depth over the one before
    drift: wp.float64  # fraction by which the lengths in footprints, and those compared with them, may have changed


@wp.func
def camera_length(view: LocalView, v: wp.vec3d) -> wp.float64:
    """Return the length of a vector of terrain space in camera space, metres."""
    return wp.sqrt(view.weight[0] * (v[0] * v[0]) + view.weight[1] * (v[1] * v[1]) + view.weight[2] * (v[2] * v[2]))


@wp.func
def change_of(view: LocalView, motion: Motion, low: wp.vec3d, high: wp.vec3d):
    """Return (lower, upper, valid): bounds of the growth of depth or distance since the last frame, metres.

    They hold in any box inside low .. high (metres). valid: 0 if an eye is near the box or in it, else 1. motion:
    movement of the view since the last frame. The view is not orthographic. A panorama's footprint is proportional to
    the least distance in a box, a perspective's to the larger of two values: the least depth, and the least distance
    times a cosine. The change of depth is linear in the position. The change of distance is |p - b| - |p - a| at a
    point p, for the eyes a before and b now. Per metre of p it varies by at most 2 |a - b| / (|p - a| + |p - b|).
    """
    half = wp.float64(0.5)
    centre = half * (low + high)
    # The box as a sphere; its heights may be off by `unsure`.
    reach = half * (high - low) + wp.vec3d(wp.float64(0.0), wp.float64(0.0), view.unsure)
    radius = camera_length(view, reach)
    before = camera_length(view, centre - motion.eye)
    now = camera_length(view, centre - view.eye)
    apart = before + now - wp.float64(2.0) * radius  # at most |p - a| + |p - b| for any point of it
    nearest = smaller(before, now) - radius
    valid = wp.int32(1)
    if nearest <= radius or nearest * nearest <= NEAR * view.near2:  # an eye is near the box or in it
        valid = 0
    spread = wp.float64(2.0) * radius * motion.step / apart
    min_growth = now - before - spread
    max_growth = now - before + spread
    if view.kind == PERSPECTIVE:
        cosine = wp.sqrt(view.cosine2)
        change = view.depth - motion.depth
        min_growth = smaller(min_growth * cosine, min_over_box(change, low, high))
        max_growth = larger(max_growth * cosine, max_over_box(change, low, high))
    return min_growth, max_growth, valid


@wp.func
def slant_change(now: wp.vec2d, before: wp.vec2d, step: wp.vec2d, low: wp.vec2d, high: wp.vec2d) -> wp.vec2d:
    """Return bounds (lower, upper) of the growth of the largest |row . (x, y)| in any rectangle inside low .. high.

    row: two coefficients of a function that is linear in the position (x, y) relative to the eye. now, before: the row
    in this view and in the last. step: movement of the eye, metres. low, high: corners of the rectangle relative to the
    eye before.
    """
    products = ends_of(before, low, high)  # least and largest row . (x, y) before
    growth = ends_of(now - before, low, high)
    # now . (p - eye) - before . (p - eye before) = (now - before) . (p - eye before) - now . step
    by_step = now[0] * step[0] + now[1] * step[1]
    growth = wp.vec2d(growth[0] - by_step, growth[1] - by_step)
    if products[0] < wp.float64(0.0) or products[0] + growth[0] < wp.float64(0.0):  # a product may be negative
        if products[1] > wp.float64(0.0) or products[1] + growth[1] > wp.float64(0.0):
            size = larger(growth[1], -growth[0])  # products of both signs
            growth = wp.vec2d(-size, size)
        else:
            growth = wp.vec2d(-growth[1], -growth[0])  # all are negative
    return growth


@wp.func
def slant_factors(view: LocalView, motion: Motion, low: wp.vec3d, high: wp.vec3d) -> wp.vec2d:
    """Return bounds (lower, upper) of the factor by which the largest (slant * depth)^2 in a box has changed.

    They hold in any box inside low .. high, metres. motion: the movement of the view since the last frame, which has
    caused the change. If slant * depth may have been 0, the bounds may be -infinity and infinity.
    """
    low_offset = wp.vec2d(low[0] - motion.eye[0], low[1] - motion.eye[1])
    high_offset = wp.vec2d(high[0] - motion.eye[0], high[1] - motion.eye[1])
    step = wp.vec2d(view.eye[0] - motion.eye[0], view.eye[1] - motion.eye[1])
    # Both components of slant times depth before: their extreme magnitudes, and bounds of their growth.
    x = sizes_of(ends_of(motion.slant_x, low_offset, high_offset))
    y = sizes_of(ends_of(motion.slant_y, low_offset, high_offset))
    growth_x = slant_change(view.slant_x, motion.slant_x, step, low_offset, high_offset)
    growth_y = slant_change(view.slant_y, motion.slant_y, step, low_offset, high_offset)
    # (q + change)^2 - q^2 = 2 q change + change^2, of which a lower bound may leave out change^2.
    two = wp.float64(2.0)
    fall = two * (smaller(x[0] * growth_x[0], x[1] * growth_x[0]) + smaller(y[0] * growth_y[0], y[1] * growth_y[0]))
    rise = two * (larger(x[0] * growth_x[1], x[1] * growth_x[1]) + larger(y[0] * growth_y[1], y[1] * growth_y[1]))
    rise += growth_x[1] * growth_x[1] + growth_y[1] * growth_y[1]
    smallest2 = x[0] * x[0] + y[0] * y[0]
    largest2 = x[1] * x[1] + y[1] * y[1]
    one = wp.float64(1.0)
    lower = one + fall / wp.where(fall < wp.float64(0.0), smallest2, largest2)
    upper = one + rise / wp.where(rise > wp.float64(0.0), smallest2, largest2)
    return wp.vec2d(lower, upper)


@wp.func
def footprint_factors(
    view: LocalView,
    motion: Motion,
    measures_edges: wp.int32,
    low: wp.vec3d,
    high: wp.vec3d,
    fall: wp.float64,
    rise: wp.float64,
):
    """Return (lower, upper, squared gain, valid): bounds of the factor on pixel footprints in boxes inside low .. high.

    low, high: metres. fall, rise: least and largest growth of depth or distance in that box since the last frame,
    metres. measures_edges: 1 if the bounds must hold for footprints of edges, too. valid: 1, or 0 if nothing is known.
    Footprints are proportional to depth times gain. The gain is 1 / slant, here computed as depth / (slant * depth),
    and is clamped to 1 .. the largest. If it is clamped to the same end in all boxes, before and now, it is returned
    and the factors exclude the change of depth; otherwise they include it and the returned gain is 0.
    """
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    before = view
    before.eye = motion.eye
    before.depth = motion.depth
    nearest2 = min_range2(before, low, high, min_over_box(before.depth, low, high))
    farthest2 = max_range2(before, low, high)
    nearest = wp.sqrt(nearest2)
    farthest = wp.sqrt(farthest2)
    min_depth_factor = one + fall / wp.where(fall < zero, nearest, farthest)
    max_depth_factor = one + rise / wp.where(rise > zero, nearest, farthest)
    slants2 = slant_factors(view, motion, low, high)
    # Squared gains, before they are clamped to 1 and the largest.
    slants_before2 = slants2_of(motion.slant_x, motion.slant_y, motion.eye, low, high)
    slants_now2 = slants2_of(view.slant_x, view.slant_y, view.eye, low, high)
    min_gain2 = smaller(
        nearest2 / slants_before2[1], min_range2(view, low, high, min_over_box(view.depth, low, high)) / slants_now2[1]
    )
    max_gain2 = larger(farthest2 / slants_before2[0], max_range2(view, low, high) / slants_now2[0])
    if measures_edges == 1:
        min_gain2 = zero  # footprints of edges have no gain
    valid = wp.int32(1)
    gain2 = zero
    # Bounds of the factor where the gain is not clamped: footprints are then depth^2 / (slant * depth).
    lowest = min_depth_factor * min_depth_factor / wp.sqrt(slants2[1])
    highest = max_depth_factor * max_depth_factor / wp.sqrt(slants2[0])
    smaller_limit2 = smaller(view.max_gain2, motion.max_gain2)
    if max_gain2 <= one:  # clamped to 1 in all boxes
        gain2 = one
        lowest = one
        highest = one
    elif min_gain2 >= larger(view.max_gain2, motion.max_gain2):  # clamped to the largest gain in all boxes
        gain2 = view.max_gain2
        lowest = wp.sqrt(view.max_gain2 / motion.max_gain2)
        highest = lowest
    else:
        if not (min_depth_factor > zero and slants2[0] > zero):  # an unclamped gain has no bounds
            valid = 0
        if min_gain2 < one:  # clamped to 1 in some boxes
            lowest = smaller(min_depth_factor, lowest)
            highest = larger(max_depth_factor, highest)
        if max_gain2 > smaller_limit2:  # clamped to the largest gain in some boxes
            gain = wp.sqrt(view.max_gain2 / motion.max_gain2)
            lowest = smaller(min_depth_factor * gain, lowest)
            highest = larger(max_depth_factor * gain, highest)
    return lowest, highest, gain2, valid


@wp.func
def fade_change(view: LocalView, motion: Motion, low: wp.vec3d, high: wp.vec3d):
    """Return (bounds, valid): bounds of the factor by which the frustum's fringe coarsens footprints in this box.

    They hold in any box inside this one. bounds: of the factor now over that in the last frame (lower, upper), and of
    the factor now (smallest, largest). valid: 1, or 0 if nothing is known. The factor is (1 + fade * f)^4, where f (0
    to 1) is the distance beyond the planes over the width of the fringe. The distance changes linearly with the
    position, the width linearly with the depth.
    """
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    planes = view.planes
    before = motion.planes
    inf = wp.float64(wp.inf)
    outermost = inf  # metres inside the planes, of the outermost and the innermost point
    innermost = inf
    innermost_before = inf
    outwards = zero  # metres that a point may have moved out and in
    inwards = zero
    for p in range(view.plane_count):
        outermost = smaller(min_over_box(planes[p], low, high), outermost)
        innermost = smaller(max_over_box(planes[p], low, high), innermost)
        innermost_before = smaller(max_over_box(before[p], low, high), innermost_before)
    for p in range(view.plane_count):  # only planes that may be the nearest one of a point count
        if min_over_box(planes[p], low, high) <= innermost or min_over_box(before[p], low, high) <= innermost_before:
            outwards = larger(-min_over_box(planes[p] - before[p], low, high), outwards)
            inwards = larger(max_over_box(planes[p] - before[p], low, high), inwards)
    min_width = fringe_at(view, min_over_box(view.depth, low, high))
    max_width = fringe_at(view, max_over_box(view.depth, low, high))
    if view.kind == PERSPECTIVE:  # the fringe's width changes, too
        change = view.depth - motion.depth
        outwards += view.fringe * larger(-min_over_box(change, low, high), zero)
        inwards += view.fringe * larger(max_over_box(change, low, high), zero)
    valid = wp.where(min_width > zero and max_width < inf, 1, 0)
    # 1 + fade * f of the innermost and the outermost point; of the innermost one in the last frame, at least.
    finest = one + view.fade * wp.clamp(-innermost / max_width, zero, one)
    coarsest = one + view.fade * wp.clamp(-outermost / min_width, zero, one)
    before_finest = larger(finest - view.fade * outwards / min_width, one)
    # Of 1 + fade * f now over before: 1 plus the change of fade * f, over a value before of at least `before_finest`.
    fall = larger(one - view.fade * inwards / (min_width * before_finest), zero)
    rise = one + view.fade * outwards / (min_width * before_finest)
    bounds = wp.vec4d(fall * fall, rise * rise, finest * finest, coarsest * coarsest)
    return wp.cw_mul(bounds, bounds), valid


@wp.func
def footprint_change(view: LocalView, motion: Motion, measures_edges: wp.int32, subtree: Subtree):
    """Return (lower, upper, valid): bounds of the change of pixel footprints in any box of a subtree, metres.

    The change is that since the last frame. measures_edges: 1 if the criterion limits edges. subtree: has the box of
    its diamonds (low, high) and the finest and coarsest pixel footprint (fine, coarse, metres) on their boxes when it
    was cached. motion.ratio: footprint at unit depth over that of the last frame. motion.drift: fraction by which
    lengths may have changed. valid: 1, or 0 if the change has no bound.
    """
    one = wp.float64(1.0)
    min_growth = wp.float64(0.0)
    max_growth = wp.float64(0.0)
    valid = wp.int32(1)
    min_factor = one
    max_factor = one
    gain2 = one
    if view.kind != ORTHOGRAPHIC:
        min_growth, max_growth, valid = change_of(view, motion, subtree.low, subtree.high)
    if view.max_gain2 > one or motion.max_gain2 > one:  # footprints depend on slants
        min_factor, max_factor, gain2, also_valid = footprint_factors(
            view, motion, measures_edges, subtree.low, subtree.high, min_growth, max_growth
        )
        valid = wp.min(valid, also_valid)
    # Of the fringe's factor: its lower and upper change, then its smallest and largest value now.
    faded = wp.vec4d(one, one, one, one)
    if subtree.frustum_class == OUTSIDE:
        gain2 = gain2 * view.off_screen2
    if subtree.frustum_class == FADED:
        faded, also_valid = fade_change(view, motion, subtree.low, subtree.high)
        valid = wp.min(valid, also_valid)
    footprint_per_metre = wp.sqrt(view.pixel2) * wp.sqrt(gain2)
    fall = motion.ratio * min_factor * faded[0] - one
    rise = motion.ratio * max_factor * faded[1] - one
    zero = wp.float64(0.0)
    # From here on the growths are those of footprints: metres of depth times the fringe's factor and the footprint per
    # metre, and the relative changes `fall` and `rise` of the rest.
    min_growth = min_growth * wp.where(min_growth < zero, faded[3], faded[2])
    max_growth = max_growth * wp.where(max_growth > zero, faded[3], faded[2])
    # Footprints drift, and so do those at which verdicts change: both together by less than 4 times `drift`.
    margin = (ROUNDED + wp.float64(4.0) * motion.drift) * subtree.coarse
    min_growth = min_growth * footprint_per_metre + smaller(fall * subtree.fine, fall * subtree.coarse) - margin
    max_growth = max_growth * footprint_per_metre + larger(rise * subtree.fine, rise * subtree.coarse) + margin
    return min_growth, max_growth, valid


@wp.func
def frustum_class_of(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.int32:
    """Classify the position of a subtree's box low .. high relative to the frustum: CLEAR, OUTSIDE, FADED, or CROSSED.

    CLEAR: inside. FADED: at least partly in the fringe around the frustum. CROSSED: on its border, so that the subtree
    cannot be cached. view: the only one of the frame, since frames with several views cache nothing.
    """
    frustum_class = classify_box_steadily(view, low, high)
    if frustum_class == CROSSED and view.fade > wp.float64(0.0):
        frustum_class = FADED
    return frustum_class


@wp.func
def update_margins(criterion: CriterionArrays, motion: Motion, subtree: Subtree, in_frame: wp.int32):
    """Return the subtree with the moved view's margins and footprints, and 1 if all its split decisions certainly stay.

    Then its leaves are copied instead of found again. The second result is 0 if a decision may change; the returned
    subtree must not be used then. in_frame: 1 if the frustum is known to contain the subtree's box.
    """
    min_growth, max_growth, is_valid = footprint_change(criterion.view, motion, criterion.measures_edges, subtree)
    subtree.fall = subtree.fall + min_growth
    subtree.rise = subtree.rise - max_growth
    rounded = ROUNDED * subtree.coarse
    # A decision may change.
    if not (subtree.fall > rounded and subtree.rise > rounded and subtree.fine + min_growth > rounded):
        is_valid = 0
    # for boxes in the fringe `fade_change` bounds the change, wherever they are
    if is_valid == 1 and subtree.frustum_class != FADED:
        frustum_class = CLEAR
        if in_frame == 0:
            frustum_class = classify_box_steadily(criterion.view, subtree.low, subtree.high)
        is_valid = wp.where(frustum_class == subtree.frustum_class, 1, 0)
    if is_valid == 1:
        subtree.fine = subtree.fine + min_growth
        subtree.coarse = subtree.coarse + max_growth
    return subtree, is_valid
