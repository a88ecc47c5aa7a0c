# SPDX-License-Identifier: GPL-3.0-or-later
"""How a time is taken, and the row that holds it.

Ours and the baseline take turns in blocks, so that a machine that is busy for a moment is busy for both. Blocks of one
run would be fairer still to a busy machine, but not to the baseline: with its caches taken away after every run it is
about a fifth slower at 50,000 leaves, ours is not. Every figure is the median of all runs but the first of each; ours
is reported apart, because it finds cold memory.
"""

import statistics
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field

from ...cbt_terrain.accuracy.timed_runs import median_by_step

BLOCKS, RUNS = 3, 5
# What takes less than this is measured more often: a moment's disturbance is larger than it.
SHORT_MS, SHORT_BLOCKS = 5.0, 15
# No block takes longer, unless one run does: a moment's disturbance is nothing to runs that are long.
BLOCK_MS = 500.0


@dataclass
class Row:
    """One line of the result. `size` counts triangles (samples, where a raster is measured); times are milliseconds.

    `ratio` is `ms / baseline_ms` unless given (memory, slopes). `attempts`: of how many measurements this is the best.
    `steps`: milliseconds of the parts. `figures`: what else was measured, units in the names. `first_ms`: the first
    run, with memory that was never touched.
    """

    name: str
    size: int
    ms: float | None
    baseline: str | None = None
    baseline_ms: float | None = None
    ratio: float | None = None
    attempts: int = 1
    first_ms: float | None = None
    steps: dict[str, float] = field(default_factory=dict)
    figures: dict[str, float] = field(default_factory=dict)

    def __post_init__(self):
        if self.ratio is None and self.ms is not None and self.baseline_ms:
            self.ratio = self.ms / self.baseline_ms


@dataclass
class Timed:
    """Medians: `ms` by step, `baseline_ms` None without a baseline; `first_ms` by step of the first run."""

    ms: dict[str, float]
    first_ms: dict[str, float]
    baseline_ms: float | None


def alternate(ours: Callable[[], dict[str, float]], theirs: Callable[[], float] | None = None) -> Timed:
    """Run both in turns of RUNS, or as many as a block has time for, BLOCKS times, or SHORT_BLOCKS what is short;
    `ours` returns milliseconds by step."""
    first, first_other = ours(), theirs() if theirs else 0.0
    longest = max(first.values())
    own, others = runs_of(longest), runs_of(first_other)
    blocks = SHORT_BLOCKS if longest < SHORT_MS else BLOCKS
    every = 1 if first_other < SHORT_MS else blocks // BLOCKS  # blocks of ours to one of a baseline that is not short
    mine, other = [], []
    for number in range(blocks):
        if theirs and number % every == 0:
            other += [theirs() for _ in range(others)]
        mine += [ours() for _ in range(own)]
    return Timed(median_by_step(mine), first, statistics.median(other) if other else None)


def runs_of(ms: float) -> int:
    """How many runs that take so long are a block."""
    return max(1, min(RUNS, int(BLOCK_MS / max(ms, SHORT_MS))))


@contextmanager
def stopwatch():
    """Yields a list that holds the block's milliseconds once it has ended."""
    elapsed, start = [], time.perf_counter()
    yield elapsed
    elapsed.append((time.perf_counter() - start) * 1e3)
