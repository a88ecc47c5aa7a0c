# SPDX-License-Identifier: GPL-3.0-or-later
"""Which passes find the finest step of coarsening that keeps to a budget: each is told between which steps to count.

What is chosen here only says how soon the step is found, not which one it is.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...kernels.budget.count_state import MOST_HALVES, STEPS_PER_OCTAVE

MAX_STEP = 160 * STEPS_PER_OCTAVE
# Where nothing is known, passes look for these parts of the budget, not fewer and not more splits than these, one after
# the other: each foretells the next.
COARSE = (1 / 8192, 16, 64), (1 / 64, 400, 2000)
# A coarse mesh is near enough to a part that is looked for if it has a third of its splits.
NEAR = 3
# Of coarse meshes, at most so many steps are counted beyond one that is foretold.
BEHIND = 64
# In a flight the last coarse mesh is counted again: if it has as many splits as in the last frame, but for a twelfth,
# the answer is near the last one, otherwise the camera has jumped.
CHANGE = 0.08
# From a step before the last frame's answer on, steps up to so many later are counted.
WINDOW = 2
# To so many times as many splits and more, a pass over a sample foretells the answer. It looks so many steps further
# than a coarse mesh, or as far as it takes. In random views of a rough field, of hills and of level ground its first
# window held the answer in 302 of 303 searches at 300,000 triangles, 93 of 100 at 50,000, 88 at 10,000; it took an
# eighth, a fifth and two fifths of a refinement. Where few cells hold most of the detail, it is right less often.
FAR = 8
DEEPER = 200
# After so many steps a sample has half as many cells for each split. Splits rise twofold within 16 where lengths on
# screen ask, within 20 to 32 where errors do: neither the sample nor its cost gets far from what it was. But if less
# than a quarter is left, it is taken again, and thinned half as fast; at last so slowly that it does not matter.
THIN_STEPS, SLOWEST = 18, 150
LEFT = 0.25
# The first window reaches to where the sample has so many more and so many fewer splits than the budget, the next ones
# twice as far each, until that is more than the most.
TOLERANCE, MOST_TOLERANCE = 0.05, 0.4
# Beyond a step that is foretold otherwise, so many are counted; twice as many where that was not enough. Of budgets
# that are too small for samples, all.
REACH = 6
# Octaves of splits for an octave of error, on most ground.
SPLITS_PER_ERROR = 1.2
# ... and fewest: of coarse meshes they rise too seldom to tell.
LEAST = 0.6

# (finest, coarsest, most, thinned): see `Budget._splits`.
Splits = Callable[[int, int, int, tuple[int, int] | None], tuple[int, np.ndarray]]


class Found(NamedTuple):
    """What a search has found."""

    step: int
    splits: int = 0  # triangles that are split there; 0: not counted
    coarse: tuple[int, int] = 0, 0  # a coarser step, and its splits


def lowest(splits: Splits, most: int, start: Found | None, low: int) -> Found:
    """The finest step at which at most `most` triangles are split, MAX_STEP + 1 if there is none.

    splits: they fall as steps rise. start, low: see `Budget.search`.
    """
    search = _Search(splits, most, low)
    window = None
    if start and search.is_as_before(start.coarse):
        window = search.around(start.step)
    while search.low < search.high:
        if window is None:
            window = search.window()
            continue  # that may have found it
        if window[0] == 0 and start is None:
            return Found(0, 0, search.coarse)
        search.look(*window, most)
        window = None
    return Found(search.high, int(search.known[search.high]), search.coarse)


class _Search:
    """What is known of a budget: no step finer than `low` fits, `high` does, and how many splits some steps have."""

    def __init__(self, splits: Splits, most: int, low: int):
        self._splits, self.most, self.low, self.high = splits, most, low, MAX_STEP + 1
        self.known = np.zeros(MAX_STEP + 2, np.int64)
        self._reached = 0  # so many splits there are at `high`, or more just finer than it
        self.coarse = 0, 0
        self._goals = [min(most, int(np.clip(most * part, fewest, largest))) for part, fewest, largest in COARSE]
        self._looked = False
        self._sample: tuple[int, np.ndarray] | None = None  # from a step on, about how many splits there are
        self._tolerance = TOLERANCE
        self._passes = 0  # for the budget itself

    def look(self, finest: int, coarsest: int, goal: int) -> tuple[int, np.ndarray]:
        """Count between two steps as far as there are at most `goal` splits."""
        first, found = self._splits(finest, coarsest, goal, None)
        self.known[first : coarsest + 1] = found
        if len(found) and first <= self.high:
            self.high, self._reached = first, int(found[0]) if first == finest else goal
        if goal == self.most:
            self._passes += 1
            if first > finest:
                self.low = max(self.low, first)
        return first, found

    def is_as_before(self, coarse: tuple[int, int]) -> bool:
        """Whether the coarse mesh of the last frame has about as many splits now; true if it cannot tell."""
        self.coarse, (step, before) = coarse, coarse
        if not (self.low < step <= MAX_STEP and self._goals[0] < before < self.most // (2 * FAR)):
            return True
        _, found = self.look(step, step, 2 * before)
        if not len(found):
            return False
        self.coarse = step, int(found[0])
        return abs(found[0] - before) <= CHANGE * before

    def around(self, step: int) -> tuple[int, int]:
        """Between which steps an answer is looked for that was `step`."""
        finest = min(max(step - 1, self.low), MAX_STEP)
        return finest, min(finest + WINDOW, MAX_STEP)

    def window(self) -> tuple[int, int]:
        """Between which steps the answer is looked for, by what is known; counts coarse meshes where that is little."""
        if not self._looked:
            self._look_for_coarse()
        if self.high > MAX_STEP:  # not even there
            return self.low, MAX_STEP
        samples = FAR * self._goals[-1] < self.most
        if samples and FAR * self._reached < self.most and self._sample is None:
            self._sample = self._sampled()
        if self._sample and (window := self._by_sample()):
            return window
        wider = 1 << max(self._passes - 1, 0)  # twice as wide after each that did not hold the answer
        finest = max(self.low, min(self._foretold(self.most) - 1, self.high - wider))
        return finest, min(self.high, finest + wider * REACH) if samples else self.high

    def _look_for_coarse(self) -> None:
        self._looked = True
        for goal in self._goals:
            beyond, stride = self.low, 1  # just finer than `beyond` there are more splits
            while beyond < self.high and NEAR * self._reached < goal:
                finest, coarsest = beyond, MAX_STEP
                if self.high <= MAX_STEP:
                    finest = max(beyond, min(self._foretold(goal) - 1, self.high - stride))
                    coarsest = min(self.high, finest + max(BEHIND, stride))
                    stride *= 2
                first, found = self.look(finest, coarsest, goal)
                if len(found):
                    self.coarse = first, int(found[0])
                if first > finest:
                    beyond = first

    def _sampled(self) -> tuple[int, np.ndarray]:
        """A step, and an estimate of the splits from there to `high`: from what is more than enough for every window.

        The sample is thinned from as many splits on as a coarse mesh has.
        """
        most = int((1 + 2 * MOST_TOLERANCE) * self.most)
        enough, deeper, thin_steps = self._goals[-1], DEEPER, THIN_STEPS
        thin_from = self.high - round(thin_steps * math.log2(max(enough / max(self._reached, 1), 1)))
        while True:
            finest = max(self.low, self.high - deeper)
            step, found = self._splits(finest, self.high, most, (thin_from, thin_steps))
            thinned = np.maximum(thin_from - np.arange(step, self.high + 1), 0) / thin_steps
            poor = (thinned > 0) & (found < LEFT * enough * 2.0 ** np.minimum(thinned, MOST_HALVES))
            if poor.any() and thin_steps < SLOWEST:
                thin_from = min(thin_from, step + int(np.argmax(found <= enough)))
                thin_steps *= 2
            elif step > finest or finest == self.low:
                return step, found
            else:
                deeper *= 2

    def _by_sample(self) -> tuple[int, int] | None:
        """The next window around the step that the sample foretells; None where it is of no more use."""
        step, found = self._sample
        while self._tolerance <= MOST_TOLERANCE:
            more = np.count_nonzero(found > (1 + self._tolerance) * self.most)
            enough = np.count_nonzero(found > (1 - self._tolerance) * self.most)
            self._tolerance *= 2
            finest, coarsest = max(self.low, step + more - 1), min(self.high, step + enough)
            if finest <= coarsest and finest < self.high:
                return finest, coarsest
        return None

    def _foretold(self, goal: int) -> int:
        """A step finer than `high` at which there may be `goal` splits, by how they rose up to there."""
        more = max(goal / max(self._reached, 1), 1)
        known = self.known[self.high :]
        fewer = np.flatnonzero((known > 0) & (known <= min(max(1 / more, 0.5), 0.9) * known[0]))
        slope = SPLITS_PER_ERROR / STEPS_PER_OCTAVE
        if len(fewer):
            slope = max(math.log2(known[0] / known[fewer[0]]) / fewer[0], LEAST / STEPS_PER_OCTAVE)
        return self.high - 1 - round(math.log2(more) / slope)
