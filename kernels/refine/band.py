# SPDX-License-Identifier: GPL-3.0-or-later
"""A band: what is certain of all diamonds below one that is split, from the finest and the coarsest pixel on its box.

Boxes and errors are nested, so what holds for the diamond holds for those below it. Margins are
far above rounding: what a band says, measuring would say.
"""

import warp as wp

from ..field.domain import Domain
from .diamond import Diamond, diamond_at, larger, metres2_of, own_for, rest_of, smaller
from .pixels import CriterionArrays, coarsest, finest, sizes, too_coarse_at

ABOVE = wp.constant(wp.float64(1.0 + 1e-9))
BELOW = wp.constant(wp.float64(1.0 - 1e-9))
# Verdicts on a triangle, by its diamond.
LEAF = wp.constant(0)
SPLIT = wp.constant(1)
DOUBT = wp.constant(2)  # only measuring can tell
EVEN_BLOCK = wp.constant(3)  # its leaves are all of one depth
REUSED = wp.constant(4)  # its leaves are copied from the last frame


@wp.struct
class Limits:
    """What is asked, as bands compare it."""

    error_px: wp.float64
    metres_below: wp.float64
    metres_above: wp.float64
    finer: wp.float64  # on squared spans of a pixel: as fine as they may become
    coarser: wp.float64  # ... as coarse
    per_error2: wp.float64  # squared spans of a pixel per squared metre at which a diamond is split
    per_edge2: wp.float64
    per_area2: wp.float64
    edge2: wp.float64  # squared edges, and twice the areas, per squared span of a pixel
    area2: wp.float64


@wp.struct
class Measured:
    """A diamond as the views see it."""

    diamond: Diamond
    pixel2: wp.float64  # squared metres that a pixel spans at least
    own: wp.float64  # metres of its own error
    rest: wp.float64  # metres that rounding to float32 adds
    metres2: wp.float64  # see `metres2_of`
    long2: wp.float64  # of level triangles, see `sizes`
    legs2: wp.float64
    climb2: wp.float64  # how far edges climb, squared metres


@wp.struct
class Band:
    """What a diamond says of those below it."""

    split_above: wp.float64  # metres of own error: above, a diamond is split
    leaf_up_to: wp.float64  # ... up to these no error asks for a split
    split_depth: wp.int32  # above it edges ask for a split
    leaf_depth: wp.int32  # from it on they do not; both end one below the deepest leaves
    calm: wp.int32  # 1: no error below asks for a split, so that depths alone decide
    even_depth: wp.int32  # ... and all leaves are of this depth; 0: they may differ
    in_frame: wp.int32  # 1: the frustums of all views hold it


@wp.func
def limits_of(asked: CriterionArrays, slack: wp.float64) -> Limits:
    """slack: the part by which spans of a pixel may change without any doubt of what a band says."""
    one = wp.float64(1.0)
    limits = Limits()
    limits.error_px = wp.sqrt(asked.limit * asked.error_px2)
    limits.metres_below = wp.sqrt(asked.limit * asked.metres2 * BELOW)
    limits.metres_above = wp.sqrt(asked.limit * asked.metres2 * ABOVE)
    limits.finer = (one - slack) * (one - slack) * BELOW
    limits.coarser = (one + slack) * (one + slack) * ABOVE
    limits.per_error2 = one / (asked.limit * asked.error_px2)
    limits.per_edge2 = one / (asked.limit * asked.edge_px2)
    limits.per_area2 = one / (asked.limit * asked.area_px2)
    limits.edge2 = asked.limit * asked.edge_px2
    limits.area2 = asked.limit * asked.area_px2
    return limits


@wp.func
def measured_at(
    domain: Domain,
    asked: CriterionArrays,
    x: wp.int32,
    y: wp.int32,
    depth: wp.int32,
    error: wp.float32,
    in_frame: wp.int32,
) -> Measured:
    """Measure the diamond split at (x, y); in_frame: 1 where it is known that the frustums hold its box."""
    m = Measured()
    m.diamond = diamond_at(domain, x, y, depth)
    m.pixel2 = finest(asked, m.diamond, in_frame)
    m.own = wp.float64(error) * domain.error_scale
    m.rest = rest_of(domain, m.diamond)
    m.metres2 = metres2_of(domain, error, m.rest)
    long2, legs2 = sizes(asked, domain.unit_bits, depth)
    m.long2 = long2
    m.legs2 = legs2
    m.climb2 = m.diamond.rise * m.diamond.rise
    return m


@wp.func
def too_coarse(asked: CriterionArrays, limit: wp.float64, m: Measured) -> wp.bool:
    """Whether a diamond is to be split at `limit` times what is asked: criteria combine by or."""
    return too_coarse_at(asked, limit, m.pixel2, m.metres2, m.long2 + m.climb2, m.legs2 + m.climb2)


@wp.func
def turning_span(limits: Limits, m: Measured) -> wp.float64:
    """Metres of a pixel at which the diamond would be decided otherwise, as far as pixels decide."""
    edges2 = larger((m.long2 + m.climb2) * limits.per_edge2, (m.legs2 + m.climb2) * limits.per_area2)
    return wp.sqrt(larger(m.metres2 * limits.per_error2, edges2))


@wp.func
def nothing_certain() -> Band:
    """The band of what has not been measured."""
    band = Band()
    band.split_above = wp.float64(wp.inf)
    band.leaf_up_to = wp.float64(-1.0)
    band.leaf_depth = 1 << 30
    return band


@wp.func
def foretold(band: Band, depth: wp.int32, sure: wp.float64, own: wp.float64) -> wp.int32:
    """The verdict on a diamond below, of `sure` to `own` metres of error: whether it should be split."""
    verdict = wp.int32(LEAF)
    if depth < band.split_depth or sure > band.split_above:
        verdict = SPLIT
    elif depth < band.leaf_depth or own > band.leaf_up_to:
        verdict = DOUBT
    return verdict


@wp.func
def first_within(
    limits: Limits, depth: wp.int32, end: wp.int32, m: Measured, climb2: wp.float64, pixel2: wp.float64
) -> wp.int32:
    """The first depth below a diamond of `depth`, `end` at most, whose edges and areas ask for no split.

    A bisection makes the legs the longest edge; new legs are half of it. climb2: how far edges climb, squared metres.
    """
    edge2 = limits.edge2 * pixel2 - climb2
    area2 = limits.area2 * pixel2 - climb2
    found = depth + 1
    edge = m.legs2
    area = wp.float64(0.25) * m.long2
    while found < end and (edge > edge2 or area > area2):
        legs = wp.float64(0.25) * edge
        edge = area
        area = legs
        found += 1
    return found


@wp.func
def band_below(
    domain: Domain,
    asked: CriterionArrays,
    limits: Limits,
    coarse: Limits,
    m: Measured,
    depth: wp.int32,
    max_depth: wp.int32,
    in_frame: wp.int32,
) -> Band:
    """What is certain below a diamond that is split, from `limits` up to `coarse`, the same ones but in a count."""
    band = Band()
    fine2 = m.pixel2 * limits.finer
    band.leaf_up_to = wp.float64(wp.inf)  # errors are nested: below none there are none
    if m.own > wp.float64(0.0):
        band.leaf_up_to = own_for(domain, smaller(limits.error_px * wp.sqrt(fine2), limits.metres_below), m.rest)
    if asked.measures_edges == 1:
        band.leaf_depth = first_within(limits, depth, max_depth + 1, m, m.climb2, fine2)
        band.calm = wp.int32(m.own <= band.leaf_up_to)
    if band.calm == 1 and band.leaf_depth == depth + 1:  # whatever the coarsest pixel is
        band.split_above = wp.float64(wp.inf)
        band.split_depth = depth + 1
        band.in_frame = in_frame
    else:
        coarse2, inside = coarsest(asked, m.diamond, in_frame)
        coarse2 = coarse2 * limits.coarser
        band.split_above = wp.float64(wp.inf)
        if m.own > wp.float64(0.0):
            above = smaller(coarse.error_px * wp.sqrt(coarse2), coarse.metres_above)
            band.split_above = own_for(domain, above, domain.rounding)
        if asked.measures_edges == 1:
            band.split_depth = first_within(coarse, depth, max_depth + 1, m, wp.float64(0.0), coarse2)
        band.in_frame = inside
    if band.calm == 1 and band.split_depth == band.leaf_depth:
        band.even_depth = wp.min(band.leaf_depth, max_depth)
    return band
