# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked, and what a view makes of a diamond's box: what a pixel spans there, in the frame and hidden or not.

Boxes are nested, and all of this is monotone, also in rounded arithmetic: no pixel on a child's box is finer than on
its parent's.
"""

import warp as wp

from .diamond import Diamond, larger, smaller
from .hiding import Rings, covered, is_hidden

PERSPECTIVE = wp.constant(0)
ORTHOGRAPHIC = wp.constant(1)
PANORAMIC = wp.constant(2)
CLEAR = wp.constant(1)
OUTSIDE = wp.constant(0)
CROSSED = wp.constant(-1)
MAX_PLANES = wp.constant(6)
planes_type = wp.types.matrix(shape=(6, 4), dtype=wp.float64)


@wp.struct
class LocalView:
    """A view from the terrain's own space. Lengths of camera space are in metres of the terrain's height."""

    kind: wp.int32
    plane_count: wp.int32
    eye: wp.vec3d  # metres
    unsure: wp.float64  # metres of height by which what is seen may be off the surface: boxes are higher by that
    weight: wp.vec3d  # squared metres of camera space per squared metre along each axis
    depth: wp.vec4d  # depth along the view = depth . (x, y, z, 1), metres, less what `unsure` takes off it
    pixel2: wp.float64  # squared metres of a pixel; of perspective at unit depth and the frame's largest slant, of a
    # panorama at unit distance
    slant_x: wp.vec2d  # slant times depth, over the frame's largest, = slant_x . (dx, dy) across the view ...
    slant_y: wp.vec2d  # ... and slant_y . (dx, dy) along it; metres of camera space per metre from the eye
    max_gain2: wp.float64  # squared largest slant of the frame over the smallest that counts
    cosine2: wp.float64  # squared least depth over distance inside the frame
    near2: wp.float64  # squared distance below which nothing is seen
    off_screen2: wp.float64  # squared factor by which pixels are coarser outside the frustum
    fade: wp.float64  # 0: at once; else over a fringe it rises as (1 + fade * part)^4 does
    fringe: wp.float64  # how wide that is beyond a plane: metres, of perspective a part of the depth
    hidden2: wp.float64  # ... of what nearer ground hides
    ramp: wp.float64  # 0: at once; else it rises up to this slope below what hides it
    veil: wp.float64  # ... as (1 + veil * part)^4 does
    rings: Rings
    planes: planes_type  # positive towards the frustum


@wp.struct
class CriterionArrays:
    """What is asked, squared; infinity is off."""

    view_count: wp.int32
    measures_edges: wp.int32
    error_px2: wp.float64
    metres2: wp.float64
    edge_px2: wp.float64
    area_px2: wp.float64  # twice the area: squared legs of a right triangle
    limit: wp.float64  # all of these times this: 1, or more to meet a budget
    diagonal2: wp.float64  # squared length of a lattice unit's diagonal, the longer one, in camera space
    axis2: wp.float64  # squared length of a lattice unit's side, the longer one, in camera space
    view: LocalView  # the first view
    views: wp.array(dtype=LocalView)  # all of them
    slopes: wp.array(dtype=wp.float32)  # their horizons, see hiding.py


@wp.func
def most_of(plane: wp.vec4d, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return the largest plane . (x, y, z, 1) in a box."""
    found = plane[3] + larger(plane[0] * low[0], plane[0] * high[0])
    found += larger(plane[1] * low[1], plane[1] * high[1])
    found += larger(plane[2] * low[2], plane[2] * high[2])
    return found


@wp.func
def least_of(plane: wp.vec4d, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return the smallest plane . (x, y, z, 1) in a box."""
    found = plane[3] + smaller(plane[0] * low[0], plane[0] * high[0])
    found += smaller(plane[1] * low[1], plane[1] * high[1])
    found += smaller(plane[2] * low[2], plane[2] * high[2])
    return found


@wp.func
def most_inside(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """How far the innermost corner of a box is inside of a plane of the frustum, of all planes the least: negative if
    the box is outside. Infinite where there are no planes."""
    inside = wp.float64(wp.inf)
    planes = view.planes  # here, or Warp copies all of them for each
    for p in range(view.plane_count):
        inside = smaller(most_of(planes[p], low, high), inside)
    return inside


@wp.func
def least_inside(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """As `most_inside`, of the outermost corner: negative unless the frustum holds the box."""
    inside = wp.float64(wp.inf)
    planes = view.planes
    for p in range(view.plane_count):
        inside = smaller(least_of(planes[p], low, high), inside)
    return inside


@wp.func
def stand_of(view: LocalView, low: wp.vec3d, high: wp.vec3d, beyond: wp.float64) -> wp.int32:
    """Whether the frustum holds a box (CLEAR), the one with planes `beyond` metres further out none of it (OUTSIDE), or
    neither is known (CROSSED)."""
    zero = wp.float64(0.0)
    stand = CLEAR
    if least_inside(view, low, high) < zero:
        stand = CROSSED
        if most_inside(view, low, high) + beyond < zero:
            stand = OUTSIDE
    return stand


@wp.func
def fringe_at(view: LocalView, deep: wp.float64) -> wp.float64:
    """Return metres beyond a plane over which pixels get coarser, at a depth."""
    wide = view.fringe
    if view.kind == PERSPECTIVE:
        wide = wide * larger(deep, wp.float64(0.0))
    return wide


@wp.func
def steady_stand_of(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.int32:
    """As `stand_of`; CROSSED also where pixels get coarser by parts."""
    beyond = wp.float64(0.0)
    if view.fade > beyond:
        beyond = fringe_at(view, most_of(view.depth, low, high))
    return stand_of(view, low, high, beyond)


@wp.func
def sizes(asked: CriterionArrays, unit_bits: wp.int32, depth: wp.int32):
    """Of the two level triangles at a diamond: squared length of the longest edge and twice the area."""
    side = wp.float64(wp.int32(1) << (unit_bits - ((depth - 1) >> 1)))
    side2 = side * side
    long2 = asked.diagonal2 * side2
    legs2 = asked.axis2 * side2
    if (depth & 1) == 0:
        long2 = legs2
        legs2 = asked.diagonal2 * side2 * wp.float64(0.25)
    return long2, legs2


@wp.func
def far2_at(view: LocalView, dx: wp.float64, dy: wp.float64, dz: wp.float64, deep: wp.float64) -> wp.float64:
    """Return squared metres of camera space: of perspective the depth, else the distance, of a point (dx, dy, dz)
    metres from the eye. In the frame a depth is at least the distance times a cosine."""
    far2 = view.weight[0] * (dx * dx) + view.weight[1] * (dy * dy) + view.weight[2] * (dz * dz)
    far2 = larger(far2, view.near2)
    if view.kind == PERSPECTIVE:
        ahead = larger(deep, wp.float64(0.0))
        far2 = larger(ahead * ahead, far2 * view.cosine2)
    return far2


@wp.func
def ends_of(row: wp.vec2d, low: wp.vec2d, high: wp.vec2d) -> wp.vec2d:
    """Return the smallest and the largest row . (x, y) in a rectangle."""
    lower = smaller(row[0] * low[0], row[0] * high[0]) + smaller(row[1] * low[1], row[1] * high[1])
    upper = larger(row[0] * low[0], row[0] * high[0]) + larger(row[1] * low[1], row[1] * high[1])
    return wp.vec2d(lower, upper)


@wp.func
def sizes_of(ends: wp.vec2d) -> wp.vec2d:
    """Return the smallest and the largest absolute value between two ends."""
    return wp.vec2d(larger(larger(ends[0], -ends[1]), wp.float64(0.0)), larger(ends[1], -ends[0]))


@wp.func
def slants2_of(slant_x: wp.vec2d, slant_y: wp.vec2d, eye: wp.vec3d, low: wp.vec3d, high: wp.vec3d) -> wp.vec2d:
    """Return the smallest and the largest slant times depth, squared, over the frame's largest slant, in a box."""
    near = wp.vec2d(low[0] - eye[0], low[1] - eye[1])
    far = wp.vec2d(high[0] - eye[0], high[1] - eye[1])
    x = sizes_of(ends_of(slant_x, near, far))
    y = sizes_of(ends_of(slant_y, near, far))
    return wp.vec2d(x[0] * x[0] + y[0] * y[0], x[1] * x[1] + y[1] * y[1])


@wp.func
def pixel2_at(view: LocalView, far2: wp.float64, slants2: wp.float64) -> wp.float64:
    """Return squared metres of height that a pixel spans, at a depth or distance and at a slant times that depth.

    A height e at depth z and slant s moves a point by f e s / z pixels. s counts as the floor at least, and in the
    frame it is at most the largest.
    """
    gain2 = larger(smaller(far2 / slants2, view.max_gain2), wp.float64(1.0))
    return view.pixel2 * far2 * gain2


@wp.func
def nearest_far2(view: LocalView, low: wp.vec3d, high: wp.vec3d, deep: wp.float64) -> wp.float64:
    """Return `far2_at` of the nearest point of a box that is `deep` at least."""
    zero = wp.float64(0.0)
    dx = larger(larger(low[0] - view.eye[0], view.eye[0] - high[0]), zero)
    dy = larger(larger(low[1] - view.eye[1], view.eye[1] - high[1]), zero)
    dz = larger(larger(low[2] - view.eye[2], view.eye[2] - high[2]) - view.unsure, zero)
    return far2_at(view, dx, dy, dz, deep)


@wp.func
def farthest_far2(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return `far2_at` of the farthest point of a box, at most."""
    dx = larger(high[0] - view.eye[0], view.eye[0] - low[0])
    dy = larger(high[1] - view.eye[1], view.eye[1] - low[1])
    dz = larger(high[2] - view.eye[2], view.eye[2] - low[2]) + view.unsure
    return far2_at(view, dx, dy, dz, most_of(view.depth, low, high))


@wp.func
def nearest_pixel2(view: LocalView, low: wp.vec3d, high: wp.vec3d, deep: wp.float64) -> wp.float64:
    """Return squared metres that a pixel spans at least, anywhere in the box, which is `deep` at least."""
    pixel2 = view.pixel2
    if view.kind != ORTHOGRAPHIC:
        far2 = nearest_far2(view, low, high, deep)
        pixel2 = view.pixel2 * far2
        if view.max_gain2 > wp.float64(1.0):
            slants2 = slants2_of(view.slant_x, view.slant_y, view.eye, low, high)
            pixel2 = pixel2_at(view, far2, slants2[1])
    return pixel2


@wp.func
def farthest_pixel2(view: LocalView, d: Diamond) -> wp.float64:
    """Return squared metres that a pixel spans at most, in any box inside this one."""
    pixel2 = view.pixel2
    if view.kind != ORTHOGRAPHIC:
        far2 = farthest_far2(view, d.low, d.high)
        pixel2 = view.pixel2 * far2
        if view.max_gain2 > wp.float64(1.0):
            slants2 = slants2_of(view.slant_x, view.slant_y, view.eye, d.low, d.high)
            pixel2 = pixel2_at(view, far2, slants2[0])
    return pixel2


@wp.func
def cover_of(
    rings: Rings, ramp: wp.float64, slopes: wp.array(dtype=wp.float32), low: wp.vec3d, high: wp.vec3d
) -> wp.float64:
    """How hidden a box is by nearer ground: 0 (not at all) to 1 (all of it); metres from the eye."""
    part = wp.float64(0.0)
    if ramp > part:
        part = covered(rings, ramp, slopes, low, high)
    elif is_hidden(rings, slopes, low, high):
        part = wp.float64(1.0)
    return part


@wp.func
def veiled2(hidden2: wp.float64, veil: wp.float64, part: wp.float64) -> wp.float64:
    """Squared factor by which pixels are coarser where so much is hidden, `part` above 0: it rises with it."""
    coarser2 = hidden2
    if part < wp.float64(1.0):
        factor = wp.float64(1.0) + veil * part
        factor2 = factor * factor
        factor4 = factor2 * factor2
        coarser2 = smaller(factor4 * factor4, coarser2)
    return coarser2


@wp.func
def faded2(view: LocalView, inner: wp.float64, deep: wp.float64) -> wp.float64:
    """Squared factor by which pixels are coarser at `inner` metres, negative, inside the planes and at a depth.

    It falls as either rises, also in rounded arithmetic.
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
def finest_in(view: LocalView, slopes: wp.array(dtype=wp.float32), d: Diamond, in_frame: wp.int32) -> wp.float64:
    """Squared metres that a pixel spans at least, wherever in the box; coarser, as was asked, outside the frustum and
    where nearer ground hides it. in_frame: 1 where it is known that the frustum holds the box."""
    zero = wp.float64(0.0)
    coarser2 = wp.float64(1.0)
    if in_frame == 0:
        inner = most_inside(view, d.low, d.high)
        if inner < zero:
            coarser2 = faded2(view, inner, most_of(view.depth, d.low, d.high))
    if view.rings.count > 0 and coarser2 < view.hidden2:
        part = cover_of(view.rings, view.ramp, slopes, d.low - view.eye, d.high - view.eye)
        if part > zero:
            coarser2 = larger(veiled2(view.hidden2, view.veil, part), coarser2)
    return nearest_pixel2(view, d.low, d.high, least_of(view.depth, d.low, d.high)) * coarser2


@wp.func
def coarsest_in(view: LocalView, d: Diamond, in_frame: wp.int32):
    """Squared metres that a pixel spans at most, in whatever box inside this one; and whether the frustum holds it."""
    coarser2 = wp.float64(1.0)
    inside = wp.int32(1)
    if in_frame == 0:
        least = least_inside(view, d.low, d.high)
        if least < wp.float64(0.0):
            inside = 0
            coarser2 = faded2(view, least, least_of(view.depth, d.low, d.high))
    if view.rings.count > 0:
        coarser2 = larger(coarser2, view.hidden2)
    return farthest_pixel2(view, d) * coarser2, inside


@wp.func
def finest(asked: CriterionArrays, d: Diamond, in_frame: wp.int32) -> wp.float64:
    """Squared metres of the finest pixel that any view has on the box: infinite beyond the rim. One view is at hand."""
    pixel2 = wp.float64(wp.inf)
    if asked.view_count > 0 and d.rim < 2:
        pixel2 = finest_in(asked.view, asked.slopes, d, in_frame)
        for v in range(1, asked.view_count):
            pixel2 = smaller(pixel2, finest_in(asked.views[v], asked.slopes, d, in_frame))
    return pixel2


@wp.func
def coarsest(asked: CriterionArrays, d: Diamond, in_frame: wp.int32):
    """As `coarsest_in`, of the view that has the finest pixels there; whether the frustums of all views hold it.

    Some of the boxes inside one that reaches beyond the rim are wholly beyond it: none is certain to be split.
    """
    pixel2 = wp.float64(wp.inf)
    inside = wp.int32(1)
    if asked.view_count > 0:
        pixel2, inside = coarsest_in(asked.view, d, in_frame)
        for v in range(1, asked.view_count):
            p2, also = coarsest_in(asked.views[v], d, in_frame)
            pixel2 = smaller(pixel2, p2)
            inside = wp.min(inside, also)
    if d.rim > 0:
        pixel2 = wp.float64(wp.inf)
    return pixel2, inside


@wp.func
def too_coarse_at(
    asked: CriterionArrays,
    limit: wp.float64,
    pixel2: wp.float64,
    metres2: wp.float64,
    long2: wp.float64,
    legs2: wp.float64,
):
    """Whether a diamond is to be split at `limit` times what is asked, where a pixel spans sqrt(pixel2)."""
    px2 = limit * pixel2
    coarse = metres2 > px2 * asked.error_px2 or metres2 > limit * asked.metres2
    return coarse or long2 > px2 * asked.edge_px2 or legs2 > px2 * asked.area_px2
