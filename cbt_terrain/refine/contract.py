# SPDX-License-Identifier: GPL-3.0-or-later
"""Reported bounds: the request times the relaxation factor of a triangle limit, or more if that cannot be guaranteed.

A bound is larger where a leaf at the depth limit is still too coarse, and where the rounding of float32 and of the
source exceeds the request. Errors on screen are computed in *spans*, or pixel footprints: metres of height over the
metres that a pixel covers there; Spans converts them to pixels.

With geomorphing the surface is a mean of the meshes for 1 .. k times the tolerance t of the finest mesh. Any excess
over its tolerance is largest in the finest mesh. So the mean's error is at most the finest mesh's plus (m - 1) t, with
m from `mean_ramp`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.refine.excess import ANY, AREA, EDGE, ERROR, FIXED, METRES, STACK, Triangle, find_largest
from ...kernels.refine.pixels import CriterionArrays
from ..run import launch
from ..run.buffers import Buffers
from ..tree.concurrent_binary_tree import ConcurrentBinaryTree
from ..view.criterion import LARGEST, Criterion
from ..view.morph import mean_ramp
from ..view.spans import Spans
from .reported_bounds import ReportedBounds
from .terms import MARGIN, Terms, weighed_as

# If no factor on the criterion meets a triangle limit, the factor of the root triangles is reported, up to this.
MAX_FACTOR = 1e100
NO_THRESHOLD = -1.0  # of `Outcome.search`: any value is above it
# Reasons why a bound exceeds the request; if several apply, the first is reported.
REASONS = ("max_triangles", "max_depth", "precision", "source")


@dataclass(frozen=True)
class Bound:
    """A bound, the reason why it exceeds the request (one of REASONS, or ""), and the terms of an error's bound."""

    value: float
    reason: str = ""
    terms: Terms | None = None


@dataclass(frozen=True)
class Excess:
    """The largest value of a quantity on the ground.

    `value`: pixel footprints or metres. `fixed`: metres of it from the rounding of float32 and of the source, which
    cannot be refined away. `total`: metres of all error.
    """

    value: float
    fixed: float
    total: float


@dataclass(frozen=True)
class Outcome:
    """A refinement and how it ended.

    `relaxed`: the factor by which a triangle limit coarsened the criterion; infinity if no factor is enough and the
    mesh is the root triangles. `stopped`: whether a leaf at `max_depth` is still too coarse. `deepest`: the depth of
    the deepest leaf. `tree`: holds the leaves; `squares` is its node for the first root square. `relief`: metres
    between the lowest and the highest point. `in_frame`: returns `arrays` without the guard band.
    """

    domain: Domain
    arrays: CriterionArrays
    relaxed: float
    stopped: bool
    max_depth: int
    deepest: int
    tree: ConcurrentBinaryTree
    squares: int
    relief: float
    buffers: Buffers
    in_frame: Callable[[], CriterionArrays]

    def search(self, quantity: int, threshold: float) -> Excess | None:
        """Find the largest value of a quantity among leaves at the depth limit; None if none is above `threshold`.

        quantity: FIXED (the error by rounding alone), ERROR, EDGE or AREA on ground in view, or METRES anywhere.
        threshold: in the unit of the result's `value`, or NO_THRESHOLD. With ANY as `max_depth` all leaves of the tree
        are searched; `threshold` must then be the tolerance to which they were refined. The result is rounded up by at
        most a thousandth, for ERROR by a hundredth.
        """
        stack, result = self.buffers.get("excess_stack", STACK, Triangle), self.buffers.get("excess", 3, wp.float64)
        inputs = [
            self.domain,
            self.arrays,
            quantity,
            self.max_depth,
            math.copysign(threshold * threshold, threshold),  # of squares; NO_THRESHOLD stays below all of them
            self.tree.bits,
            self.squares,
            stack,
            result,
        ]
        launch.once(find_largest, inputs, step="bound")
        value2, fixed_m, total_m = self.buffers.numpy("excess")[:3].tolist()
        # -1: no leaf has a value above the threshold
        return None if total_m < 0.0 else Excess(math.sqrt(value2), fixed_m, total_m)

    def relaxation(self, quantity: int, request: float) -> float:
        """Return the finite factor by which the mesh exceeds a request of a quantity.

        request: in the unit of the values of `search`. If no factor meets the triangle limit, the mesh is the root
        triangles, and the factor is theirs: the largest value that `search` finds without a threshold, over `request`.
        """
        if self.relaxed < math.inf:
            return self.relaxed
        worst = replace(self, max_depth=1).search(quantity, NO_THRESHOLD)  # among the root triangles, of depth 1
        return min(max(worst.value / request, 1.0), MAX_FACTOR) if worst else 1.0

    def stopped_above(self, quantity: int, threshold: float) -> Excess | None:
        """Find the largest value above `threshold` of a quantity if a leaf at the depth limit is too coarse."""
        return self.search(quantity, threshold) if self.stopped else None

    def tighten(
        self, quantity: int, tolerance: float, guaranteed: float, request: float
    ) -> tuple[float, Excess | None]:
        """Return the smaller of two bounds of an error, and the worst leaf's error if that was searched.

        The bounds are `guaranteed` and the error of the worst leaf. Leaves, which are refined to `tolerance`, are
        searched only if rounding makes `guaranteed` exceed `request`. They are not searched if the depth limit stopped
        a leaf: `stopped_above` finds its error. quantity: ERROR, with all numbers in pixel footprints, or METRES.
        """
        if self.stopped or guaranteed <= request * (1 + MARGIN):
            return guaranteed, None
        worst = replace(self, max_depth=ANY).search(quantity, tolerance)
        return min(guaranteed, worst.value if worst else tolerance), worst


def bounds_of(criterion: Criterion, spans: Spans, outcome: Outcome) -> ReportedBounds:
    """Return the bounds of a refined mesh that an update reports, with reasons where they exceed the request.

    spans: factors between pixels and footprints of the views. outcome: the refinement and how it ended.
    """
    px, metres = bound_px(criterion, spans, outcome), bound_m(criterion, outcome)
    edge, area = bound_edge_px(criterion, spans, outcome), bound_area_px(criterion, spans, outcome)
    relaxed = factor_of(criterion, outcome, [px, metres, edge, area])
    return ReportedBounds(
        bound_px=px.value if px else None,
        bound_m=metres.value if metres else None,
        bound_edge_px=edge.value if edge else None,
        bound_area_px=area.value if area else None,
        terms_px=px.terms if px else None,
        terms_m=metres.terms if metres else None,
        relaxed=relaxed,
        limited=reason_of([px, metres, edge, area], relaxed),
    )


def reason_of(bounds: list[Bound | None], relaxed: float) -> str:
    """Return the first of REASONS why a bound of a refinement exceeds the request, "" if none does.

    relaxed: factor by which a triangle limit coarsened the criterion.
    """
    reasons = {bound.reason for bound in bounds if bound} | ({"max_triangles"} if relaxed > 1 else set())
    return next((reason for reason in REASONS if reason in reasons), "")


def bound_px(criterion: Criterion, spans: Spans, outcome: Outcome) -> Bound | None:
    """Return the bound of the distance on screen between a point and its true position, pixels; 0 if none is in view.

    None without that criterion or without views. outcome: the refinement and how it ended. spans: factors between
    pixels and footprints.
    """
    if not criterion.error_px or not spans.views:
        return None
    bound = _bound_px(criterion, spans, outcome)
    if bound.reason:  # ground in the guard band may be nearer than the visible ground
        bound = _bound_px(criterion, spans, replace(outcome, arrays=outcome.in_frame()))
    return bound


def _bound_px(criterion: Criterion, spans: Spans, outcome: Outcome) -> Bound:
    """Return the bound of the screen error for the views of `outcome.arrays`; 0 if no ground is in view.

    It is computed in spans (pixel footprints) and converted at the end. A bound within the request is not converted:
    the views' scales make an error of so many spans at most as many pixels. `tolerance` is that of the finest mesh that
    morphs, `fixed` the largest error that cannot be refined away.
    """
    fixed = outcome.search(FIXED, NO_THRESHOLD)
    if fixed is None:
        return Bound(0.0, "", Terms(0.0, 0.0, 0.0))
    morph_factor, source = mean_ramp(criterion.morph_until), outcome.domain.source
    relaxed_request = criterion.error_px * outcome.relaxation(ERROR, criterion.error_px / morph_factor)
    tolerance = relaxed_request / morph_factor
    morph_error = relaxed_request - tolerance
    min_fixed, max_fixed = outcome.domain.rounding + source, _rounding_error(outcome)
    # The source's rounding is a fraction of the fixed error that varies over the ground: source over `max_fixed` at
    # least, and over `min_fixed` at most.
    source_low, source_high = (source * fixed.value / metres if metres else 0.0 for metres in (max_fixed, min_fixed))
    guaranteed = _guaranteed(tolerance, fixed.value, source_low, source_high)
    # At least `min_fixed` metres cannot be refined away anywhere, so a metre is at most fixed.value / min_fixed spans.
    limit = fixed.value * (1 + outcome.relief / min_fixed) if min_fixed else 0.0
    too_coarse = outcome.stopped_above(ERROR, min(guaranteed, limit))
    guaranteed, worst = outcome.tighten(ERROR, tolerance, guaranteed, request=tolerance)
    guaranteed = min(guaranteed + morph_error, limit)
    worst_leaf = too_coarse or worst or fixed
    spans_per_metre = worst_leaf.value / worst_leaf.total if worst_leaf.total else 0.0
    value = too_coarse.value + morph_error if too_coarse else guaranteed
    precision = (worst_leaf.fixed - source) * spans_per_metre
    bound = _limit_bound(relaxed_request, value, precision, source * spans_per_metre, stopped=too_coarse is not None)
    if bound.value <= criterion.error_px:
        return bound
    pixels = min(spans.pixels(bound.value), LARGEST)
    assert bound.terms is not None, "_limit_bound gives terms"
    terms = Terms.shares(pixels, bound.terms.geometric, bound.terms.precision, bound.terms.source)
    return Bound(pixels, bound.reason, terms)


def bound_m(criterion: Criterion, outcome: Outcome) -> Bound | None:
    """Return the bound of the height, metres, between mesh and surface anywhere; None without that criterion.

    It is the request times the relaxation factor, or more if rounding or the depth limit prevents that. outcome: the
    refinement and how it ended. `tolerance` is the error, weighed as the criterion does, to which the finest mesh that
    morphs is refined; geomorphing adds `morph_error` to the mesh's error.
    """
    if not criterion.error_m:
        return None
    fixed, source, morph_factor = _rounding_error(outcome), outcome.domain.source, mean_ramp(criterion.morph_until)
    tolerance = weighed_as(criterion.error_m, source, morph_factor)
    factor = outcome.relaxation(METRES, tolerance)
    tolerance *= factor
    # The source's part of `fixed` is the same everywhere, so its lower and upper limit are equal. No error exceeds the
    # range of heights and the rounding.
    guaranteed, limit = _guaranteed(tolerance, fixed, source, source), outcome.relief + fixed
    relaxed_request, morph_error = criterion.error_m * factor, (morph_factor - 1) * tolerance
    too_coarse = outcome.stopped_above(METRES, min(guaranteed, limit))
    guaranteed, _worst = outcome.tighten(METRES, tolerance, guaranteed, request=relaxed_request - morph_error)
    precision = (too_coarse.fixed if too_coarse else fixed) - source  # rounding of float32 alone
    value = too_coarse.value + morph_error if too_coarse else min(guaranteed + morph_error, limit)
    return _limit_bound(relaxed_request, value, precision, source, stopped=too_coarse is not None)


def bound_edge_px(criterion: Criterion, spans: Spans, outcome: Outcome) -> Bound | None:
    """Return the bound of the longest edge between float32 corners, pixels; None without that criterion.

    The search measures edges in spans, `spans.edge` of them a pixel. `lengthening`: factor by which rounding to float32
    lengthens edges.
    """
    if not criterion.edge_px:
        return None
    morph_factor = mean_ramp(criterion.morph_until)
    relaxed_request = criterion.edge_px * outcome.relaxation(EDGE, criterion.edge_px / morph_factor * spans.edge)
    tolerance = relaxed_request / morph_factor
    too_coarse = outcome.stopped_above(EDGE, tolerance * spans.edge)
    lengthening = spans.excess_of_edges(outcome.deepest)
    longest = too_coarse.value / spans.edge + (relaxed_request - tolerance) if too_coarse else relaxed_request
    return Bound(min(longest * lengthening, LARGEST), _edge_reason(too_coarse, lengthening))


def bound_area_px(criterion: Criterion, spans: Spans, outcome: Outcome) -> Bound | None:
    """Return the bound of the largest triangle, square pixels; None without that criterion.

    The search uses the square root of twice the area: the leg of a right triangle of two equal legs. So bounds are
    computed as lengths, pixels; float32 positions lengthen edges by the factor `lengthening`. spans: pixel footprints
    of the views. outcome: result of the refinement.
    """
    if not criterion.area_px:
        return None
    request, morph_factor = math.sqrt(2 * criterion.area_px), mean_ramp(criterion.morph_until)
    factor = outcome.relaxation(AREA, request / morph_factor * spans.edge)
    relaxed_request, tolerance = request * factor, request * factor / morph_factor
    too_coarse = outcome.stopped_above(AREA, tolerance * spans.edge)
    lengthening = spans.excess_of_edges(outcome.deepest)
    longest = too_coarse.value / spans.edge + (relaxed_request - tolerance) if too_coarse else relaxed_request
    area = 0.5 * longest * longest if too_coarse else criterion.area_px * factor * factor
    return Bound(min(area * lengthening * lengthening, LARGEST), _edge_reason(too_coarse, lengthening))


def factor_of(criterion: Criterion, outcome: Outcome, bounds: list[Bound | None]) -> float:
    """Return the finite factor by which a triangle limit coarsened a criterion.

    If no factor is enough, it is the largest ratio of a bound to its request; the area grows with the square of it.
    bounds: screen error, height error, edge and area, None for those that the criterion does not limit.
    """
    if outcome.relaxed < math.inf:
        return outcome.relaxed
    requests = criterion.error_px, criterion.error_m, criterion.edge_px, criterion.area_px
    *ratios, of_area = (
        bound.value / request if bound else 0.0 for bound, request in zip(bounds, requests, strict=True)
    )
    return max(1.0, *ratios, math.sqrt(of_area))


def _rounding_error(outcome: Outcome) -> float:
    """Return the largest error, metres, that refining cannot remove: the rounding of float32 and of the source."""
    d = outcome.domain
    return d.rounding + min(d.lean * outcome.relief, d.max_lean) + d.source


def _guaranteed(weighed: float, fixed: float, source_low: float, source_high: float) -> float:
    """Return the total error that leaves guarantee unless the depth limit stopped them, in the unit of `weighed`.

    weighed: largest error as the criterion weighs it. fixed: error that cannot be refined away; the source's share of
    it is between `source_low` and `source_high`. The geometric error e, which refining reduces, counts with float32's
    rounding r as w = min(e + r, 4 e) and with the source's s as min(w + s, 1.25 w), and is refined only above
    (r + s) / 4 (`metres2_of` in kernels/refine/diamond.py). This inverts it: e + r + s is at most the largest term.
    """
    remaining = max(weighed - source_low, 0.8 * weighed)
    return max(weighed, 0.8 * weighed + source_high, 0.25 * remaining + fixed, 1.25 * fixed)


def _limit_bound(request: float, value: float, precision: float, source: float, stopped: bool) -> Bound:
    """Return a bound with its reason and terms.

    value: the guaranteed bound; the result is at most `request` if only rounding separates them. precision, source:
    parts of the value from rounding of float32 and of the source. stopped: whether the depth limit stopped a leaf. All
    numbers are in one unit.
    """
    if value <= request * (1 + MARGIN):
        value, stopped = min(value, request), False
    geometric = max(value - precision - source, 0.0)
    reason = ""
    if value > request:
        # If the fixed error alone exceeds the request, no depth would be enough.
        if precision + source > request:
            reason = "precision" if precision > request else "source"
        elif stopped:
            reason = "max_depth"
        else:
            reason = "precision" if geometric + precision > request else "source"
    return Bound(value, reason, Terms.shares(value, geometric, precision, source))


def _edge_reason(too_coarse: Excess | None, lengthening: float) -> str:
    """Return the reason why a bound on edges exceeds the request, "" if it does not.

    too_coarse: the worst leaf if the depth limit stopped one. lengthening: factor by which rounding lengthens edges.
    """
    return "max_depth" if too_coarse else "precision" if lengthening > 1 else ""
