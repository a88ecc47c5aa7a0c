# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeping to a number of leaves: by how much what is asked has to be coarsened."""

import math
from functools import partial

import numpy as np
import warp as wp

from ...kernels.budget.count import count
from ...kernels.budget.count_state import CELLS, MARKS, STEPS_PER_OCTAVE, Cell, Count
from ...kernels.field.domain import Domain
from ...kernels.refine.pixels import Asked
from ..field.lattice import Lattice
from ..run import launch
from ..run.buffers import Buffers, bind, shared
from .step_search import MAX_STEP, Found, lowest

# Where a mesh as asked has less than this part of the leaves that it may have, a step finer it fits, too.
NEAR = 0.5
# So many times the leaves that there may be are not counted any more.
FAR_OVER = 64


def limit_of(step: int) -> float:
    """What squares of what is asked are multiplied by; infinity beyond MAX_STEP."""
    return 2.0 ** (2 * step / STEPS_PER_OCTAVE) if step <= MAX_STEP else math.inf


# At each step and, for what is a step finer, at the step before.
LIMITS, FINER = (np.array([limit_of(step - before) for step in range(MAX_STEP + 2)]) for before in (0, 1))


class Budget:
    """Counts leaves of one lattice and finds the step that keeps to a number of them."""

    def __init__(self, lattice: Lattice, buffers: Buffers, threads: int):
        self._lattice, self._buffers, self._threads = lattice, buffers, threads
        self._limits, self._finer = shared(LIMITS, wp.float64), shared(FINER, wp.float64)
        self._marks = np.zeros(0)  # places, in squares along the quadtree, evenly by what the last pass has measured
        self._structs: list[Count] = []
        self._recorded: dict = {}

    def search(self, domain: Domain, asked: Asked, max_depth: int, most: int, start: Found | None, low: int) -> Found:
        """The finest step that gives at most `most` leaves, not finer than `low`; MAX_STEP + 1 if none does.

        start: what has been found for the frame before (None: nothing). It changes how long the search takes, not the
        answer. But without it, 0 is only a step that may fit: a refinement finds that out as soon as counting does.
        """
        roots = 2 * self._lattice.squares
        return lowest(partial(self._splits, domain, asked, max_depth), most - roots, start, low)

    def ramp_start(self, domain: Domain, asked: Asked, max_depth: int, most: int, step: int, leaves: int) -> float:
        """The factor on what is asked from which points rise on the mesh of `step`, the finest that keeps to a budget.

        It lies between that of the step and of the next coarser one, as the budget lies between the leaves of the step
        before and of this one. So it is continuous where the step changes: there is no jump.
        """
        last, roots = math.sqrt(limit_of(step)), 2 * self._lattice.squares
        if step > MAX_STEP or (step == 0 and leaves < NEAR * most):
            return last
        marks = self._marks
        _, found = self._splits(domain, asked, max_depth, step, step, FAR_OVER * most, self._finer)
        self._marks = marks
        finer = int(found[0]) + roots if len(found) else FAR_OVER * most
        part = (finer - most) / (finer - leaves) if finer > most else 0.0
        return last * 2.0 ** (part / STEPS_PER_OCTAVE)

    def _splits(
        self,
        domain: Domain,
        asked: Asked,
        max_depth: int,
        finest: int,
        coarsest: int,
        most: int,
        limits: wp.array | None = None,
    ):
        """The first step from `finest` to `coarsest` with at most `most` triangles that are split, and how many there
        are at each step from it on; `coarsest` + 1 and none if there is no such step.

        limits: of the steps, if other ones than those of `limit_of`.
        """
        cell_bits, steps = max_depth + max_depth % 2, len(self._limits)
        cuts = self._cuts(cell_bits, most)
        slices, spacing = len(cuts) - 1, most // 64 + 1
        get, numpy = self._buffers.get, self._buffers.numpy
        arrays = {
            "limits": self._limits if limits is None else limits,
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
            bind(struct, slot=slot, finest=finest, coarsest=coarsest, **arrays)
            bind(struct, most=most, spacing=spacing, has_errors=int(min(asked.error_px2, asked.metres2) < math.inf))
        inputs = [[domain, asked, struct] for struct in self._structs[:slices]]
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
