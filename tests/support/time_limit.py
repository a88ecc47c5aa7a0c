# SPDX-License-Identifier: GPL-3.0-or-later
"""A time limit for what may block in the system, as opening a pipe does."""

import signal
from contextlib import contextmanager


class TimeLimitPassed(BaseException):
    """The time is over; no `except Exception` catches this."""


@contextmanager
def time_limit(seconds: float):
    """Raise TimeLimitPassed in the main thread when the block takes longer, also inside a system call."""

    def stop(_signal, _frame):
        raise TimeLimitPassed(f"{seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
