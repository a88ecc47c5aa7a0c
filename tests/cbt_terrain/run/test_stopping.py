# SPDX-License-Identifier: GPL-3.0-or-later
"""A signal to stop is heard anywhere, obeyed between steps only, and never lost."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from adaptive_terrain.cbt_terrain.run import stopping
from adaptive_terrain.cbt_terrain.run.stopping import Stopped, check, held, listening

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")


@pytest.fixture(autouse=True)
def interruptible():
    """Let interruptions work, which may be ignored for runs in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
    assert stopping.answer() is None


def wait_for_stop():
    """Until the thread that listens has noted the signal."""
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        check()
        time.sleep(0.001)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_work_is_left_between_steps_and_handlers_come_back(number):
    before = signal.getsignal(number)
    with listening():
        signal.raise_signal(number)  # nothing happens here
        with pytest.raises(Stopped):
            wait_for_stop()
        assert stopping.answer() == number
        check()
    assert signal.getsignal(number) is before


def test_a_stop_is_not_lost_where_an_exception_would_be():
    class Dropped:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    with listening():
        Dropped()
        with pytest.raises(Stopped):
            wait_for_stop()
        stopping.answer()


def test_what_nobody_answers_is_sent_again():
    with pytest.raises(KeyboardInterrupt) as caught, listening():
        signal.raise_signal(signal.SIGINT)
    assert caught.type is KeyboardInterrupt, "Python's own"


def test_a_stop_waits_for_a_handler_of_blender():
    with listening():
        with held():
            signal.raise_signal(signal.SIGTERM)
            time.sleep(0.05)
            check()
        with pytest.raises(Stopped):
            wait_for_stop()
        stopping.answer()


def test_what_is_ignored_stays_ignored():
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with listening():
        signal.raise_signal(signal.SIGINT)
        time.sleep(0.05)
        check()
        assert signal.getsignal(signal.SIGINT) == signal.SIG_IGN


def test_other_threads_are_left_alone():
    seen = []

    def work():
        with listening():  # does nothing here
            seen.append(signal.getsignal(signal.SIGINT))
            check()
            seen.append("all of it")

    with listening():
        inside = signal.getsignal(signal.SIGINT)
        stopping.request_stop(signal.SIGINT)
        thread = threading.Thread(target=work)
        thread.start()
        thread.join()
        stopping.answer()
    assert seen == [inside, "all of it"]


STUCK = """
import os, sys, time
from adaptive_terrain.cbt_terrain.run import stopping
stopping.GRACE_SECONDS = float(sys.argv[1])
with stopping.listening():
    print("here", flush=True)
    time.sleep(600)
"""


@pytest.mark.parametrize(("grace", "second"), [(0.3, None), (600, signal.SIGINT)])
def test_a_step_that_does_not_end_is_ended(grace, second):
    """After a while, or by a second signal; but two at once are one press of Ctrl-C."""
    process = subprocess.Popen(
        [sys.executable, "-c", STUCK, str(grace)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    process.stdout.readline()
    process.send_signal(signal.SIGTERM)
    if second is not None:
        process.send_signal(second)
        time.sleep(1.2 * stopping.ONE_PRESS_SECONDS)
        assert process.poll() is None
        while process.poll() is None:  # a busy machine may have delivered the first two late
            process.send_signal(second)
            time.sleep(0.1)
    said = process.communicate(timeout=120)[1].decode()
    assert process.returncode == 128 + (second or signal.SIGTERM)
    assert said.startswith("adaptive-terrain: stopped at once") and said.count("\n") == 1
