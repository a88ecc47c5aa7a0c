# SPDX-License-Identifier: GPL-3.0-or-later
"""LOD intervals: which descendants of a split diamond will certainly be split, and which will certainly be leaves.

The finest and the coarsest pixel footprint on the diamond's box bound the footprints of all its descendants, since
boxes and errors are nested. Margins are far above rounding: measuring a descendant never contradicts an interval. A
pixel footprint is the length, metres, that a pixel spans; errors and edges in pixels are metres over footprints.

`criterion`: limits of errors and edges, and the views. `limits`: the same with margins; `per_...` are squared
footprints per squared metre at which a diamond is split. `m`: a measured diamond. Names that end in 2 are squared:
`pixel2` and `edge2`, the finest footprints of heights and edges on its box; `metres2`, the error that the criterion
compares; `long2`, the longest edge of a level triangle; `legs2`, twice its area; `climb2`, the largest height
difference along an edge. In an interval, diamonds before `split_depth` or with errors above `split_above` are split;
those from `leaf_depth` on with errors up to `leaf_up_to` are leaves.
"""

import warp as wp

from ..field.domain import Domain
from .diamond import Diamond, diamond_at, larger, max_error_for, metres2_of, rest_of, smaller
from .pixels import CriterionArrays, coarsest, finest, sizes, too_coarse_at

ABOVE = wp.constant(wp.float64(1.0 + 1e-9))
BELOW = wp.constant(wp.float64(1.0 - 1e-9))
# Verdicts on a triangle, by its diamond.
LEAF = wp.constant(0)
SPLIT = wp.constant(1)
DOUBT = wp.constant(2)  # the diamond must be measured
EVEN_BLOCK = wp.constant(3)  # its leaves are all of one depth
REUSED = wp.constant(4)  # its leaves are copied from the last frame


@wp.struct
class Limits:
    """The criterion in the form that intervals compare, with margins for rounding and for changes of footprints."""

    error_px: wp.float64  # limit of the error, pixels
    metres_below: wp.float64  # limit of the error, metres, with a margin downwards
    metres_above: wp.float64  # ... with a margin upwards
    finer: wp.float64  # factor from a squared footprint to the finest that it may become
    coarser: wp.float64  # ... to the coarsest
    per_error2: wp.float64  # squared footprint per squared metre of error at which a diamond is split
    per_edge2: wp.float64
    per_area2: wp.float64
    edge2: wp.float64  # limit of squared edges, per squared footprint
    area2: wp.float64  # limit of twice the area, per squared footprint


@wp.struct
class MeasuredDiamond:
    """A diamond as the views see it."""

    middle: wp.vec2i  # the vertex at which it is split
    diamond: Diamond
    pixel2: wp.float64  # squared metres of height that a pixel spans at least
    edge2: wp.float64  # ... of an edge, which has no slant
    error_m: wp.float64  # stored error, metres
    rest: wp.float64  # metres that rounding to float32 adds
    metres2: wp.float64  # squared metres of height that the criterion compares with footprints
    long2: wp.float64  # squared longest edge of a horizontal triangle, metres of camera space
    legs2: wp.float64  # ... and twice its area
    climb2: wp.float64  # squared largest height difference along one of its edges, metres
    verdict: wp.int32  # SPLIT or LEAF, as the walk judges it


@wp.struct
class LodInterval:
    """Bounds that a split diamond gives for the diamonds below it."""

    split_above: wp.float64  # metres: a diamond with a larger stored error is split
    leaf_up_to: wp.float64  # metres: a stored error up to this never requires a split
    split_depth: wp.int32  # edges require a split at smaller depths
    leaf_depth: wp.int32  # edges require none from this depth on; both end one below the deepest leaves
    depths_decide: wp.int32  # 1: no error below requires a split, so depths alone decide
    even_depth: wp.int32  # depth of all leaves below; 0: depths may differ
    in_frame: wp.int32  # 1: the frustums of all views contain the box


@wp.func
def limits_of(criterion: CriterionArrays, slack: wp.float64) -> Limits:
    """Return the criterion as the limits that intervals compare.

    slack: fraction by which footprints may change without changing a verdict. criterion.limit: squared factor by which
    the criterion is relaxed. BELOW, ABOVE: 1 less or plus a margin for rounding.
    """
    one = wp.float64(1.0)
    limits = Limits()
    limits.error_px = wp.sqrt(criterion.limit * criterion.error_px2)
    limits.metres_below = wp.sqrt(criterion.limit * criterion.metres2 * BELOW)
    limits.metres_above = wp.sqrt(criterion.limit * criterion.metres2 * ABOVE)
    limits.finer = (one - slack) * (one - slack) * BELOW
    limits.coarser = (one + slack) * (one + slack) * ABOVE
    limits.per_error2 = one / (criterion.limit * criterion.error_px2)
    limits.per_edge2 = one / (criterion.limit * criterion.edge_px2)
    limits.per_area2 = one / (criterion.limit * criterion.area_px2)
    limits.edge2 = criterion.limit * criterion.edge_px2
    limits.area2 = criterion.limit * criterion.area_px2
    return limits


@wp.func
def measure_diamond(
    domain: Domain,
    criterion: CriterionArrays,
    x: wp.int32,
    y: wp.int32,
    depth: wp.int32,
    error: wp.float32,
    in_frame: wp.int32,
) -> MeasuredDiamond:
    """Return the diamond at `depth` that is split at (x, y) as all views see it: footprints, error and edge lengths.

    error: stored error, metres before scaling. in_frame: 1 if all frustums are known to contain its box. `verdict` is
    left to the caller.
    """
    m = MeasuredDiamond()
    m.middle = wp.vec2i(x, y)
    m.diamond = diamond_at(domain, x, y, depth)
    pixel2, edge2 = finest(criterion, m.diamond, in_frame)
    m.pixel2 = pixel2
    m.edge2 = edge2
    m.error_m = wp.float64(error) * domain.error_scale
    m.rest = rest_of(domain, m.diamond)  # error by float32 rounding, metres
    m.metres2 = metres2_of(domain, error, m.rest)  # total error as the criterion weighs it
    long2, legs2 = sizes(criterion, domain.unit_bits, depth)  # of a level triangle
    m.long2 = long2
    m.legs2 = legs2
    m.climb2 = m.diamond.rise * m.diamond.rise
    return m


@wp.func
def too_coarse(criterion: CriterionArrays, limit: wp.float64, m: MeasuredDiamond) -> wp.bool:
    """Return whether a diamond exceeds any criterion. limit: factor on the squared criteria, for a triangle limit."""
    return too_coarse_at(criterion, limit, m.pixel2, m.edge2, m.metres2, m.long2 + m.climb2, m.legs2 + m.climb2)


@wp.func
def rise_to_turn(limits: Limits, m: MeasuredDiamond) -> wp.float64:
    """Return by how many metres pixel footprints must grow until the decision on the diamond (split or leaf) changes.

    The result is less than 0 if they must shrink. Limits in metres are ignored: footprints do not affect them.
    """
    edges2 = larger((m.long2 + m.climb2) * limits.per_edge2, (m.legs2 + m.climb2) * limits.per_area2)
    of_error = wp.sqrt(m.metres2 * limits.per_error2) - wp.sqrt(m.pixel2)
    return larger(of_error, wp.sqrt(edges2) - wp.sqrt(m.edge2))


@wp.func
def excess2(limits: Limits, m: MeasuredDiamond) -> wp.float64:
    """Estimate the largest squared ratio of a diamond's errors and edges to their limits (`too_coarse` is exact)."""
    long2 = m.long2 + m.climb2
    legs2 = m.legs2 + m.climb2
    largest2 = larger(long2 * limits.per_edge2, legs2 * limits.per_area2) / m.edge2
    largest2 = larger(m.metres2 * limits.per_error2 / m.pixel2, largest2)
    return larger(largest2, m.metres2 / (limits.metres_above * limits.metres_above))


@wp.func
def unknown_interval() -> LodInterval:
    """Return the interval that decides nothing: every diamond below has to be measured."""
    interval = LodInterval()
    interval.split_above = wp.float64(wp.inf)
    interval.leaf_up_to = wp.float64(-1.0)
    interval.leaf_depth = 1 << 30
    return interval


@wp.func
def predict(interval: LodInterval, depth: wp.int32, min_error: wp.float64, error_m: wp.float64) -> wp.int32:
    """Return the verdict on a diamond at `depth` below an interval: SPLIT, LEAF, or DOUBT if it must be measured.

    min_error, error_m: metres between which the diamond's error is; both 0 if depths alone decide.
    """
    verdict = wp.int32(LEAF)
    if depth < interval.split_depth or min_error > interval.split_above:
        verdict = SPLIT
    elif depth < interval.leaf_depth or error_m > interval.leaf_up_to:
        verdict = DOUBT
    return verdict


@wp.func
def first_within(
    limits: Limits, depth: wp.int32, end: wp.int32, m: MeasuredDiamond, climb2: wp.float64, pixel2: wp.float64
) -> wp.int32:
    """Return the first depth below `depth`, at most `end`, at which edges and areas require no split.

    Bisection turns the legs into the longest edge; the new legs are half the old longest edge. Twice the area of a
    triangle is the square of its legs, so that its limit is one of squared legs. climb2: squared height difference
    along an edge, metres. pixel2: squared pixel footprint of edges, metres. limits.edge2, area2: the largest squared
    edge and squared legs, in squared footprints.
    """
    max_long2 = limits.edge2 * pixel2 - climb2
    max_legs2 = limits.area2 * pixel2 - climb2
    first = depth + 1
    long2 = m.legs2
    legs2 = wp.float64(0.25) * m.long2
    while first < end and (long2 > max_long2 or legs2 > max_legs2):
        next_legs2 = wp.float64(0.25) * long2
        long2 = legs2
        legs2 = next_legs2
        first += 1
    return first


@wp.func
def interval_below(
    domain: Domain,
    criterion: CriterionArrays,
    limits: Limits,
    coarse: Limits,
    m: MeasuredDiamond,
    depth: wp.int32,
    max_depth: wp.int32,
    in_frame: wp.int32,
) -> LodInterval:
    """Return the interval below a split diamond, which decides many of its descendants without measuring them.

    It holds for all limits from `limits` (the finest) to `coarse`. The walk passes the same limits twice. A count of
    leaves for several tolerances at once (kernels/budget) passes its finest and its coarsest. m: the measured diamond,
    at `depth`. max_depth: at this depth all triangles are leaves. in_frame: 1 if all frustums are known to contain the
    diamond's box. `max_error_for` converts permitted metres to a stored error, for given metres of rounding (`rest`).
    """
    interval = LodInterval()
    fine2 = m.pixel2 * limits.finer
    interval.leaf_up_to = wp.float64(wp.inf)  # without an error: no diamond below has one
    if m.error_m > wp.float64(0.0):
        interval.leaf_up_to = max_error_for(
            domain, smaller(limits.error_px * wp.sqrt(fine2), limits.metres_below), m.rest
        )
    if criterion.measures_edges == 1:
        interval.leaf_depth = first_within(limits, depth, max_depth + 1, m, m.climb2, m.edge2 * limits.finer)
        interval.depths_decide = wp.int32(m.error_m <= interval.leaf_up_to)  # 1: no error below requires a split
    # The children are leaves, whatever the coarsest footprint is.
    if interval.depths_decide == 1 and interval.leaf_depth == depth + 1:
        interval.split_above = wp.float64(wp.inf)
        interval.split_depth = depth + 1
        interval.in_frame = in_frame
    else:
        coarse2, edge2, is_in_frame = coarsest(criterion, m.diamond, in_frame)
        coarse2 = coarse2 * limits.coarser
        interval.split_above = wp.float64(wp.inf)
        if m.error_m > wp.float64(0.0):
            split_metres = smaller(coarse.error_px * wp.sqrt(coarse2), coarse.metres_above)
            # Descendants have smaller boxes, so their `rest` is between domain.rounding and m.rest.
            interval.split_above = max_error_for(domain, split_metres, domain.rounding)
        if criterion.measures_edges == 1:
            # Edges below may be level, so their climb is 0.
            interval.split_depth = first_within(
                coarse, depth, max_depth + 1, m, wp.float64(0.0), edge2 * limits.coarser
            )
        interval.in_frame = is_in_frame
    if interval.depths_decide == 1 and interval.split_depth == interval.leaf_depth:  # all leaves have one depth
        interval.even_depth = wp.min(interval.leaf_depth, max_depth)
    return interval
