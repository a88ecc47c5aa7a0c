# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of a scatter views want at a place, and at most and at least over a box: 1 is full density.

Full up to a distance, then falling with its square, so that as many points a pixel are seen as at that distance. Of a
box that nearer ground hides from all views nothing is wanted; of others no less, so all that is seen stays as it is.
"""

import warp as wp

from ..refine.diamond import larger
from ..refine.hiding import is_hidden
from ..refine.pixels import CLEAR, ORTHOGRAPHIC, OUTSIDE, LocalView, most_inside, stand_of


@wp.struct
class Views:
    """`full2`: squared metres up to which density is full. No views: it is so everywhere. `slopes`: the map of what
    ground hides, see kernels/refine/hiding.py. `reach`: metres of the terrain's space that what stands there takes."""

    count: wp.int32
    full2: wp.float64
    views: wp.array(dtype=LocalView)
    slopes: wp.array(dtype=wp.float32)
    reach: wp.vec3d


@wp.func
def ramp(full2: wp.float64, far2: wp.float64) -> wp.float64:
    return wp.where(far2 > full2, full2 / far2, wp.float64(1.0))


@wp.func
def distance2(view: LocalView, x: wp.float64, y: wp.float64, z: wp.float64) -> wp.float64:
    """Squared metres from the eye, differences from which are x, y, z; 0 of parallel rays, which have no eye."""
    far2 = view.weight[0] * (x * x) + view.weight[1] * (y * y) + view.weight[2] * (z * z)
    return wp.where(view.kind == ORTHOGRAPHIC, wp.float64(0.0), far2)


@wp.func
def wanted_by(full2: wp.float64, view: LocalView, p: wp.vec3d, clear: wp.int32) -> wp.float64:
    """Of a view at a place that is in its frame with the margin (`clear`: which is known); 0 elsewhere."""
    inside = wp.float64(0.0)
    if clear == 0:
        inside = most_inside(view, p, p)
    want = wp.float64(0.0)
    if inside >= wp.float64(0.0):
        want = ramp(full2, distance2(view, p[0] - view.eye[0], p[1] - view.eye[1], p[2] - view.eye[2]))
    return want


@wp.func
def wanted_at(views: Views, p: wp.vec3d, clear: wp.int32) -> wp.float64:
    """The most of all views."""
    want = wp.where(views.count == 0, wp.float64(1.0), wp.float64(0.0))
    for v in range(views.count):
        want = larger(want, wanted_by(views.full2, views.views[v], p, clear))
    return want


@wp.func
def wanted_over(views: Views, low: wp.vec3d, high: wp.vec3d):
    """The most that a place of a box may have; the least, 0 where a frame ends in it and where ground may hide some."""
    zero = wp.float64(0.0)
    most = wp.where(views.count == 0, wp.float64(1.0), zero)
    least = most
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
            most = larger(most, ramp(views.full2, near2))
            if stand == CLEAR and view.rings.count == 0:
                far2 = distance2(view, larger(-a[0], b[0]), larger(-a[1], b[1]), larger(-a[2], b[2]))
                least = larger(least, ramp(views.full2, far2))
    return wp.where(seen, most, zero), least
