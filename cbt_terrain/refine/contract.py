# SPDX-License-Identifier: GPL-3.0-or-later
"""A bound is a contract: what was asked, times what a triangle limit relaxed. More is said only of what could not be
kept: where a leaf is as deep as leaves may be, and where float32 and the source leave more open than was asked.

Where points rise, the surface is a mean of the meshes for 1 .. k times what the finest holds. What that one is off
beside its own t is nowhere more in the others. So the mean is off by what the finest is, and (m - 1) t.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.refine.excess import AREA, EDGE, ERROR, FIXED, METRES, STACK, Triangle, find_largest
from ...kernels.refine.pixels import CriterionArrays
from ..run import launch
from ..run.buffers import Buffers
from ..view.criterion import LARGEST, Criterion
from ..view.morph import mean_ramp
from ..view.spans import Spans
from .terms import MARGIN, Terms, weighed_as

# Where no factor on the criterion keeps to a triangle limit, the roots' own factor is not reported above this.
MAX_FACTOR = 1e100
# What keeps a bound above what was asked; of several, the first is told.
REASONS = ("max_triangles", "max_depth", "precision", "source")


@dataclass(frozen=True)
class Bound:
    """A bound, what keeps it above what was asked (one of REASONS, or ""), and of errors its parts."""

    value: float
    reason: str = ""
    terms: Terms | None = None


@dataclass(frozen=True)
class Excess:
    """The most that ground has of something: spans of a pixel, or metres. Of errors also the metres of it that cannot
    be refined away there, float32's and the source's, and all metres of it."""

    most: float
    fixed: float
    total: float


@dataclass(frozen=True)
class Outcome:
    """A refinement and how it ended.

    `relaxed`: the factor by which a triangle limit coarsened what was asked; infinity where no factor is enough, so
    that the mesh is the roots. `stopped`: whether a leaf is still too coarse, and at `max_depth`. `deepest`: the depth
    of the deepest leaf. `relief`: metres between the lowest and the highest point. `in_frame`: returns `asked` without
    the guard band.
    """

    domain: Domain
    asked: CriterionArrays
    relaxed: float
    stopped: bool
    max_depth: int
    deepest: int
    relief: float
    buffers: Buffers
    in_frame: Callable[[], CriterionArrays]

    def search(self, what: int, least: float) -> Excess | None:
        """The most of `what` (FIXED, ERROR, EDGE, AREA: on ground in view; METRES: anywhere) that leaves at the depth
        limit have, rounded up by a thousandth, of ERROR by a hundredth; None where none has more than `least`."""
        stack, found = self.buffers.get("excess_stack", STACK, Triangle), self.buffers.get("excess", 3, wp.float64)
        inputs = [self.domain, self.asked, what, self.max_depth, math.copysign(least * least, least), stack, found]
        launch.once(find_largest, inputs, step="bound")
        bound2, fixed, total = self.buffers.numpy("excess")[:3].tolist()
        return None if total < 0.0 else Excess(math.sqrt(bound2), fixed, total)

    def factor(self, what: int, request: float) -> float:
        """Return the finite factor on a request, in the unit of `search`, that the mesh satisfies."""
        if self.relaxed < math.inf:
            return self.relaxed
        found = replace(self, max_depth=1).search(what, -1.0)
        return min(max(found.most / request, 1.0), MAX_FACTOR) if found else 1.0

    def stopped_above(self, what: int, least: float) -> Excess | None:
        """What leaves that are too coarse have, where that is more than `least`."""
        return self.search(what, least) if self.stopped else None


def reason_of(bounds: list[Bound | None], relaxed: float) -> str:
    """What holds a refinement back."""
    reasons = {bound.reason for bound in bounds if bound} | ({"max_triangles"} if relaxed > 1 else set())
    return next((reason for reason in REASONS if reason in reasons), "")


def bound_px(criterion: Criterion, spans: Spans, o: Outcome) -> Bound | None:
    """Return pixels that a point in view can be from its place; 0 where nothing is in view."""
    if not criterion.error_px or not spans.views:
        return None
    found = _bound_px(criterion, spans, o)
    if found.reason:  # ground in the guard band may be nearer than what is seen
        found = _bound_px(criterion, spans, replace(o, asked=o.in_frame()))
    return found


def _bound_px(criterion: Criterion, spans: Spans, o: Outcome) -> Bound:
    """Return the same for the views of `o.asked`."""
    fixed = o.search(FIXED, -1.0)
    if fixed is None:
        return Bound(0.0, "", Terms(0.0, 0.0, 0.0))
    mean, source = mean_ramp(criterion.rises_until), o.domain.source
    wanted = criterion.error_px * o.factor(ERROR, criterion.error_px / mean)
    finest = wanted / mean
    least, most = o.domain.rounding + source, _fixed(o)
    # Of what cannot be refined away the source's rounding is a part that is not the same everywhere.
    low, high = (source * fixed.most / metres if metres else 0.0 for metres in (most, least))
    kept, limit = _kept(finest, fixed.most, low, high), fixed.most * (1 + o.relief / least) if least else 0.0
    over = o.stopped_above(ERROR, min(kept, limit))
    kept = min(kept + (wanted - finest), limit)
    at = over or fixed
    per = at.most / at.total if at.total else 0.0  # spans of a metre
    value = over.most + (wanted - finest) if over else kept
    found = _bound(wanted, value, (at.fixed - source) * per, source * per, over is not None)
    if found.value <= criterion.error_px:
        return found
    seen = min(spans.pixels(found.value), LARGEST)
    terms = Terms.shares(seen, found.terms.geometric, found.terms.precision, found.terms.source)
    return Bound(seen, found.reason, terms)


def bound_m(criterion: Criterion, o: Outcome) -> Bound | None:
    """Metres of height between mesh and surface, anywhere."""
    if not criterion.error_m:
        return None
    fixed, source, mean = _fixed(o), o.domain.source, mean_ramp(criterion.rises_until)
    finest = weighed_as(criterion.error_m, source, mean)
    factor = o.factor(METRES, finest)
    finest *= factor
    kept, limit, rises = _kept(finest, fixed, source, source), o.relief + fixed, (mean - 1) * finest
    over = o.stopped_above(METRES, min(kept, limit))
    precision, value = (over.fixed if over else fixed) - source, over.most + rises if over else min(kept + rises, limit)
    return _bound(criterion.error_m * factor, value, precision, source, over is not None)


def bound_edge_px(criterion: Criterion, spans: Spans, o: Outcome) -> Bound | None:
    """Pixels of the longest edge, also between float32 corners."""
    if not criterion.edge_px:
        return None
    mean = mean_ramp(criterion.rises_until)
    wanted = criterion.edge_px * o.factor(EDGE, criterion.edge_px / mean * spans.edge)
    finest = wanted / mean
    over, longer = o.stopped_above(EDGE, finest * spans.edge), spans.excess_of_edges(o.deepest)
    longest = over.most / spans.edge + (wanted - finest) if over else wanted
    return Bound(min(longest * longer, LARGEST), _of_edges(over, longer))


def bound_area_px(criterion: Criterion, spans: Spans, o: Outcome) -> Bound | None:
    """Square pixels of the largest triangle; the search has the root of twice that."""
    if not criterion.area_px:
        return None
    request, mean = math.sqrt(2 * criterion.area_px), mean_ramp(criterion.rises_until)
    factor = o.factor(AREA, request / mean * spans.edge)
    wanted, finest = request * factor, request * factor / mean
    over, longer = o.stopped_above(AREA, finest * spans.edge), spans.excess_of_edges(o.deepest)
    longest = over.most / spans.edge + (wanted - finest) if over else wanted
    area = 0.5 * longest * longest if over else criterion.area_px * factor * factor
    return Bound(min(area * longer * longer, LARGEST), _of_edges(over, longer))


def factor_of(criterion: Criterion, o: Outcome, bounds: list[Bound | None]) -> float:
    """Return the finite factor by which a triangle limit coarsened a criterion; `bounds` as the functions above."""
    if o.relaxed < math.inf:
        return o.relaxed
    requests = criterion.error_px, criterion.error_m, criterion.edge_px, criterion.area_px
    ratios = [bound.value / request for bound, request in zip(bounds, requests, strict=True) if bound]
    return max(1.0, *ratios[:3], *map(math.sqrt, ratios[3:]))


def _fixed(o: Outcome) -> float:
    """Metres that cannot be refined away, at most."""
    d = o.domain
    return d.rounding + min(d.lean * o.relief, d.max_lean) + d.source


def _kept(weighed: float, fixed: float, source_low: float, source_high: float) -> float:
    """What leaves hold that nothing stopped, from what the criterion weighs their error as at most.

    `fixed`: what cannot be refined away; the source's part of that is between two numbers. From `metres2_of` in
    kernels/refine/diamond.py: an error that is a quarter of what the source leaves of the bound, or of what is fixed,
    is not refined any more.
    """
    left = max(weighed - source_low, 0.8 * weighed)
    return max(weighed, 0.8 * weighed + source_high, 0.25 * left + fixed, 1.25 * fixed)


def _bound(wanted: float, value: float, precision: float, source: float, stopped: bool) -> Bound:
    """The bound that is `value`, or what was asked where that is all."""
    if value <= wanted * (1 + MARGIN):
        value, stopped = min(value, wanted), False
    geometric = max(value - precision - source, 0.0)
    reason = ""
    if value > wanted:
        # What cannot be refined away may be too much alone: then no depth would do.
        if precision + source > wanted:
            reason = "precision" if precision > wanted else "source"
        elif stopped:
            reason = "max_depth"
        else:
            reason = "precision" if geometric + precision > wanted else "source"
    return Bound(value, reason, Terms.shares(value, geometric, precision, source))


def _of_edges(over: Excess | None, longer: float) -> str:
    return "max_depth" if over else "precision" if longer > 1 else ""
