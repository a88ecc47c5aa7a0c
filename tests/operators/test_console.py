# SPDX-License-Identifier: GPL-3.0-or-later
"""An interruption waits for what must not be interrupted, and is not lost."""

import signal
import threading

import pytest
from adaptive_terrain.operators.console import interruption_held


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
