# SPDX-License-Identifier: GPL-3.0-or-later
"""Check of whether a walk may reuse the last frame's subtrees, and the view's motion since, for coherence.py.

A slant is the fraction of a height difference that the view sees: 0 from above, 1 from the side.
"""

import math
from dataclasses import dataclass

from ...kernels.field.domain import Domain
from ...kernels.refine.coherence import Motion
from ...kernels.refine.local_view import LocalView
from ...kernels.refine.pixels import CriterionArrays
from ..view.linear import add_up

# Largest fraction by which lengths, all but pixel footprints, may change from frame to frame. Tests of cached subtrees
# allow for 4 times this (`Motion.drift` in kernels/refine/coherence.py).
MAX_DRIFT = 2e-3
# Fields of a criterion that may drift: squared limits in pixels, and squared lengths. The others must be equal, except
# those of views, and `limit`, compared with its value when subtrees were cached.
SQUARES = "error_px2", "edge_px2", "area_px2", "diagonal2", "axis2"
VIEWS = "limit", "view", "views", "slopes"


@dataclass
class CachedSubtrees:
    """Arguments for which the subtrees of a frame were cached: its domain, criterion with the view, and depth limit."""

    domain: Domain
    criterion: CriterionArrays
    max_depth: int
    slots: int  # slices of the curve, each with a list of subtrees
    room: int  # of subtrees, and of runs of points, in a slot

    def __post_init__(self) -> None:
        self.limit = self.criterion.limit  # which later refinements may change

    def drift(self, domain: Domain, criterion: CriterionArrays, max_depth: int) -> float:
        """Return by which fraction lengths of the view and the criterion have changed since the subtrees were cached.

        Arguments are those of the new frame: its terrain, its criterion with the view, and its depth limit.

        It is the largest relative change of the values of `_squares`, which rounding changes a little. Infinity if
        anything but the camera has changed: then no subtree is reused. `move` describes the motion of the camera.
        """
        of_criterion = [name for name in CriterionArrays.vars if name not in SQUARES + VIEWS]
        of_view = "kind", "plane_count", "off_screen2", "fade", "fringe"  # those that no motion changes
        same = domain is self.domain and max_depth == self.max_depth and criterion.limit == self.limit
        same = same and all(getattr(criterion, name) == getattr(self.criterion, name) for name in of_criterion)
        view, cached_view = criterion.view, self.criterion.view
        if not same or any(getattr(view, name) != getattr(cached_view, name) for name in of_view):
            return math.inf
        pairs = zip(_squares(criterion), _squares(self.criterion), strict=True)
        return max(0.0 if a == b else abs(a - b) / b if 0 < b < math.inf else math.inf for a, b in pairs)


def _squares(criterion: CriterionArrays) -> list[float]:
    """Return the squares that may differ a little between frames, because Blender's matrices are float32.

    They are the criterion's fields SQUARES, and of the view the squared scales along the axes (`weight`), the squared
    minimum of depth over distance (`cosine2`) and the squared distance below which nothing is visible (`near2`).
    """
    of_criterion = [getattr(criterion, name) for name in SQUARES]
    return [
        float(square)
        for square in (*criterion.view.weight, criterion.view.cosine2, criterion.view.near2, *of_criterion)
    ]


def move(motion: Motion, before: LocalView, now: LocalView, drift: float) -> None:
    """Fill in the motion of the view from `before` to `now`, for the kernels that test cached subtrees.

    It holds eye, coefficients of depth, frustum planes, slants and the largest ratio of slants squared of the earlier
    view, how far the eye has moved, and the growth of pixel footprints.

    before: the view for which the subtrees were cached. drift: the result of `CachedSubtrees.drift`.
    """
    motion.eye, motion.depth, motion.planes, motion.drift = before.eye, before.depth, before.planes, drift
    offsets = zip(now.weight, now.eye, before.eye, strict=True)
    # The way of the eye, metres of camera space. weight: squared metres of camera space per squared metre, by axis.
    motion.step = math.sqrt(add_up(float(w) * (float(a) - float(b)) * (float(a) - float(b)) for w, a, b in offsets))
    motion.slant_x, motion.slant_y, motion.max_gain2 = before.slant_x, before.slant_y, before.max_gain2
    motion.ratio = math.sqrt(float(now.pixel2) / float(before.pixel2))  # of pixel footprints
