# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels for test_excess.py: bounds of the depths in a box, and of the heights over a rectangle."""

import warp as wp

from ..field.domain import Domain
from .diamond import Diamond
from .local_view import LocalView
from .tight_box import heights_between, min_depth_in


@wp.kernel
def depth_of_box(view: LocalView, low: wp.vec3d, high: wp.vec3d, found: wp.array(dtype=wp.float64)):
    d = Diamond()
    d.low = low
    d.high = high
    found[0] = min_depth_in(view, d)


@wp.kernel
def heights_of_rectangles(domain: Domain, rectangles: wp.array(dtype=wp.vec4i), found: wp.array(dtype=wp.vec2d)):
    """Write the lowest and highest metres over rectangles: lowest x and y, highest x and y, lattice units."""
    for k in range(found.shape[0]):
        r = rectangles[k]
        low, high = heights_between(domain, r[0], r[1], r[2], r[3])
        found[k] = wp.vec2d(low, high)
