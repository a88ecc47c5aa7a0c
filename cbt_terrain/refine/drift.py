# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the next walk may take what the last one has kept, and how the view has moved since, for coherence.py."""

import math
from dataclasses import dataclass

from ...kernels.field.domain import Domain
from ...kernels.refine.coherence import Motion
from ...kernels.refine.pixels import Asked, LocalView
from ..ask.linear import add_up

# By which part lengths, all but spans of a pixel, may change from frame to frame: 4 times this comes off the slack.
MOST_DRIFT = 2e-3


@dataclass
class Walked:
    """What the last walk's subtrees were kept for."""

    domain: Domain
    asked: Asked
    max_depth: int
    slots: int
    room: int  # of subtrees, and of runs of leaves, in a slot
    work: tuple  # of each slot: leaves, and what they cost, in leaves that are found anew
    after: object  # the leaves that it has taken some from, or None
    leaves: object = None  # that it has found; None: the tree does not hold them yet

    def __post_init__(self):
        self.limit = self.asked.limit

    def drift(self, domain: Domain, asked: Asked, max_depth: int) -> float:
        """By what part the lengths have changed that spans of a pixel are made of and compared with, all but those
        that `Motion` has; infinity if more than the camera has moved."""
        of_asked = "view_count", "measures_edges", "metres2"
        of_view = "kind", "plane_count", "off_screen2", "fade", "fringe"
        same = (
            self.leaves is not None
            and domain is self.domain
            and max_depth == self.max_depth
            and asked.limit == self.limit
        )
        same = same and all(getattr(asked, name) == getattr(self.asked, name) for name in of_asked)
        if not same or any(getattr(asked.view, name) != getattr(self.asked.view, name) for name in of_view):
            return math.inf
        pairs = zip(_squares(asked), _squares(self.asked), strict=True)
        return max(0.0 if a == b else abs(a - b) / b if 0 < b < math.inf else math.inf for a, b in pairs)


def _squares(asked: Asked) -> list[float]:
    """Squared lengths and pixels that may differ a little from frame to frame: matrices of Blender are float32."""
    of_asked = asked.error_px2, asked.edge_px2, asked.area_px2, asked.diagonal2, asked.axis2
    return [float(square) for square in (*asked.view.weight, asked.view.cosine2, asked.view.near2, *of_asked)]


def move(motion: Motion, before: LocalView, now: LocalView, drift: float) -> None:
    """Fill in how the view has moved."""
    motion.eye, motion.depth, motion.drift = before.eye, before.depth, drift
    offsets = zip(now.weight, now.eye, before.eye, strict=True)
    motion.step = math.sqrt(add_up(float(w) * (float(a) - float(b)) * (float(a) - float(b)) for w, a, b in offsets))
    motion.ratio = math.sqrt(float(now.pixel2) / float(before.pixel2))
