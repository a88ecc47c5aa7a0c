# SPDX-License-Identifier: GPL-3.0-or-later
"""The density of a scatter by views at a point, and its range over a box; 1 is full density.

It is full up to a distance and then falls with its square, for a constant number of points in a pixel. It is 0 in boxes
that nearer ground hides from all views; other boxes are not affected, so that visible points do not change.
"""

import warp as wp

from ..refine.diamond import larger
from ..refine.hiding import is_hidden
from ..refine.local_view import CLEAR, ORTHOGRAPHIC, OUTSIDE, LocalView, max_inside, stand_of


@wp.struct
class Views:
    """Views; without any the density is 1 everywhere.

    `full2`: squared distance up to which it is full. `slopes`: map of hidden ground, see kernels/refine/hiding.py.
    `reach`: size of scattered objects in metres of the terrain's space.
    """

    count: wp.int32
    full2: wp.float64
    views: wp.array(dtype=LocalView)
    slopes: wp.array(dtype=wp.float32)
    reach: wp.vec3d


@wp.func
def density_at_distance(full2: wp.float64, far2: wp.float64) -> wp.float64:
    """Return the density at squared distance far2: 1 up to full2, then falling with the square of the distance."""
    return wp.where(far2 > full2, full2 / far2, wp.float64(1.0))


@wp.func
def distance2(view: LocalView, x: wp.float64, y: wp.float64, z: wp.float64) -> wp.float64:
    """Return the squared distance of the offset (x, y, z) from the eye in camera space; 0 for parallel rays."""
    far2 = view.weight[0] * (x * x) + view.weight[1] * (y * y) + view.weight[2] * (z * z)
    return wp.where(view.kind == ORTHOGRAPHIC, wp.float64(0.0), far2)


@wp.func
def wanted_by(full2: wp.float64, view: LocalView, p: wp.vec3d, clear: wp.int32) -> wp.float64:
    """Return the density that a view wants at a point p (metres) in its frame with the margin; 0 elsewhere.

    full2: see Views. clear: 1 if p is known to be in the frame.
    """
    inside = wp.float64(0.0)
    if clear == 0:
        inside = max_inside(view, p, p)
    want = wp.float64(0.0)
    if inside >= wp.float64(0.0):
        want = density_at_distance(full2, distance2(view, p[0] - view.eye[0], p[1] - view.eye[1], p[2] - view.eye[2]))
    return want


@wp.func
def wanted_at(views: Views, p: wp.vec3d, clear: wp.int32) -> wp.float64:
    """Return the largest density that a view wants at point p (metres); 1 without views.

    clear: 1 if the frame surely contains p, see `wanted_by`.
    """
    want = wp.where(views.count == 0, wp.float64(1.0), wp.float64(0.0))
    for v in range(views.count):
        want = larger(want, wanted_by(views.full2, views.views[v], p, clear))
    return want


@wp.func
def wanted_over(views: Views, low: wp.vec3d, high: wp.vec3d):
    """Return bounds (high, low) of the density in a box; low is 0 if a frame ends in it or ground may hide a part."""
    zero = wp.float64(0.0)
    high_density = wp.where(views.count == 0, wp.float64(1.0), zero)
    low_density = high_density
    seen = wp.bool(views.count == 0)
    for v in range(views.count):
        view = views.views[v]
        stand = stand_of(view, low, high, wp.float64(0.0))
        if stand != OUTSIDE:
            a = low - view.eye
            b = high - view.eye
            seen = seen or not is_hidden(view.rings, views.slopes, a - views.reach, b + views.reach)
            near2 = distance2(view, larger(larger(a[0], -b[0]), zero), larger(larger(a[1], -b[1]), zero),
                              larger(larger(a[2], -b[2]), zero))  # fmt: skip
            high_density = larger(high_density, density_at_distance(views.full2, near2))
            if stand == CLEAR and view.rings.count == 0:
                far2 = distance2(view, larger(-a[0], b[0]), larger(-a[1], b[1]), larger(-a[2], b[2]))
                low_density = larger(low_density, density_at_distance(views.full2, far2))
    return wp.where(seen, high_density, zero), low_density
