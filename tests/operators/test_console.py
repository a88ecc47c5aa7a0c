# SPDX-License-Identifier: GPL-3.0-or-later
"""An interruption waits for what must not be interrupted, and is not lost."""

import signal
import threading

import pytest
from adaptive_terrain.operators.console import interruption_held


@pytest.fixture(autouse=True)
def interruptible():
    """A run in the background may have been started with interruptions ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_what_is_ignored_stays_ignored():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with interruption_held():
        signal.raise_signal(signal.SIGINT)


def test_an_interruption_comes_at_the_end():
    done = []
    with pytest.raises(KeyboardInterrupt), interruption_held():
        signal.raise_signal(signal.SIGINT)
        done.append("all of it")
    assert done == ["all of it"]
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


def test_without_an_interruption_nothing_happens_on_any_thread():
    before, seen = signal.getsignal(signal.SIGINT), []

    def work():
        with interruption_held():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    work()
    assert seen[0] is before and seen[1] is not before
    assert signal.getsignal(signal.SIGINT) is before
