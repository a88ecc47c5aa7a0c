# SPDX-License-Identifier: GPL-3.0-or-later
"""Which passes find the finest step of coarsening that keeps to a budget: each is told between which steps to count.

A mesh of a few triangles is found first, then finer ones: how splits have risen foretells the step of the next. What is
chosen here only says how soon the step is found, not which one it is.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...kernels.budget.count_state import STEPS_PER_OCTAVE

MAX_STEP = 160 * STEPS_PER_OCTAVE
# Passes look for these parts of the budget, but not for fewer splits than these, before they look for all of it.
PARTS = (1 / 8192, 16), (1 / 64, 400), (1 / 8, 2000)
# A mesh is near enough to a part that is looked for if it has a third of its splits.
NEAR = 3
# From just before a step that is foretold on, so many are counted, for the budget and for its parts; each time that was
# not enough, three times as many.
REACH, REACH_OF_PARTS, WIDER = 40, 256, 3
# From a step before the last frame's answer on, steps up to so many later are counted.
WINDOW = 8
# Octaves of splits for an octave of error, on most ground.
SPLITS_PER_ERROR = 1.2
# ... and fewest: of coarse meshes they rise too seldom to tell.
LEAST = 0.8

# (finest, coarsest, most): see `Budget._splits`.
Splits = Callable[[int, int, int], tuple[int, np.ndarray]]


class Found(NamedTuple):
    """What a search has found."""

    step: int
    splits: int = 0  # triangles that are split there; 0: not counted


def lowest(splits: Splits, most: int, start: Found | None, low: int) -> Found:
    """The finest step at which at most `most` triangles are split, MAX_STEP + 1 if there is none.

    splits: they fall as steps rise. start, low: see `Budget.search`.
    """
    search = _Search(splits, most, low)
    if start:
        finest = min(max(start.step - 1, low), MAX_STEP)
        search.look(finest, min(finest + WINDOW, MAX_STEP), most)
    for part, fewest in PARTS:
        goal = max(int(part * most), fewest)
        if goal < most:
            search.approach(goal, REACH_OF_PARTS)
    if not start and search.window(most, search.low, 1, REACH)[0] == 0:
        return Found(0)
    search.approach(most, REACH)
    return Found(search.high, int(search.known[search.high]))


class _Search:
    """What is known of a budget: no step finer than `low` fits, `high` does, and how many splits some steps have."""

    def __init__(self, splits: Splits, most: int, low: int):
        self._splits, self._most, self.low, self.high = splits, most, low, MAX_STEP + 1
        self.known = np.zeros(MAX_STEP + 2, np.int64)
        self._reached = 0  # so many splits there are at `high`, or more just finer than it

    def look(self, finest: int, coarsest: int, goal: int) -> int:
        """Count between two steps as far as there are at most `goal` splits; returns the first such step."""
        first, found = self._splits(finest, coarsest, goal)
        self.known[first : coarsest + 1] = found
        if len(found) and first <= self.high:
            self.high, self._reached = first, int(found[0]) if first == finest else goal
        if goal == self._most and first > finest:
            self.low = max(self.low, first)
        return first

    def approach(self, goal: int, reach: int) -> None:
        """Find a mesh that is near `goal` splits; of the budget itself the finest one that keeps to it."""
        beyond, stride = self.low, 1  # just finer than `beyond` there are more splits
        while beyond < self.high and (goal == self._most or NEAR * self._reached < goal):
            finest, coarsest = self.window(goal, beyond, stride, reach)
            first = self.look(finest, coarsest, goal)
            if first > finest:
                beyond = first
            stride *= WIDER

    def window(self, goal: int, beyond: int, stride: int, reach: int) -> tuple[int, int]:
        """Between which steps `goal` splits are looked for, by what is known."""
        if self.high > MAX_STEP:  # nothing is
            return beyond, MAX_STEP
        finest = max(beyond, min(self._foretold(goal) - 1, self.high - stride))
        return finest, min(self.high, finest + stride * reach)

    def _foretold(self, goal: int) -> int:
        """A step finer than `high` at which there may be `goal` splits, by how they rose up to there."""
        more = max(goal / max(self._reached, 1), 1)
        known = self.known[self.high :]
        fewer = np.flatnonzero((known > 0) & (known <= min(max(1 / more, 0.5), 0.9) * known[0]))
        slope = SPLITS_PER_ERROR / STEPS_PER_OCTAVE
        if len(fewer):
            slope = max(math.log2(known[0] / known[fewer[0]]) / fewer[0], LEAST / STEPS_PER_OCTAVE)
        return self.high - 1 - round(math.log2(more) / slope)
