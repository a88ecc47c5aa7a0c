# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluations of effects with one frame history, and what they have computed."""

from collections import Counter

from adaptive_terrain.cbt_terrain.attributes.evaluate import EffectRequest, evaluate
from adaptive_terrain.cbt_terrain.history.frame_history import FrameHistory


class Evaluations:
    """`runs`: how often each effect was computed. `ran` and `nbytes`: of the last evaluation."""

    def __init__(self, threads: int = 1):
        self.history, self.threads = FrameHistory(), threads
        self.runs, self.ran, self.nbytes = Counter(), {}, 0

    def attributes(self, plan, heights, surface, views=(), placement=None, **placed) -> dict:
        """Return the attributes of a plan on a surface."""
        request = EffectRequest(plan, surface, views, placement, **placed)
        made = evaluate(heights, request, self.history, self.threads)
        self.ran, self.nbytes = made.ran, made.nbytes
        for name, ran in made.ran.items():
            self.runs[name] += ran.computed > 0
        return made.attributes
