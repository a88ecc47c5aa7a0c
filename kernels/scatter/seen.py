# SPDX-License-Identifier: GPL-3.0-or-later
"""The density of a scatter by views at a point, and its range over a box; 1 is full density.

It is full up to a distance and then falls with its square, for a constant number of points in a pixel. It is 0 in boxes
that nearer ground hides from all views; other boxes are not affected, so that visible points do not change.
"""

import warp as wp

from ..refine.diamond import larger
from ..refine.hiding import is_hidden
from ..refine.local_view import CLEAR, ORTHOGRAPHIC, OUTSIDE, LocalView, classify_box, max_inside


@wp.struct
class Views:
    """Views; without any the density is 1 everywhere."""

    count: wp.int32
    full2: wp.float64  # squared distance from the eye up to which the density is 1, metres of camera space
    views: wp.array(dtype=LocalView)
    slopes: wp.array(dtype=wp.float32)  # map of horizons, see kernels/refine/hiding.py
    reach: wp.vec3d  # how far scattered objects reach from their points, metres of the terrain's space


@wp.func
def density_at_distance(full2: wp.float64, distance_squared: wp.float64) -> wp.float64:
    """Return the density at a squared distance (metres): 1 up to `full2`, then full2 / distance_squared."""
    return wp.where(distance_squared > full2, full2 / distance_squared, wp.float64(1.0))


@wp.func
def distance2(view: LocalView, x: wp.float64, y: wp.float64, z: wp.float64) -> wp.float64:
    """Return the squared distance of the offset (x, y, z) from the eye, metres of camera space.

    It is 0 in an orthographic view, so that the density is 1 at any distance.
    """
    distance_squared = view.weight[0] * (x * x) + view.weight[1] * (y * y) + view.weight[2] * (z * z)
    return wp.where(view.kind == ORTHOGRAPHIC, wp.float64(0.0), distance_squared)


@wp.func
def density_by_view(full2: wp.float64, view: LocalView, p: wp.vec3d, clear: wp.int32) -> wp.float64:
    """Return the density that one view wants at point p (metres): 0 outside its frame, widened by the scatter's margin.

    full2: squared distance up to which the density is 1. clear: 1 if p is known to be in the frame. Hidden ground
    counts as visible.
    """
    inside = wp.float64(0.0)  # metres inside the nearest plane of the frustum
    if clear == 0:
        inside = max_inside(view, p, p)
    density = wp.float64(0.0)
    if inside >= wp.float64(0.0):
        distance_squared = distance2(view, p[0] - view.eye[0], p[1] - view.eye[1], p[2] - view.eye[2])
        density = density_at_distance(full2, distance_squared)
    return density


@wp.func
def density_of_views(views: Views, p: wp.vec3d, clear: wp.int32) -> wp.float64:
    """Return the largest density that a view wants at point p (metres); 1 without views.

    clear: 1 if p is known to be in the frame of the only view.
    """
    density = wp.where(views.count == 0, wp.float64(1.0), wp.float64(0.0))
    for v in range(views.count):
        density = larger(density, density_by_view(views.full2, views.views[v], p, clear))
    return density


@wp.func
def density_bounds(views: Views, low: wp.vec3d, high: wp.vec3d):
    """Return bounds (upper, lower) of the density in a box, which is `low` .. `high`, metres.

    The upper bound is 0 if the box is hidden or out of sight in all views. A view counts in the lower one only if the
    box is inside its frame and it has no map of horizons, by which ground may hide a part of the box.
    """
    zero = wp.float64(0.0)
    high_density = wp.where(views.count == 0, wp.float64(1.0), zero)
    low_density = high_density
    is_visible = wp.bool(views.count == 0)
    for v in range(views.count):
        view = views.views[v]
        frustum_class = classify_box(view, low, high, wp.float64(0.0))
        if frustum_class != OUTSIDE:
            a = low - view.eye  # the box's corners relative to the eye
            b = high - view.eye
            # Scattered objects reach out of the box.
            is_visible = is_visible or not is_hidden(view.rings, views.slopes, a - views.reach, b + views.reach)
            near_squared = distance2(view, larger(larger(a[0], -b[0]), zero), larger(larger(a[1], -b[1]), zero),
                              larger(larger(a[2], -b[2]), zero))  # fmt: skip
            high_density = larger(high_density, density_at_distance(views.full2, near_squared))
            if frustum_class == CLEAR and view.rings.count == 0:
                far_squared = distance2(view, larger(-a[0], b[0]), larger(-a[1], b[1]), larger(-a[2], b[2]))
                low_density = larger(low_density, density_at_distance(views.full2, far_squared))
    return wp.where(is_visible, high_density, zero), low_density
