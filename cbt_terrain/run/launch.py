# SPDX-License-Identifier: GPL-3.0-or-later
"""The one place that launches Warp kernels: it slices work over threads and times every step. Between two launches the
work can be stopped.

On the CPU a Warp launch is one serial loop on the calling thread, and ctypes releases the GIL, so two Python threads
over two slices of one job run side by side. Results do not depend on the number of slices: every kernel writes only
what belongs to its slice.
"""

import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import warp as wp

from ..plain_numbers import plain_number
from . import kernel_cache, locks, stopping
from .buffers import shared

DEVICE = "cpu"
# Below this many items a second thread costs more than it saves: it needs about 0.3 ms of work.
SLICE_ITEMS = 20_000

_pool: ThreadPoolExecutor | None = None
_starting = locks.SharedLock()
_times = threading.local()


def default_threads() -> int:
    """Threads that a job may use: the cores this process may run on, at most eight."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, 8)


def checked_threads(threads: int | None) -> int:
    """Return how many threads a job uses: `default_threads` for None, and at least one."""
    threads = plain_number(threads, int | None, "The number of threads")
    return default_threads() if threads is None else max(1, threads)


@contextmanager
def stopwatch():
    """Collect the time of every step launched on this thread inside the block: yields a dict of step to
    milliseconds."""
    outer = getattr(_times, "steps", None)
    _times.steps = steps = {}
    try:
        yield steps
    finally:
        _times.steps = outer


@contextmanager
def timed(step: str):
    """Add the elapsed time of the block to `step` of the running stopwatch, if there is one."""
    start = time.perf_counter()
    try:
        yield
    finally:
        steps = getattr(_times, "steps", None)
        if steps is not None:
            steps[step] = steps.get(step, 0.0) + (time.perf_counter() - start) * 1e3


def ranges(count: int, pieces: int) -> list[tuple[int, int]]:
    """A range of items cut into even pieces: where each begins and ends."""
    return list(pairwise(count * k // pieces for k in range(pieces + 1)))


def together(jobs: Sequence[Callable[[], None]]) -> None:
    """Run the jobs side by side, the first on the calling thread; the first exception is raised after all have
    ended."""
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
    global _pool
    with _starting:
        if _pool is None:
            _pool = ThreadPoolExecutor(max_workers=16, thread_name_prefix="adaptive_terrain")
        return _pool


def _forget_pool() -> None:
    """Start new threads when they are needed: a forked child has none of the pool's."""
    global _pool
    _pool = None


locks.in_forked_child(_forget_pool)


def _wait_for(futures: Sequence[Future]) -> None:
    """Wait until all have ended, also where Ctrl-C stops the wait: what they write must not be used before."""
    try:
        wait(futures)
    except BaseException:
        _wait_for(futures)
        raise


def once(kernel, inputs: list, *, step: str, recorded: dict | None = None) -> None:
    """One launch of one thread: a serial kernel."""
    slices(kernel, [inputs], step=step, recorded=recorded)


def slices(kernel, inputs: Sequence[list], *, step: str, recorded: dict | None = None) -> None:
    """One launch of one thread for each list of inputs, all side by side.

    `recorded` is where a caller that launches again and again keeps the launches: replaying one takes 2 us instead of
    15. A struct that is the one of the last launch is read anew, so setting its fields is enough.
    """
    stopping.check()
    with timed(step):
        _load(kernel)
        held = {} if recorded is None else recorded
        together([_command(held, kernel, (slot, 1), values).launch for slot, values in enumerate(inputs)])


def _command(recorded: dict, kernel, place: tuple[int, int], values: list):
    """The launch of `kernel` that `recorded` has in this place, a slot and a count of items, with these values."""
    key = kernel, *place
    if key not in recorded:
        launched = wp.launch(kernel, place[1], inputs=values, device=DEVICE, record_cmd=True)
        recorded[key] = launched, list(values)
    command, last = recorded[key]
    for i, value in enumerate(values):
        if last[i] is not value:
            command.set_param_at_index(i, value)
            last[i] = value
    return command


def spread(
    kernel,
    count: int,
    inputs: list,
    *,
    step: str,
    threads: int | None = 1,
    cost: float = 1.0,
    recorded: dict | None = None,
) -> None:
    """Launch `kernel` over `count` items, cut into even ranges for `threads`; None: `default_threads`.

    The kernel's first parameter is the int32 offset that it adds to `wp.tid()`. `cost` is how many times dearer an item
    is than a lookup and a few operations (about 15 ns); small jobs stay on one thread. `recorded`: as in `slices`.
    """
    if count <= 0:
        return
    stopping.check()
    with timed(step):
        _load(kernel)
        pieces = max(1, min(int(threads or default_threads()), int(count * cost / SLICE_ITEMS)))

        def job(slot: int, lo: int, hi: int) -> Callable[[], None]:
            values = [lo, *inputs]
            if recorded is not None:
                return _command(recorded, kernel, (slot, hi - lo), values).launch
            return lambda: wp.launch(kernel, hi - lo, inputs=values, device=DEVICE)

        together([job(slot, *cut) for slot, cut in enumerate(ranges(count, pieces))])


def sort_pairs(keys: np.ndarray, values: np.ndarray, count: int, *, step: str) -> None:
    """Sort the first `count` of `keys` (float32, no -0) and `values` (int32) by the keys, equal ones in their order.

    Both have room for twice as many, which is scratch.
    """
    stopping.check()
    with timed(step):
        wp.utils.radix_sort_pairs(shared(keys, wp.float32), shared(values, wp.int32), count)


_loaded: set = set()
_loading = threading.RLock()
if hasattr(os, "register_at_fork"):  # a fork waits for a module that is being loaded: Warp could not load it again
    os.register_at_fork(before=_loading.acquire, after_in_parent=_loading.release, after_in_child=_loading.release)


def _load(kernel) -> None:
    """Compile or load the kernel's module on one thread: Warp's loader is not safe to enter twice."""
    if kernel not in _loaded:
        with _loading:
            kernel_cache.load(kernel.module.name)
            _loaded.add(kernel)
