# SPDX-License-Identifier: GPL-3.0-or-later
"""A band: what is certain of all diamonds below one that is split, from the finest and the coarsest pixel on its box.

Boxes, errors and what resampling moved are nested, so what holds for the diamond holds for those below it. The curve
meets a diamond twice, once from either triangle; what it was found to be is remembered for the second time, until
another one takes its place. Nanoseconds a leaf with memory and without: 47.1 and 56.9 at 50,000 leaves of one edge
length, 17.4 and 20.0 at 1 M, 53.1 and 55.8 at 1 M of one error.
"""

import warp as wp

from .criterion import Asked, sizes, smaller

wp.set_module_options({"enable_backward": False})

REMEMBER_BITS = wp.constant(10)
REMEMBERED = wp.constant(1 << 10)  # diamonds that a walk remembers: 8 in 10 of those that it meets again
NOT_SPLIT = wp.constant(-1)


@wp.struct
class Band:
    """What a diamond says of those below it."""

    finest2: wp.float64  # squared metres of the finest pixel
    split_above2: wp.float64  # squared metres of error: above, a diamond is split
    leaf_up_to2: wp.float64  # ... and up to these no error asks for a split
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
    band.split_above2 = wp.float64(wp.inf)
    band.leaf_up_to2 = wp.float64(-1.0)
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
    asked: Asked,
    unit_bits: wp.int32,
    depth: wp.int32,
    end: wp.int32,
    climb2: wp.float64,
    edge2: wp.float64,
    area2: wp.float64,
) -> wp.int32:
    """The first depth after `depth`, `end` at most, where edges and areas are within these."""
    found = depth + 1
    looking = wp.int32(1)
    while looking == 1 and found < end:
        long2, legs2 = sizes(asked, unit_bits, found)
        if long2 + climb2 > edge2 or legs2 + climb2 > area2:
            found += 1
        else:
            looking = 0
    return found


@wp.func
def band_below(
    asked: Asked,
    unit_bits: wp.int32,
    depth: wp.int32,
    max_depth: wp.int32,
    finest2: wp.float64,
    coarsest2: wp.float64,
    climb2: wp.float64,
    longest_px2: wp.float64,
    largest_px2: wp.float64,
) -> Band:
    """The band below a diamond of `depth`, whose edges climb sqrt(climb2) at most.

    finest2, coarsest2: squared metres of pixels on its box. longest_px2, largest_px2: edges and areas of leaves up to
    these are no news. `even_depth` is left open.
    """
    band = Band()
    band.finest2 = finest2
    metres2 = asked.limit * asked.metres2
    error_px2 = asked.limit * asked.error_px2
    band.leaf_up_to2 = smaller(error_px2 * finest2, metres2)
    band.split_above2 = smaller(error_px2 * coarsest2, metres2)
    if asked.measures_edges == 1:
        edge_px2 = asked.limit * asked.edge_px2
        area_px2 = asked.limit * asked.area_px2
        band.split_depth = first_within(
            asked, unit_bits, depth, max_depth, wp.float64(0.0), edge_px2 * coarsest2, area_px2 * coarsest2
        )
        band.leaf_depth = first_within(
            asked,
            unit_bits,
            band.split_depth - 1,
            max_depth,
            climb2,
            smaller(edge_px2, longest_px2) * finest2,
            smaller(area_px2, largest_px2) * finest2,
        )
        if band.leaf_depth == max_depth:  # leaves whatever they measure, but maxima count
            band.leaf_depth = first_within(
                asked,
                unit_bits,
                max_depth - 1,
                max_depth + 1,
                climb2,
                longest_px2 * finest2,
                largest_px2 * finest2,
            )
    return band
