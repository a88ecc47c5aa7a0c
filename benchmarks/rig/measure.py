# SPDX-License-Identifier: GPL-3.0-or-later
"""Timing, and the row that holds a result.

Blocks of our runs and blocks of baseline runs alternate, so that a busy machine slows both. Blocks of a single run
would treat the baseline unfairly: with cold caches before every run it is about a fifth slower at 50,000 leaves, and
ours is not. Every figure is the median of the runs in blocks. The first run, which finds cold memory, is reported
separately.
"""

import statistics
import time
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field

from ...cbt_terrain.accuracy.timed_runs import median_by_step

BLOCKS, RUNS = 3, 5
# Shorter measurements use more blocks, since a short disturbance is longer than they are.
SHORT_MS, SHORT_BLOCKS = 5.0, 15
# Maximum time of a block, unless a single run is longer.
BLOCK_MS = 500.0


@dataclass
class BenchmarkRow:
    """Result of one measurement.

    Attributes:
        size: triangles, or samples of a raster.
        ms: milliseconds, the median.
        ratio: `ms / baseline_ms` unless given (a ratio of memory or triangles).
        attempts: number of measurements of which this is the best.
        first_ms: milliseconds of the first run, which finds cold memory.
        steps: milliseconds by step.
        figures: other measurements, with their units in the names.
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
    """Medians by step, the first run by step, and the median of the baseline, all in milliseconds."""

    ms: dict[str, float]
    first_ms: dict[str, float]
    baseline_ms: float | None


def alternate(ours: Callable[[], dict[str, float]], theirs: Callable[[], float] | None = None) -> Timed:
    """Run both in alternating blocks; `ours` returns milliseconds by step, `theirs` milliseconds."""
    first, _ = ours(), theirs() if theirs else 0.0
    # The first runs find cold memory, so the second ones decide how many fit into a block.
    longest, baseline_ms = max(ours().values()), theirs() if theirs else 0.0
    our_runs, baseline_runs = count_runs(longest), count_runs(baseline_ms)
    blocks = SHORT_BLOCKS if longest < SHORT_MS else BLOCKS
    blocks_per_baseline = 1 if baseline_ms < SHORT_MS else blocks // BLOCKS
    our_times, baseline_times = [], []
    for number in range(blocks):
        if theirs and number % blocks_per_baseline == 0:
            baseline_times += [theirs() for _ in range(baseline_runs)]
        our_times += [ours() for _ in range(our_runs)]
    return Timed(median_by_step(our_times), first, statistics.median(baseline_times) if baseline_times else None)


def count_runs(ms: float) -> int:
    """Return the runs in a block, given the milliseconds of one."""
    return max(1, min(RUNS, int(BLOCK_MS / max(ms, SHORT_MS))))


def time_ms(work: Callable[[], object]) -> float:
    """Return the milliseconds of one call."""
    with stopwatch() as elapsed:
        work()
    return elapsed[0]


@contextmanager
def stopwatch():
    """Yield a list that receives the milliseconds of the block at its end."""
    elapsed, start = [], time.perf_counter()
    yield elapsed
    elapsed.append((time.perf_counter() - start) * 1e3)
