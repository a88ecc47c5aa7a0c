# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a walk may reuse the last frame's subtrees, and how the view has moved since, for coherence.py."""

import math
from dataclasses import dataclass

from ...kernels.field.domain import Domain
from ...kernels.refine.coherence import Motion
from ...kernels.refine.pixels import CriterionArrays, LocalView
from ..view.linear import add_up

# Largest fraction by which lengths, all but pixel footprints, may change from frame to frame: 4 times this comes off
# the slack.
MAX_DRIFT = 2e-3


@dataclass
class CachedSubtrees:
    """What the subtrees of a frame were cached for."""

    domain: Domain
    asked: CriterionArrays
    max_depth: int
    slots: int
    room: int  # of subtrees, and of runs of points, in a slot

    def __post_init__(self):
        self.limit = self.asked.limit

    def drift(self, domain: Domain, asked: CriterionArrays, max_depth: int) -> float:
        """Return the largest fraction by which lengths have changed that pixel footprints are made of and compared
        with, except those in `Motion`; infinity if more than the camera has changed."""
        of_asked = "view_count", "measures_edges", "metres2"
        of_view = "kind", "plane_count", "off_screen2", "fade", "fringe"
        same = domain is self.domain and max_depth == self.max_depth and asked.limit == self.limit
        same = same and all(getattr(asked, name) == getattr(self.asked, name) for name in of_asked)
        if not same or any(getattr(asked.view, name) != getattr(self.asked.view, name) for name in of_view):
            return math.inf
        pairs = zip(_squares(asked), _squares(self.asked), strict=True)
        return max(0.0 if a == b else abs(a - b) / b if 0 < b < math.inf else math.inf for a, b in pairs)


def _squares(asked: CriterionArrays) -> list[float]:
    """Squared lengths and pixels that may differ a little from frame to frame: matrices of Blender are float32."""
    of_asked = asked.error_px2, asked.edge_px2, asked.area_px2, asked.diagonal2, asked.axis2
    return [float(square) for square in (*asked.view.weight, asked.view.cosine2, asked.view.near2, *of_asked)]


def move(motion: Motion, before: LocalView, now: LocalView, drift: float) -> None:
    """Fill in how the view has moved."""
    motion.eye, motion.depth, motion.planes, motion.drift = before.eye, before.depth, before.planes, drift
    offsets = zip(now.weight, now.eye, before.eye, strict=True)
    motion.step = math.sqrt(add_up(float(w) * (float(a) - float(b)) * (float(a) - float(b)) for w, a, b in offsets))
    motion.slant_x, motion.slant_y, motion.max_gain2 = before.slant_x, before.slant_y, before.max_gain2
    motion.ratio = math.sqrt(float(now.pixel2) / float(before.pixel2))
