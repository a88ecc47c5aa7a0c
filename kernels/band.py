# SPDX-License-Identifier: GPL-3.0-or-later
"""A band: what is certain of all diamonds below one that is split, from the finest and the coarsest pixel on its box.

Boxes, errors and what resampling moved are nested, so what holds for the diamond holds for those below it. The curve
meets a diamond twice, once from either triangle; what it was found to be is remembered for the second time, until
another one takes its place. Nanoseconds a leaf with memory and without: 40.2 and 50.2 at 50,000 leaves of one edge
length, 14.8 and 17.9 at 1 M, 54.7 and 57.6 at 1 M of one error.
"""

import warp as wp

from .criterion import Asked, smaller

wp.set_module_options({"enable_backward": False})

REMEMBER_BITS = wp.constant(10)
REMEMBERED = wp.constant(1 << 10)  # diamonds that a walk remembers: 8 in 10 of those that it meets again
NOT_SPLIT = wp.constant(-1)


@wp.struct
class Band:
    """What a diamond says of those below it."""

    split_above: wp.float64  # metres of own error: above, a diamond is split
    leaf_up_to: wp.float64  # ... up to these no error asks for a split
    quiet_up_to: wp.float64  # ... and up to these none is a new maximum in pixels
    split_depth: wp.int32  # above it edges ask for a split; or NOT_SPLIT
    leaf_depth: wp.int32  # from it on they do not
    even_depth: wp.int32  # where only depths decide and in no doubt: the leaves'; -1: in doubt; 0: errors count
    clear: wp.int32  # the frustum holds the box
    x: wp.int32  # the diamond's split vertex
    y: wp.int32


@wp.func
def remembered_at(x: wp.int32, y: wp.int32) -> wp.int32:
    """Where a walk remembers the diamond split at (x, y): multiplicative hashing."""
    hashed = wp.uint32(x) * wp.uint32(-1640531535) + wp.uint32(y) * wp.uint32(-2048144789)
    return wp.int32(hashed >> wp.uint32(32 - REMEMBER_BITS))


@wp.func
def nothing_certain() -> Band:
    """The band of what has not been measured."""
    band = Band()
    band.split_above = wp.float64(wp.inf)
    band.leaf_up_to = wp.float64(-1.0)
    band.quiet_up_to = wp.float64(-1.0)
    band.leaf_depth = 1 << 30
    return band


@wp.func
def not_split(x: wp.int32, y: wp.int32) -> Band:
    """What is remembered of a diamond that is not split."""
    band = Band()
    band.split_depth = NOT_SPLIT
    band.x = x
    band.y = y
    return band


@wp.func
def first_within(
    depth: wp.int32,
    end: wp.int32,
    long2: wp.float64,
    legs2: wp.float64,
    edge2: wp.float64,
    area2: wp.float64,
):
    """The first depth from `depth` on, `end` at most, whose edges and areas are within these, and what they are there.

    long2, legs2: of `depth`, as `sizes` has them. A bisection makes the legs the longest edge; new legs are half of it.
    """
    found = depth
    edge = long2
    area = legs2
    while found < end and (edge > edge2 or area > area2):
        legs = wp.float64(0.25) * edge
        edge = area
        area = legs
        found += 1
    return found, edge, area


@wp.func
def splits_below(
    asked: Asked, depth: wp.int32, max_depth: wp.int32, long2: wp.float64, legs2: wp.float64, coarsest2: wp.float64
) -> wp.int32:
    """The depth above which edges ask for splits everywhere below a diamond of `depth`.

    long2, legs2: see `sizes`. coarsest2: squared metres of a pixel.
    """
    split_depth = wp.int32(0)
    if asked.measures_edges == 1:
        edge2 = asked.limit * asked.edge_px2 * coarsest2
        area2 = asked.limit * asked.area_px2 * coarsest2
        quarter = wp.float64(0.25) * long2
        split_depth, _edge, _area = first_within(depth + 1, max_depth, legs2, quarter, edge2, area2)
    return split_depth


@wp.func
def leaves_below(
    asked: Asked,
    depth: wp.int32,
    max_depth: wp.int32,
    long2: wp.float64,
    legs2: wp.float64,
    climb2: wp.float64,
    finest2: wp.float64,
    longest_px2: wp.float64,
    largest_px2: wp.float64,
) -> wp.int32:
    """The depth from which on edges ask for no split anywhere below a diamond of `depth`, and are no new maxima.

    climb2: how far edges climb at most, squared metres. longest_px2, largest_px2: edges and areas of leaves up to these
    are no news. Others as in `splits_below`.
    """
    leaf_depth = wp.int32(0)
    if asked.measures_edges == 1:
        edge2 = smaller(asked.limit * asked.edge_px2, longest_px2) * finest2 - climb2
        area2 = smaller(asked.limit * asked.area_px2, largest_px2) * finest2 - climb2
        quarter = wp.float64(0.25) * long2
        leaf_depth, edge, area = first_within(depth + 1, max_depth, legs2, quarter, edge2, area2)
        if leaf_depth == max_depth:  # leaves whatever they measure, but maxima count
            edge2 = longest_px2 * finest2 - climb2
            area2 = largest_px2 * finest2 - climb2
            leaf_depth, edge, area = first_within(leaf_depth, max_depth + 1, edge, area, edge2, area2)
    return leaf_depth
