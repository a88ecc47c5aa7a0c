# SPDX-License-Identifier: GPL-3.0-or-later
"""A band: what is certain of all diamonds below one that is split, from the finest and the coarsest pixel on its box.

Boxes, errors and what resampling moved are nested, so what holds for the diamond holds for those below it. The curve
meets a diamond twice, once from either triangle; what it was found to be is remembered for the second time, until
another one takes its place: 54.7 nanoseconds a leaf with that memory and 57.6 without, for 1 M leaves of one error.
"""

import warp as wp

from .bounds import Bounds
from .diamond import (
    Asked,
    Diamond,
    Domain,
    coarsest,
    diamond_at,
    finest,
    larger,
    metres2_of,
    moved_at,
    own_for,
    sizes,
    smaller,
)

wp.set_module_options({"enable_backward": False})

REMEMBER_BITS = wp.constant(10)
REMEMBERED = wp.constant(1 << 10)  # diamonds that a walk remembers: 8 in 10 of those that it meets again
NOT_SPLIT = wp.constant(-1)
# Instead of an even depth, where only depths decide: which ones is in doubt, or may be found without measuring, since
# the frustum holds the ground and its squared range of heights is at most LEVEL of the squared edges of its leaves.
IN_DOUBT = wp.constant(-1)
LEVEL_GROUND = wp.constant(-2)
LEVEL = wp.constant(wp.float64(0.1))
WEIGHED = wp.constant(wp.float64(5.0))  # times its own error, at most: see `metres2_of`
ABOVE = wp.constant(wp.float64(1.0 + 1e-9))
BELOW = wp.constant(wp.float64(1.0 - 1e-9))


@wp.struct
class Limits:
    """What is asked, as bands compare it; margins are far above rounding."""

    error_px: wp.float64
    metres_below: wp.float64
    metres_above: wp.float64
    below: wp.float64  # 1, less what rounding may do
    finer: wp.float64  # on squared spans of a pixel: as fine as they may become
    coarser: wp.float64  # ... as coarse
    per_error2: wp.float64  # squared spans of a pixel per squared metre at which a diamond is split
    per_edge2: wp.float64
    per_area2: wp.float64


@wp.struct
class Measured:
    """A diamond as the views see it."""

    diamond: Diamond
    pixel2: wp.float64  # squared metres that a pixel spans at least
    own: wp.float64  # metres of its own error
    rest: wp.float64  # metres that resampling moved and that rounding adds
    moved: wp.float32
    metres2: wp.float64  # see `metres2_of`
    total2: wp.float64
    long2: wp.float64  # level edges and areas, see `sizes`
    legs2: wp.float64
    climb2: wp.float64  # how far edges climb, squared metres


@wp.struct
class Band:
    """What a diamond says of those below it."""

    split_above: wp.float64  # metres of own error: above, a diamond is split
    leaf_up_to: wp.float64  # ... up to these no error asks for a split
    fine2: wp.float64  # squared metres that a pixel spans at least
    rest: wp.float64  # metres of error that cannot be refined away, at most; the source's rounding too
    split_depth: wp.int32  # above it edges ask for a split; or NOT_SPLIT
    leaf_depth: wp.int32  # from it on they do not
    even_depth: wp.int32  # where only depths decide and in no doubt: the leaves'; see IN_DOUBT; 0: errors count
    clear: wp.int32  # the frustum holds the box
    mark: wp.int32  # in which subtree it was measured (kernels/refine/coherence.py)
    x: wp.int32  # the diamond's split vertex
    y: wp.int32


@wp.func
def limits_of(asked: Asked, slack: wp.float64) -> Limits:
    """slack: the part by which spans of a pixel may change without any doubt of what a band says."""
    one = wp.float64(1.0)
    limits = Limits()
    limits.error_px = wp.sqrt(asked.limit * asked.error_px2)
    limits.metres_below = wp.sqrt(asked.limit * asked.metres2 * BELOW)
    limits.metres_above = wp.sqrt(asked.limit * asked.metres2 * ABOVE)
    limits.below = BELOW
    limits.finer = (one - slack) * (one - slack) * BELOW
    limits.coarser = (one + slack) * (one + slack) * ABOVE
    limits.per_error2 = one / (asked.limit * asked.error_px2)
    limits.per_edge2 = one / (asked.limit * asked.edge_px2)
    limits.per_area2 = one / (asked.limit * asked.area_px2)
    return limits


@wp.func
def measured_at(
    domain: Domain, asked: Asked, x: wp.int32, y: wp.int32, depth: wp.int32, error: wp.float32, clear: wp.int32
) -> Measured:
    """Measure the diamond split at (x, y); clear: the frustum is known to hold it."""
    m = Measured()
    m.diamond = diamond_at(domain, x, y, depth)
    m.pixel2 = finest(asked, m.diamond, clear)
    m.moved = moved_at(domain, x, y, depth)
    m.own = wp.float64(error) * domain.error_scale
    m.rest = wp.float64(m.moved) * domain.error_scale + domain.rounding
    metres2, total2 = metres2_of(domain, error, m.moved)
    m.metres2 = metres2
    m.total2 = total2
    long2, legs2 = sizes(asked, domain.unit_bits, depth)
    m.long2 = long2
    m.legs2 = legs2
    m.climb2 = m.diamond.rise * m.diamond.rise
    return m


@wp.func
def turning_span(limits: Limits, m: Measured) -> wp.float64:
    """Metres of a pixel at which the diamond would be decided otherwise, as far as pixels decide."""
    edges2 = larger((m.long2 + m.climb2) * limits.per_edge2, (m.legs2 + m.climb2) * limits.per_area2)
    return wp.sqrt(larger(m.metres2 * limits.per_error2, edges2))


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
    band.rest = wp.float64(wp.inf)
    band.leaf_depth = 1 << 30
    return band


@wp.func
def quiet(band: Band, own: wp.float64, most: Bounds) -> wp.bool:
    """Whether a leaf below, of this own error, metres, has no more pixels of error than `most`."""
    total = own + band.rest
    weighed = smaller(total, WEIGHED * own)
    return weighed * weighed <= most.px2 * band.fine2 and total * total <= most.total_px2 * band.fine2


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


@wp.func
def band_below(
    domain: Domain,
    asked: Asked,
    limits: Limits,
    m: Measured,
    depth: wp.int32,
    max_depth: wp.int32,
    clear: wp.int32,
    worst: Bounds,
) -> Band:
    """What is certain below a diamond that is split. What may be more than `worst`, the maxima so far, is in doubt."""
    band = Band()
    fine2 = m.pixel2 * limits.finer
    band.leaf_up_to = own_for(smaller(limits.error_px * wp.sqrt(fine2), limits.metres_below), m.rest, domain.source)
    band.fine2 = m.pixel2 * limits.below
    band.rest = m.rest + domain.source
    band.leaf_depth = leaves_below(
        asked, depth, max_depth, m.long2, m.legs2, m.climb2, fine2, worst.long_px2, worst.legs_px2
    )
    # No error below asks for a split or is a new maximum: depths alone decide.
    calm = asked.measures_edges == 1 and m.own <= band.leaf_up_to and quiet(band, m.own, worst)
    calm = calm and m.metres2 <= worst.metres2 and m.total2 <= worst.total2
    if calm and band.leaf_depth == depth + 1:  # whatever the coarsest pixel is
        band.split_above = wp.float64(wp.inf)
        band.split_depth = depth + 1
        band.even_depth = depth + 1
        band.clear = clear
    else:
        coarse2, inside = coarsest(asked, m.diamond, clear)
        coarse2 = coarse2 * limits.coarser
        above = smaller(limits.error_px * wp.sqrt(coarse2), limits.metres_above)
        band.split_above = own_for(above, domain.rounding, domain.source)
        band.split_depth = splits_below(asked, depth, max_depth, m.long2, m.legs2, coarse2)
        band.clear = inside
        if calm:
            band.even_depth = IN_DOUBT
            if band.split_depth == band.leaf_depth:
                band.even_depth = band.leaf_depth
            elif inside == 1:
                height = m.diamond.high[2] - m.diamond.low[2]
                long2, _legs2 = sizes(asked, domain.unit_bits, band.leaf_depth)
                if height * height <= LEVEL * long2:
                    band.even_depth = LEVEL_GROUND
    return band


@wp.func
def unmeasured_below(domain: Domain, asked: Asked, band: Band, m: Measured, max_depth: wp.int32) -> Bounds:
    """What leaves below a diamond have at most that its band decides without measuring them."""
    most = Bounds()
    if asked.measures_edges == 1 and band.leaf_depth <= max_depth:
        long2, legs2 = sizes(asked, domain.unit_bits, band.leaf_depth)
        most.long_px2 = (long2 + m.climb2) / band.fine2
        most.legs_px2 = (legs2 + m.climb2) / band.fine2
    if band.even_depth != 0:
        total = m.own + band.rest
        weighed = smaller(total, WEIGHED * m.own)
        most.px2 = weighed * weighed / band.fine2
        most.total_px2 = total * total / band.fine2
        most.metres2 = m.metres2
        most.total2 = m.total2
    return most
