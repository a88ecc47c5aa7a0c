# SPDX-License-Identifier: GPL-3.0-or-later
"""The only module that launches Warp kernels: it slices work over threads and times every step.

On the CPU a Warp launch is one serial loop on the calling thread, and ctypes releases the GIL, so two Python threads
run two slices of a job in parallel. Results do not depend on the number of slices, because every kernel writes only to
its slice. Work can be stopped between two launches. `step` is the name under which a launch's time is counted.
"""

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from ..plain_numbers import plain_number
from . import locks, stopping

if TYPE_CHECKING:
    import warp as wp

DEVICE = "cpu"
# Fewer items are faster on one thread: a second one needs about 0.3 ms of work.
SLICE_ITEMS = 20_000
# Items of one launch: `wp.tid()` is int32.
MAX_LAUNCH = 1 << 30

MAX_THREADS = 16  # of the pool; results do not depend on their number

_pool: ThreadPoolExecutor | None = None
_starting = locks.SharedLock()
_times = threading.local()


def default_threads() -> int:
    """Return the number of cores that this process may use, at most eight."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, 8)


def checked_threads(threads: int | None) -> int:
    """Return the number of threads of a job: `default_threads` for None, from 1 to MAX_THREADS. Raises TerrainError."""
    threads = plain_number(threads, int | None, "The number of threads")
    return default_threads() if threads is None else min(max(1, threads), MAX_THREADS)


@contextmanager
def stopwatch() -> Iterator[dict[str, float]]:
    """Yield a dict that collects the milliseconds of every step that this thread launches inside the block.

    The stopwatch of an outer block misses these steps.
    """
    outer = getattr(_times, "steps", None)
    steps: dict[str, float] = {}
    _times.steps = steps
    try:
        yield steps
    finally:
        _times.steps = outer


@contextmanager
def timed(step: str) -> Iterator[None]:
    """Add the milliseconds that the block takes to `step` of the thread's stopwatch, if `stopwatch` has started one."""
    start = time.perf_counter()
    try:
        yield
    finally:
        steps = getattr(_times, "steps", None)
        if steps is not None:
            steps[step] = steps.get(step, 0.0) + (time.perf_counter() - start) * 1e3


def ranges(count: int, pieces: int) -> list[tuple[int, int]]:
    """Return the first item and the end of each of `pieces` ranges of equal length, which divide `count` items."""
    return list(pairwise(count * k // pieces for k in range(pieces + 1)))


def together(jobs: Sequence[Callable[[], None]]) -> None:
    """Run jobs in parallel, the first on the calling thread. Raise the first exception after all jobs have ended."""
    if len(jobs) < 2:
        for job in jobs:
            job()
        return
    pool = _shared_pool()
    futures = [pool.submit(job) for job in jobs[1:]]
    try:
        jobs[0]()
    finally:
        _wait_for(futures)
    for future in futures:
        future.result()


def _shared_pool() -> ThreadPoolExecutor:
    """Return the process's pool of MAX_THREADS threads, created on first use; further jobs wait for a free one."""
    global _pool
    with _starting:
        if _pool is None:
            _pool = ThreadPoolExecutor(max_workers=MAX_THREADS, thread_name_prefix="adaptive_terrain")
        return _pool


def _forget_pool() -> None:
    """Drop the pool in a forked child, which has none of its threads."""
    global _pool
    _pool = None


locks.in_forked_child(_forget_pool)


def _wait_for(futures: Sequence[Future]) -> None:
    """Wait until all jobs have ended, even if Ctrl-C interrupts, because their output must not be used before."""
    try:
        wait(futures)
    except BaseException:
        _wait_for(futures)
        raise


def once(kernel: "wp.Kernel", inputs: list, *, step: str, recorded: dict | None = None) -> None:
    """Launch a kernel that is one serial loop, on the calling thread.

    recorded: dictionary of recorded launches, which are faster when repeated; None to record none.
    """
    slices(kernel, [inputs], step=step, recorded=recorded)


def slices(kernel: "wp.Kernel", inputs: Sequence[list], *, step: str, recorded: dict | None = None) -> None:
    """Launch a kernel, a serial loop over one slice, with each list of inputs: in parallel, each on its own thread.

    Without any list it only loads the kernel. `recorded` caches launches for a caller that launches again and again:
    replaying one takes 2 us instead of 15. A struct that is identical to that of the last launch is read again, so
    setting its fields is enough. None: no cache.
    """
    stopping.check()
    with timed(step):
        _load(kernel)
        held = {} if recorded is None else recorded
        together([_command(held, kernel, slot, count=1, values=values).launch for slot, values in enumerate(inputs)])


def _command(recorded: dict, kernel: "wp.Kernel", slot: int, count: int, values: list) -> Any:
    """Return the recorded launch of `kernel` over `count` items, with `values` as its inputs; record it at first.

    recorded: launches so far, by kernel, slot and count. Slots that run in parallel must not share a launch, so `slot`
    is in the key. Setting a parameter costs about as much as a launch, so only values that are another object than in
    the last launch are set.
    """
    key = kernel, slot, count
    if key not in recorded:
        from ...kernels import wp

        launched = wp.launch(kernel, count, inputs=values, device=DEVICE, record_cmd=True)
        recorded[key] = launched, list(values)
    command, last = recorded[key]
    for i, value in enumerate(values):
        if last[i] is not value:
            command.set_param_at_index(i, value)
            last[i] = value
    return command


def spread(
    kernel: "wp.Kernel",
    count: int,
    inputs: list,
    *,
    step: str,
    threads: int | None = 1,
    cost: float = 1.0,
    recorded: dict | None = None,
) -> None:
    """Launch `kernel` over `count` items, in equal ranges for `threads`; None: `default_threads`.

    The kernel's first parameter is the int32 offset that it adds to `wp.tid()`, `inputs` are the others. `cost` is the
    cost of an item relative to a lookup and a few operations (about 15 ns); small jobs stay on one thread. More than
    MAX_LAUNCH items need an int64 offset. `recorded`: dictionary of recorded launches, which are faster when repeated;
    None to record none.
    """
    from ...kernels import wp

    if count <= 0:
        return
    stopping.check()
    with timed(step):
        _load(kernel)
        # Launches at the same time: each with at least SLICE_ITEMS lookups of work, which outweighs its start.
        threads = threads if type(threads) is int else checked_threads(threads)
        at_once = max(1, min(threads or default_threads(), int(count * cost / SLICE_ITEMS)))
        # All launches; more than `at_once` only if a launch cannot hold its part of the items.
        pieces = max(at_once, -(-count // MAX_LAUNCH))

        def job(slot: int, lo: int, hi: int) -> Callable[[], None]:
            """Return the launch over the items `lo` to `hi`."""
            values = [lo, *inputs]
            if recorded is not None:
                return _command(recorded, kernel, slot, hi - lo, values).launch
            return lambda: wp.launch(kernel, hi - lo, inputs=values, device=DEVICE)

        jobs = [job(slot, *cut) for slot, cut in enumerate(ranges(count, pieces))]
        for first in range(0, pieces, at_once):
            together(jobs[first : first + at_once])


_loaded: set = set()
_loading = threading.RLock()
if hasattr(os, "register_at_fork"):  # a fork waits for a module that is being loaded: Warp could not load it again
    os.register_at_fork(before=_loading.acquire, after_in_parent=_loading.release, after_in_child=_loading.release)


def _load(kernel: "wp.Kernel") -> None:
    """Load the kernel's module, compiled if necessary, on one thread, because Warp's loader is not reentrant."""
    if kernel not in _loaded:
        from . import kernel_cache

        with _loading:
            kernel_cache.load(kernel.module.name)
            _loaded.add(kernel)
