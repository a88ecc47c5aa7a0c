# SPDX-License-Identifier: GPL-3.0-or-later
"""The search for the finest relaxation step that meets a budget: each pass counts splits in a window of steps.

A step loosens the criterion by a fixed factor, so splits become fewer as steps rise; a split adds one triangle. The
search finds a mesh of a few triangles first, then finer ones. The growth of splits so far predicts the step of the next
mesh. These choices affect only the time of the search, not its result.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...kernels.budget.count_state import STEPS_PER_OCTAVE

MAX_STEP = 160 * STEPS_PER_OCTAVE
# Intermediate goals: fractions of the budget, but at least these numbers of splits.
GOALS = (1 / 8192, 16), (1 / 64, 400), (1 / 8, 2000)
# A mesh is close enough to an intermediate goal if it has a third of its splits.
NEAR = 3
# Steps in a window that begins just before the predicted step, for the budget and for intermediate goals; after each
# failure the window is three times as wide.
REACH, REACH_OF_PARTS, WIDER = 40, 256, 3
# Steps in the window that begins one step before the last frame's result.
WINDOW = 8
# Octaves of splits per octave of error, on typical ground.
SPLITS_PER_ERROR = 1.2
# The least that is assumed: coarse meshes have too few steps with growth to measure it.
MIN_SPLITS_PER_ERROR = 0.8

# (finest, coarsest, max_splits): see `count_splits` in budget.py.
Splits = Callable[[int, int, int], tuple[int, np.ndarray]]


class Found(NamedTuple):
    """The result of a search."""

    step: int
    splits: int = 0  # triangles that are split there; 0: not counted


def find_finest_step(splits: Splits, max_splits: int, start: Found | None, low: int) -> Found:
    """Find the finest step at which at most `max_splits` triangles are split, MAX_STEP + 1 if there is none.

    splits: function that counts them at steps; the numbers fall as steps rise. start: the last frame's result, None
    without one; it changes the time only. Without it, step 0 is returned uncounted if it may fit, since the refinement
    that follows shows that as soon as counting would. low: the finest step that is allowed. REACH, REACH_OF_PARTS:
    steps in the first window of a search for the budget, and for a fraction of it.
    """
    search = _Search(splits, max_splits, low)
    if start:
        finest = min(max(start.step - 1, low), MAX_STEP)
        search.look(finest, min(finest + WINDOW, MAX_STEP), max_splits)
    # Cheap counts at fractions of the budget show how fast splits grow.
    for fraction, min_splits in GOALS:
        goal = max(int(fraction * max_splits), min_splits)
        if goal < max_splits:
            search.approach(goal, REACH_OF_PARTS)
    if not start:
        finest, _ = search.window(max_splits, beyond=search.low, widening=1, reach=REACH)
        if finest == 0:  # the next count would begin there
            return Found(0)
    search.approach(max_splits, REACH)
    return Found(search.high, int(search.known[search.high]))


class _Search:
    """State of a search.

    `high`: finest step that is known to meet the budget, above MAX_STEP if none is. `low`: no finer step meets it.
    `known`: splits of each step, 0 where they are not counted. `_reached`: splits at `high`, or a number that the next
    finer step exceeds.
    """

    def __init__(self, splits: Splits, max_splits: int, low: int) -> None:
        self._splits, self._max_splits, self.low, self.high = splits, max_splits, low, MAX_STEP + 1
        self.known = np.zeros(MAX_STEP + 2, np.int64)
        self._reached = 0

    def look(self, finest: int, coarsest: int, goal: int) -> int:
        """Count the splits at the steps finest .. coarsest; return the first step with at most `goal` of them.

        It is `coarsest` + 1 if there is none. The counts become known from that step on.
        """
        first, counts = self._splits(finest, coarsest, goal)
        self.known[first : coarsest + 1] = counts
        if len(counts) and first <= self.high:
            # Unless the window begins at `first`, the next finer step has more than `goal` splits.
            self.high, self._reached = first, int(counts[0]) if first == finest else goal
        if goal == self._max_splits and first > finest:
            self.low = max(self.low, first)
        return first

    def approach(self, goal: int, reach: int) -> None:
        """Search for a step with about `goal` splits; if the goal is the budget, for the finest step that meets it.

        It narrows `low` and `high` and adds to the known counts. A NEAR-th of a goal other than the budget is enough.
        reach: number of steps in the first window; each further window is WIDER.
        """
        beyond, widening = self.low, 1  # every step finer than `beyond` has more splits than the goal
        while beyond < self.high and (goal == self._max_splits or NEAR * self._reached < goal):
            finest, coarsest = self.window(goal, beyond, widening, reach)
            first = self.look(finest, coarsest, goal)
            if first > finest:
                beyond = first
            widening *= WIDER

    def window(self, goal: int, beyond: int, widening: int, reach: int) -> tuple[int, int]:
        """Return the first and last step between which to search for `goal` splits.

        beyond: every finer step has more splits. widening: grows after failures. The window begins at least `widening`
        steps finer than `high`, the finest step that is known to fit, and has `widening` * `reach` steps.
        """
        if self.high > MAX_STEP:  # no step is known to fit
            return beyond, MAX_STEP
        finest = max(beyond, min(self._predict_step(goal) - 1, self.high - widening))
        return finest, min(self.high, finest + widening * reach)

    def _predict_step(self, goal: int) -> int:
        """Return the step, finer than `high`, that probably has `goal` splits, from the growth of the known counts."""
        growth = max(goal / max(self._reached, 1), 1)
        known = self.known[self.high :]
        # The slope is measured to the first coarser step with 1 / growth times the splits: at most half of them, which
        # is near enough, and at least a tenth fewer, which is more than single steps scatter.
        fewer = np.flatnonzero((known > 0) & (known <= min(max(1 / growth, 0.5), 0.9) * known[0]))
        slope = SPLITS_PER_ERROR / STEPS_PER_OCTAVE
        if len(fewer):
            slope = max(math.log2(known[0] / known[fewer[0]]) / fewer[0], MIN_SPLITS_PER_ERROR / STEPS_PER_OCTAVE)
        return self.high - 1 - round(math.log2(growth) / slope)
