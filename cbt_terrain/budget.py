# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeping to a number of leaves: by how much what is asked has to be coarsened."""

import math
from typing import NamedTuple

import numpy as np
import warp as wp

from ..kernels.count import count
from ..kernels.count_state import CELLS, MARKS, STEPS_PER_OCTAVE, Cell, Count
from ..kernels.criterion import Asked, Domain
from ..kernels.walk_state import STACK
from . import launch
from .buffers import Buffers, bind, shared
from .lattice import Lattice

MAX_STEP = 160 * STEPS_PER_OCTAVE
# What follows only says how soon a budget is found.
# Where nothing is known, passes look for these parts of the budget, one after the other: each foretells the next.
PARTS = (1 / 8192, 1 / 128, 1 / 12, 1.0)
FEWEST = 16
# The finest step that fits the second of these is remembered. In a flight it is counted again: if it has as many splits
# as in the last frame, but for a twentieth, the answer is near the last one, otherwise the camera has jumped.
SAMPLED = 2
CHANGE = 0.05
# From a step before the last frame's answer on, steps up to so many later are counted.
WINDOW = 2
# Beyond a step that is foretold, so many; or as many as it takes to foretell the next one; or, of few triangles, where
# curves are stairs, all.
REACH = 6
BEHIND = 64
FEW = 50_000
# Splits rise as over the last octave, and by this much faster: of 275 curves between 1/12 and all of 300,000, nine in
# ten were foretold to 4 steps.
STEEPER = 1.05
# Octaves of splits for an octave of error, on most ground.
SPLITS_PER_ERROR = 1.2
# ... and fewest: of coarse meshes they rise too seldom to tell.
LEAST = 0.6


class Found(NamedTuple):
    """What a search has found."""

    step: int
    splits: int = 0  # triangles that are split there; 0: not counted
    sample: tuple[int, int] = 0, 0  # a coarser step, and its splits


def limit_of(step: int) -> float:
    """What squares of what is asked are multiplied by; infinity beyond MAX_STEP."""
    return 2.0 ** (2 * step / STEPS_PER_OCTAVE) if step <= MAX_STEP else math.inf


class Budget:
    """Counts leaves of one lattice and finds the step that keeps to a number of them."""

    def __init__(self, lattice: Lattice, buffers: Buffers, threads: int):
        self._lattice, self._buffers, self._threads = lattice, buffers, threads
        self._limits = shared(np.array([limit_of(step) for step in range(MAX_STEP + 2)]), wp.float64)
        self._marks = np.zeros(0)  # places, in squares along the quadtree, evenly by what the last pass has measured
        self._structs: list[Count] = []
        self._recorded: dict = {}

    def search(self, domain: Domain, asked: Asked, max_depth: int, most: int, start: Found | None, low: int) -> Found:
        """The finest step that gives at most `most` leaves, not finer than `low`; MAX_STEP + 1 if none does.

        start: what has been found for the frame before (None: nothing). It changes how long the search takes, not the
        answer. But without it, 0 is only a step that may fit: a refinement finds that out as soon as counting does.
        """
        roots = 2 * self._lattice.squares

        def splits(finest: int, coarsest: int, most: int) -> tuple[int, np.ndarray]:
            return self._splits(domain, asked, max_depth, finest, coarsest, most)

        return lowest(splits, most - roots, start, low)

    def _splits(self, domain: Domain, asked: Asked, max_depth: int, finest: int, coarsest: int, most: int):
        """The first step from `finest` to `coarsest` with at most `most` triangles that are split, and how many there
        are at each step from it on; `coarsest` + 1 and none if there is no such step."""
        cell_bits, steps = max_depth + max_depth % 2, len(self._limits)
        cuts = self._cuts(cell_bits, most)
        slices, spacing = len(cuts) - 1, most // 64 + 1
        get, numpy = self._buffers.get, self._buffers.numpy
        arrays = {
            "limits": self._limits,
            "level_limits": get("count_level_limits", slices * STACK, wp.vec3d),
            "stack": get("count_stack", slices * CELLS, Cell),
            "last_steps": get("count_last_steps", slices * steps, wp.int64),
            "from_step": get("count_from_step", slices, wp.int32),
            "marks": get("count_marks", slices * MARKS, wp.uint64),
            "measured": get("count_measured", slices, wp.int64),
        }
        last_steps = numpy("count_last_steps")[: slices * steps].reshape(slices, steps)
        last_steps[:] = 0
        while len(self._structs) < slices:
            self._structs.append(Count())
        for slot, struct in enumerate(self._structs[:slices]):
            bind(struct, first_cell=cuts[slot], end_cell=cuts[slot + 1], cell_bits=cell_bits, max_depth=max_depth)
            bind(struct, slot=slot, finest=finest, coarsest=coarsest, most=most, spacing=spacing, **arrays)
        inputs = [[domain, asked, asked, struct] for struct in self._structs[:slices]]
        launch.slices(count, inputs, step="budget", recorded=self._recorded)
        noted = np.minimum(numpy("count_measured")[:slices] // spacing, MARKS)
        marks = numpy("count_marks")[: slices * MARKS].reshape(slices, MARKS)
        self._marks = np.concatenate([row[:n] for row, n in zip(marks, noted, strict=True)]) / 2.0**cell_bits
        first = int(numpy("count_from_step")[:slices].max())
        splits = np.cumsum(last_steps[:, first : coarsest + 1].sum(axis=0)[::-1])[::-1]
        more = int(np.count_nonzero(splits > most))  # each slice knows of its own alone
        return first + more, splits[more:]

    def _cuts(self, cell_bits: int, most: int) -> list[int]:
        """Where the quadtree is cut for the threads: evenly by what the last pass has measured; any cut does."""
        end = self._lattice.squares << cell_bits
        if self._threads < 2 or most < launch.SLICE_ITEMS or len(self._marks) < self._threads:
            return [0, end]
        at = [self._marks[len(self._marks) * k // self._threads] for k in range(1, self._threads)]
        return [0, *sorted({cut for cut in (int(mark * 2.0**cell_bits) for mark in at) if 0 < cut < end}), end]


def lowest(splits, most: int, start: Found | None, low: int) -> Found:
    """The finest step at which at most `most` triangles are split, MAX_STEP + 1 if there is none.

    splits: see `Budget._splits`; they fall as steps rise. start, low: see `Budget.search`.
    """
    known = np.zeros(MAX_STEP + 2, np.int64)  # splits, where they have been counted
    stride = 1  # so far at least from a step that fits; more where pass after pass has found no other
    high = MAX_STEP + 1  # fits, and no step finer than `low` does
    goals = [min(most, max(int(most * part), FEWEST)) for part in PARTS]
    goal, finest, coarsest = goals[0], low, MAX_STEP
    sample, compares = (start.sample if start else (0, 0)), False
    if start and low < sample[0] <= MAX_STEP and goals[0] < sample[1] < most // 16:
        goal, finest, coarsest, compares = 2 * sample[1], sample[0], sample[0], True
    elif start:
        goal, (finest, coarsest) = most, _around(start.step, low)
    while low < high:
        if finest == 0 and goal == most and not start:
            return Found(0, 0, sample)
        first, found = splits(finest, coarsest, goal)
        known[first : coarsest + 1] = found
        if goal == most and first > finest:
            low = max(low, first)
        stays = compares and len(found) and abs(found[0] - sample[1]) <= CHANGE * sample[1]
        if len(found):
            high, all_fit = min(high, first), first == finest
            if compares or goal in goals[:SAMPLED]:
                sample = first, int(found[0])
            reached = int(found[0]) if all_fit else goal
            goal = next((later for later in goals if later > 3 * reached), most)
            nearer, doubt = _foretold(known, first, max(reached, 1), goal)
            reach = REACH + 2 * doubt if goal == most else BEHIND
            finest = max(low, min(nearer - 1, first - stride))
            coarsest = min(high, finest + (reach if most > FEW else MAX_STEP), MAX_STEP)
            stride = 2 * stride if all_fit else 1
        elif coarsest == MAX_STEP:  # not even there
            goal, finest = most, min(first, MAX_STEP)
        elif high <= MAX_STEP:
            finest, coarsest = max(low, first), high
        else:  # somewhere far away
            goal, finest, coarsest = goals[0], low, MAX_STEP
        if stays:
            goal, (finest, coarsest) = most, _around(start.step, low)
        compares = False
    return Found(high, int(known[high]), sample)


def _around(step: int, low: int) -> tuple[int, int]:
    """Between which steps an answer is looked for that was `step`."""
    finest = min(max(step - 1, low), MAX_STEP)
    return finest, min(finest + WINDOW, MAX_STEP)


def _foretold(known: np.ndarray, step: int, here: int, goal: int) -> tuple[int, int]:
    """A step finer than `step`, just before which there are `here` splits or more, at which there may be `goal`.

    And by how many steps that is in doubt: as many as it would be elsewhere by splits of twice as many octaves.
    """
    steps = []
    part = min(max(here / max(goal, 1), 0.5), 0.9)
    for octaves_ago in (part, part * part):
        fewer = np.flatnonzero((known[step:] > 0) & (known[step:] <= octaves_ago * known[step]))
        slope = SPLITS_PER_ERROR / STEPS_PER_OCTAVE
        if len(fewer):
            slope = max(STEEPER * math.log2(known[step] / known[step + fewer[0]]) / fewer[0], LEAST / STEPS_PER_OCTAVE)
        steps.append(max(0, round(math.log2(max(goal, 1) / here) / slope)))
    return step - 1 - steps[0], abs(steps[0] - steps[1])
