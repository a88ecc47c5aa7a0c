# SPDX-License-Identifier: GPL-3.0-or-later
"""A view in terrain space, and where a box is relative to its frustum.

`low`, `high`: corners of a box, metres in terrain space. All functions are monotone, also in rounded arithmetic: a box
inside another one is at least as far inside each plane. The fringe is a zone beyond the planes over which footprints
become coarser gradually.
"""

import warp as wp

from .diamond import larger, smaller
from .hiding import Rings

PERSPECTIVE = wp.constant(0)
ORTHOGRAPHIC = wp.constant(1)
PANORAMIC = wp.constant(2)
CLEAR = wp.constant(1)  # the frustum contains a box
OUTSIDE = wp.constant(0)  # a box is outside one of its planes
CROSSED = wp.constant(-1)  # neither is known
MAX_PLANES = wp.constant(6)
planes_type = wp.types.matrix(shape=(6, 4), dtype=wp.float64)


@wp.struct
class LocalView:
    """A view in terrain space. Lengths in camera space are in metres of the terrain's height."""

    kind: wp.int32
    plane_count: wp.int32
    eye: wp.vec3d  # metres
    unsure: wp.float64  # largest distance of mesh and surface, metres of height: boxes are extended by it
    weight: wp.vec3d  # squared metres of camera space per squared metre along each axis
    depth: wp.vec4d  # depth along the view = depth . (x, y, z, 1), metres, reduced by the effect of `unsure`
    pixel2: wp.float64  # squared footprint, metres; of a perspective at unit depth and the frame's largest slant, of a
    # panorama at unit distance
    slant_x: wp.vec2d  # slant times depth, over the frame's largest, = slant_x . (dx, dy) across the view ...
    slant_y: wp.vec2d  # ... and slant_y . (dx, dy) along it; metres of camera space per metre from the eye
    max_gain2: wp.float64  # squared largest slant of the frame over the smallest that counts
    cosine2: wp.float64  # squared minimum of depth over distance inside the frame
    near2: wp.float64  # squared distance below which nothing is visible
    off_screen2: wp.float64  # squared factor by which footprints are coarser outside the frustum
    fade: wp.float64  # 0: that factor is a step; else it grows over the fringe as (1 + fade * fraction)^4
    fringe: wp.float64  # width of the fringe beyond a plane: metres; of a perspective a fraction of the depth
    hidden2: wp.float64  # squared factor by which footprints are coarser on hidden ground
    ramp: wp.float64  # 0: that factor is a step; else it grows down to this slope below the horizon
    occlusion_fade: wp.float64  # ... as (1 + occlusion_fade * fraction)^4
    rings: Rings
    planes: planes_type  # positive towards the frustum


@wp.func
def max_over_box(plane: wp.vec4d, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return the largest value of plane . (x, y, z, 1) in a box, whose corners are low and high."""
    largest = plane[3] + larger(plane[0] * low[0], plane[0] * high[0])
    largest += larger(plane[1] * low[1], plane[1] * high[1])
    largest += larger(plane[2] * low[2], plane[2] * high[2])
    return largest


@wp.func
def min_over_box(plane: wp.vec4d, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return the smallest value of plane . (x, y, z, 1) in a box, whose corners are low and high."""
    smallest = plane[3] + smaller(plane[0] * low[0], plane[0] * high[0])
    smallest += smaller(plane[1] * low[1], plane[1] * high[1])
    smallest += smaller(plane[2] * low[2], plane[2] * high[2])
    return smallest


@wp.func
def max_inside(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return the minimum over all frustum planes of the innermost corner's distance inside the plane, metres.

    It is negative only if the box is outside the frustum, but not always then: each plane alone may cross a box that
    the frustum does not meet. It is infinite without planes.
    """
    inside = wp.float64(wp.inf)
    planes = view.planes  # here, or Warp copies all of them for each
    # Warp unrolls a constant number of passes. With a variable index all planes would be copied for each diamond that a
    # walk judges, 8 % of its time.
    for p in range(MAX_PLANES):
        if p < view.plane_count:
            inside = smaller(max_over_box(planes[p], low, high), inside)
    return inside


@wp.func
def min_inside(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.float64:
    """Return the minimum over all frustum planes of the outermost corner's distance inside the plane, metres.

    It is negative unless the frustum contains the box, and infinite without planes.
    """
    inside = wp.float64(wp.inf)
    planes = view.planes
    for p in range(MAX_PLANES):  # as in `max_inside`
        if p < view.plane_count:
            inside = smaller(min_over_box(planes[p], low, high), inside)
    return inside


@wp.func
def classify_box(view: LocalView, low: wp.vec3d, high: wp.vec3d, beyond: wp.float64) -> wp.int32:
    """Return how a box, with the corners low and high, stands to the frustum: CLEAR, OUTSIDE or CROSSED.

    CLEAR: the frustum contains it. OUTSIDE: it is more than `beyond` metres outside a plane. CROSSED: neither is known.
    """
    zero = wp.float64(0.0)
    frustum_class = CLEAR
    if min_inside(view, low, high) < zero:
        frustum_class = CROSSED
        if max_inside(view, low, high) + beyond < zero:
            frustum_class = OUTSIDE
    return frustum_class


@wp.func
def fringe_at(view: LocalView, depth: wp.float64) -> wp.float64:
    """Return the width, metres, of the fringe beyond a frustum plane at a depth (metres).

    It is constant but in a perspective, where it grows with the depth and is 0 behind the eye.
    """
    width = view.fringe
    if view.kind == PERSPECTIVE:
        width = width * larger(depth, wp.float64(0.0))
    return width


@wp.func
def classify_box_steadily(view: LocalView, low: wp.vec3d, high: wp.vec3d) -> wp.int32:
    """Return how a box stands to the frustum and its fringe: CLEAR, OUTSIDE of both, or CROSSED.

    CLEAR: the frustum contains it, so that the fringe does not matter. CROSSED: any other, also one wholly in the
    fringe.
    """
    beyond = wp.float64(0.0)
    if view.fade > beyond:
        beyond = fringe_at(view, max_over_box(view.depth, low, high))
    return classify_box(view, low, high, beyond)
