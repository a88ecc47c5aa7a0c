# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounds: the most that any leaf of a set has of what a refinement is asked for, squared."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Bounds:
    """Squared spans of a pixel and squared metres."""

    px2: wp.float64  # of error as the criterion weighs it, see `metres2_of`
    total_px2: wp.float64  # of all error
    long_px2: wp.float64  # of the longest edge, and twice the area: where edges are asked for
    legs_px2: wp.float64
    metres2: wp.float64  # weighed
    total2: wp.float64


@wp.func
def within(a: Bounds, b: Bounds) -> wp.bool:
    """Whether none of a is above b."""
    pixels = a.px2 <= b.px2 and a.total_px2 <= b.total_px2
    edges = a.long_px2 <= b.long_px2 and a.legs_px2 <= b.legs_px2
    return pixels and edges and a.metres2 <= b.metres2 and a.total2 <= b.total2


@wp.func
def seen_closer(a: Bounds, factor: wp.float64) -> Bounds:
    """The bounds where spans of a pixel have become smaller by `factor`."""
    factor2 = factor * factor
    a.px2 = a.px2 * factor2
    a.total_px2 = a.total_px2 * factor2
    a.long_px2 = a.long_px2 * factor2
    a.legs_px2 = a.legs_px2 * factor2
    return a
