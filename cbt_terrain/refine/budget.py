# SPDX-License-Identifier: GPL-3.0-or-later
"""The factor that relaxes a criterion so that the mesh keeps to a number of leaves.

A *step* is one of a row of factors, 128 of them an octave, from 0 (not relaxed) to MAX_STEP. lattice: the root squares
of the field. request: the criterion on the placed field. history: hints and scratch arrays, which only save time.
"""

import math
from functools import cache, partial

import numpy as np
import warp as wp

from ...kernels.budget.count import count
from ...kernels.budget.count_state import CELLS, MARKS, STEPS_PER_OCTAVE, Cell, Count
from ..field.lattice import Lattice
from ..history.frame_history import FrameHistory
from ..run import launch
from ..run.buffers import bind, shared
from .request import RefinementRequest
from .step_search import MAX_STEP, Found, find_finest_step

# Where an unrelaxed mesh has less than this fraction of the leaves that it may have, it also fits a step finer.
NEAR = 0.5
# Counting ends at FAR_OVER times the leaves that there may be.
FAR_OVER = 64


def limit_at_step(step: int) -> float:
    """Return the factor on the criterion's squares at a relaxation step; infinity beyond MAX_STEP."""
    return 2.0 ** (2 * step / STEPS_PER_OCTAVE) if step <= MAX_STEP else math.inf


@cache
def _limits(finer_by: int) -> wp.array:
    """Return the factors on the criterion's squares of all relaxation steps, each `finer_by` steps finer."""
    return shared(np.array([limit_at_step(step - finer_by) for step in range(MAX_STEP + 2)]), wp.float64)


def search(
    lattice: Lattice,
    request: RefinementRequest,
    history: FrameHistory,
    threads: int,
    max_leaves: int,
    start: Found | None,
    low: int,
) -> Found:
    """Find the finest relaxation step that gives at most `max_leaves`, not finer than `low`; MAX_STEP + 1 if none does.

    start: the last frame's result, None without one. It changes how long the search takes, not the answer. Without it,
    step 0 is returned uncounted unless counts of coarser steps predict too many leaves: the refinement that follows
    shows as soon as a count would whether it fits.
    """
    roots = 2 * lattice.squares
    count_at = partial(count_splits, lattice, request, history, threads)
    return find_finest_step(count_at, max_leaves - roots, start, low)  # each split adds a leaf to the roots


def ramp_start(
    lattice: Lattice, request: RefinementRequest, history: FrameHistory, threads: int, step: int, leaves: int
) -> float:
    """Return the factor on the criterion from which vertices morph on the mesh of relaxation step `step`.

    step: the finest one that keeps to the budget; it has `leaves` leaves. The factor is the step's own if the next
    finer step would just keep to the budget, too. It rises to that of the next coarser step as the leaves of this step
    rise to the budget. So it is continuous where the step changes, and no vertex jumps.
    """
    factor_at_step, roots = math.sqrt(limit_at_step(step)), 2 * lattice.squares  # limits are of squares
    max_leaves = max(request.max_leaves, roots)
    # no step keeps to the budget, or the next finer one does, too
    if step > MAX_STEP or (step == 0 and leaves < NEAR * max_leaves):
        return factor_at_step
    # points of the curve between equal work, where the next search cuts it; the count below would replace them
    search_marks = history.hints.marks
    # Count at the next finer step. It may be -1, so the count is at this step with limits that are a step finer.
    _, splits = count_splits(
        lattice, request, history, threads, finest=step, coarsest=step, max_splits=FAR_OVER * max_leaves, finer_by=1
    )
    history.hints.marks = search_marks
    finer_leaves = int(splits[0]) + roots if len(splits) else FAR_OVER * max_leaves
    # where the budget is from the finer step's leaves (0) to this step's (1)
    fraction = (finer_leaves - max_leaves) / (finer_leaves - leaves) if finer_leaves > max_leaves else 0.0
    return factor_at_step * 2.0 ** (fraction / STEPS_PER_OCTAVE)


def count_splits(
    lattice: Lattice,
    request: RefinementRequest,
    history: FrameHistory,
    threads: int,
    finest: int,
    coarsest: int,
    max_splits: int,
    finer_by: int = 0,
) -> tuple[int, np.ndarray]:
    """Count the triangles that are split at each relaxation step from `finest` to `coarsest`.

    Return the first step with at most `max_splits`, and the counts from it on; `coarsest` + 1 and no counts if there is
    no such step. Slices of the space-filling curve through all triangles are counted in parallel. `history.hints.marks`
    becomes the places on the curve after equal shares of work, so that the next count has slices of equal work.
    finer_by: number of steps by which the limits are finer.
    """
    domain, criterion, max_depth, scratch = request.domain, request.criterion, request.max_depth, history.scratch
    # Cells are square: an even number of bisections. Steps include MAX_STEP + 1, which stands for none.
    cell_bits, steps = max_depth + max_depth % 2, MAX_STEP + 2
    cuts = _cut_tree(lattice, history.hints.marks, threads, cell_bits, max_splits)
    slices, spacing = len(cuts) - 1, max_splits // 64 + 1  # spacing: diamonds that are measured from mark to mark
    arrays = {
        "limit_factors": _limits(finer_by),
        "stack": scratch.get("count_stack", slices * CELLS, Cell),
        "last_steps": scratch.get("count_last_steps", slices * steps, wp.int64),
        "from_step": scratch.get("count_from_step", slices, wp.int32),
        "marks": scratch.get("count_marks", slices * MARKS, wp.uint64),
        "measured": scratch.get("count_measured", slices, wp.int64),
    }
    # [slice, step]: number of triangles that are split at this step and all finer ones, and at no coarser one
    last_steps = scratch.numpy("count_last_steps")[: slices * steps].reshape(slices, steps)
    last_steps[:] = 0
    structs = [scratch.struct(Count, slot) for slot in range(slices)]
    for slot, struct in enumerate(structs):
        bind(struct, first_cell=cuts[slot], end_cell=cuts[slot + 1], cell_bits=cell_bits, max_depth=max_depth)
        bind(struct, slot=slot, finest=finest, coarsest=coarsest, **arrays)
        bind(
            struct,
            max_splits=max_splits,
            spacing=spacing,
            has_errors=int(min(criterion.error_px2, criterion.metres2) < math.inf),
        )
    launch.slices(count, [[domain, criterion, struct] for struct in structs], step="budget", recorded=scratch.launches)
    num_marks = np.minimum(scratch.numpy("count_measured")[:slices] // spacing, MARKS)
    marks = scratch.numpy("count_marks")[: slices * MARKS].reshape(slices, MARKS)
    marks_by_slice = [row[:n] for row, n in zip(marks, num_marks, strict=True)]
    history.hints.marks = np.concatenate(marks_by_slice) / 2.0**cell_bits
    first = int(scratch.numpy("count_from_step")[:slices].max())
    # A step has the splits whose last step is this one or a coarser one: sums from the end.
    splits = np.cumsum(last_steps[:, first : coarsest + 1].sum(axis=0)[::-1])[::-1]
    too_fine = int(np.count_nonzero(splits > max_splits))  # each slice knows only its own splits
    return first + too_fine, splits[too_fine:]


def _cut_tree(lattice: Lattice, marks: np.ndarray, threads: int, cell_bits: int, max_splits: int) -> list[int]:
    """Return the cells at which the tree is cut for the threads: evenly by the work of the last count.

    marks: positions along the curve, in root squares, between which the last count did equal work. cell_bits:
    bisections of a square down to cells. max_splits: largest count of splits; a small one is not worth several threads.
    Any cut gives the same mesh.
    """
    end = lattice.squares << cell_bits
    if threads < 2 or max_splits < launch.SLICE_ITEMS or len(marks) < threads:
        return [0, end]
    marks_at_cuts = [marks[len(marks) * k // threads] for k in range(1, threads)]
    return [0, *sorted({cut for cut in (int(mark * 2.0**cell_bits) for mark in marks_at_cuts) if 0 < cut < end}), end]
