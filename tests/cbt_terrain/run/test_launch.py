# SPDX-License-Identifier: GPL-3.0-or-later
"""Recorded launches read the values of the call, not those of the first one; jobs side by side end together."""

import signal
import threading

import numpy as np
import pytest
import warp as wp
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.run.buffers import bind, shared
from adaptive_terrain.kernels.field.layout import Depth


@wp.kernel
def store(value: wp.int32, depth: Depth, out: wp.array(dtype=wp.int32)):
    out[0] = value
    out[1] = depth.step


def test_a_recorded_launch_takes_new_values_structs_and_arrays():
    first, second, recorded = np.zeros(2, np.int32), np.zeros(2, np.int32), {}
    depth = Depth()
    outs = [shared(first, wp.int32), shared(second, wp.int32)]
    depth.step = 5
    launch.slices(store, [[1, depth, outs[0]]], step="store", recorded=recorded)
    assert first.tolist() == [1, 5]
    bind(depth, step=6)
    launch.slices(store, [[2, depth, outs[1]], [3, depth, outs[0]]], step="store", recorded=recorded)
    assert second.tolist() == [2, 6] and first.tolist() == [3, 6]
    assert len(recorded) == 2


@wp.kernel
def store_each(first: wp.int32, value: wp.int32, depth: Depth, out: wp.array(dtype=wp.int32)):
    i = first + wp.tid()
    out[i] = out[i] + value * (i + depth.step)


@pytest.mark.parametrize("recorded", [None, {}])
def test_items_of_a_recorded_launch_are_those_of_the_call(recorded, eager_threads):
    """Other counts and threads, values, fields and arrays than before."""
    depth, found, wanted = Depth(), np.zeros((2, 11), np.int32), np.zeros((2, 11), np.int64)
    outs = [shared(row, wp.int32) for row in found]
    for value, (count, threads) in enumerate([(11, 3), (10, 1), (11, 2), (5, 3), (11, 3), (0, 2)], 1):
        depth.step = 7 * value
        row = value % 2
        inputs = [value, depth, outs[row]]
        launch.spread(store_each, count, inputs, step="store", threads=threads, recorded=recorded)
        wanted[row, :count] += value * (np.arange(count) + 7 * value)
        assert (found == wanted).all()


@wp.kernel
def mark(first: wp.int64, out: wp.array(dtype=wp.int32)):
    i = first + wp.int64(wp.tid())
    out[i] = out[i] + 1


def test_more_items_than_a_launch_holds_are_launched_in_turn(monkeypatch):
    """No more jobs run at a time than there are threads."""
    monkeypatch.setattr(launch, "MAX_LAUNCH", 10)
    monkeypatch.setattr(launch, "SLICE_ITEMS", 1)
    together, jobs = launch.together, []
    monkeypatch.setattr(launch, "together", lambda batch: (jobs.append(len(batch)), together(batch)))
    for threads, expected in ((1, [1] * 10), (3, [3, 3, 3, 1])):
        found = np.zeros(95, np.int32)
        launch.spread(mark, 95, [shared(found, wp.int32)], step="mark", threads=threads)
        assert (found == 1).all() and jobs == expected
        jobs.clear()


@pytest.fixture
def interruptible():
    """Let Ctrl-C work, which a shell disables for processes in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_an_interrupted_wait_ends_after_all_jobs(interruptible):
    """Ctrl-C, twice, while the calling thread waits for the other job."""
    ended = threading.Event()

    def other():
        for _ in range(2):
            threading.Event().wait(0.1)
            signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        threading.Event().wait(0.1)
        ended.set()

    with pytest.raises(KeyboardInterrupt):
        launch.together([lambda: None, other])
    assert ended.is_set()


def test_more_threads_than_the_pool_has_are_not_used():
    assert [launch.checked_threads(n) for n in (-1, 1, 3, 10**6)] == [1, 1, 3, 16]
