# SPDX-License-Identifier: GPL-3.0-or-later
"""Requests to stop: a signal is noted at once, and raises an exception between two steps of the work.

An exception from a signal handler may come anywhere: between taking a lock and the `try` that releases it, or inside a
callback or a `__del__`, where Python drops it. So handlers raise nothing. A thread notes the signal, and `check`, which
is called between steps, raises `Stopped` on the main thread.
"""

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

SIGNALS = (signal.SIGINT, signal.SIGTERM)
# Time for the current step, such as a render in Blender's code, to end before the process exits. Supervisors wait
# longer before they kill (10 s and more).
GRACE_SECONDS = 5.0
# A terminal and a wrapper (timeout, make) both pass on one Ctrl-C; the user's second one comes later.
ONE_PRESS_SECONDS = 0.5

_natives: dict[int, int] = {}  # addresses of a host program's handlers that `listening` has replaced, by signal
_requested: int | None = None
_listening = False
_held = 0
_threads = threading.local()  # `check`: the function that `checking` has set


class Stopped(KeyboardInterrupt):
    """The process received a request to stop, and has stopped between two steps."""


def request_stop(number: int) -> None:
    """Let the next `check` raise Stopped, from any thread. number: number of the signal."""
    global _requested
    _requested = number


def check() -> None:
    """Raise Stopped on the main thread after a request to stop, unless the work is inside `held`.

    On a thread inside `checking`, call its function.
    """
    if (extra := getattr(_threads, "check", None)) is not None:
        extra()
    if _requested is not None and not _held and threading.current_thread() is threading.main_thread():
        raise Stopped


def answer() -> int | None:
    """Return the number of the signal that requested a stop, None without a request, and clear the request."""
    global _requested
    number, _requested = _requested, None
    return number


def end_host_work() -> None:
    """Call the host program's handler of SIGINT that `listening` has replaced, if any.

    Blender's handler ends a render, and at its second call Blender.
    """
    native = _natives.pop(signal.SIGINT, None)
    if native:
        ctypes.CFUNCTYPE(None, ctypes.c_int)(native)(signal.SIGINT)


@contextmanager
def checking(function: Callable[[], None]) -> Iterator[None]:
    """Let `check` on this thread call `function`, which raises an exception to stop the work, until the block ends."""
    before, _threads.check = getattr(_threads, "check", None), function
    try:
        yield
    finally:
        _threads.check = before


@contextmanager
def held() -> Iterator[None]:
    """Delay a stop until the end of the block, for functions that Blender calls.

    An exception in one of them would stop nothing: Blender prints it and continues.
    """
    global _held
    _held += 1
    try:
        yield
    finally:
        _held -= 1


@contextmanager
def listening() -> Iterator[None]:
    """Turn SIGINT and SIGTERM into requests to stop until the block ends.

    After the block, send the signal again unless `answer` has cleared the request. A second signal, or a step that
    takes longer than GRACE_SECONDS, ends the process at once with the code 128 + the signal's number; the next run
    removes its leftovers. Inside another such block, and on any thread except the main one, this does nothing.
    """
    global _listening
    if _listening or threading.current_thread() is not threading.main_thread():
        yield
        return
    # Ignored signals (nohup, a job in the background) stay ignored.
    numbers = [number for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN]
    # Python writes the number of each signal to a pipe, and a thread reads it from there.
    reader, writer = os.pipe()
    if hasattr(os, "set_blocking"):  # Windows does not need it
        os.set_blocking(writer, False)
    thread = threading.Thread(target=_listen, args=(reader,), name="adaptive_terrain_signals", daemon=True)
    thread.start()
    previous_fd = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    restore = [_replace(number) for number in numbers]
    _listening = True
    try:
        yield
    finally:
        _listening = False
        for put_back in restore:
            put_back()
        signal.set_wakeup_fd(previous_fd)
        os.write(writer, b"\0")  # ends the thread
        thread.join()
        os.close(reader)
        os.close(writer)
        unanswered = answer()
        if unanswered is not None:
            signal.raise_signal(unanswered)


def _replace(number: int) -> Callable[[], object]:
    """Let Python note a signal without acting on it. Return a function that restores the previous handler.

    Python then only writes the signal's number to the wakeup descriptor, from which a thread reads it.
    """
    getsig, setsig = ctypes.pythonapi.PyOS_getsig, ctypes.pythonapi.PyOS_setsig
    getsig.argtypes, getsig.restype = (ctypes.c_int,), ctypes.c_void_p
    setsig.argtypes, setsig.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
    native = getsig(number)
    before = signal.signal(number, lambda *_: None)
    if before is None:  # Blender's handler, which Python does not know
        _natives[number] = native
        return lambda: (_natives.pop(number, None), setsig(number, native))
    return lambda: signal.signal(number, before)


def _listen(reader: int) -> None:
    """Read signal numbers from the pipe `reader`, on the thread for them.

    The first asks to stop. A later one ends the process at once, unless it follows within ONE_PRESS_SECONDS. 0 ends the
    loop.
    """
    first, timer = None, None
    while number := os.read(reader, 1)[0]:
        if first is None:
            first = time.monotonic()
            request_stop(number)
            timer = threading.Timer(GRACE_SECONDS, _end, (number,))
            timer.daemon = True
            timer.start()
        elif time.monotonic() - first > ONE_PRESS_SECONDS:
            _end(number)
    if timer is not None:
        timer.cancel()


def _end(number: int) -> None:
    """End the process at once, after a second signal or if a step outlasts the first; exit code 128 + its `number`.

    This is safe, because no incomplete file has a final name.
    """
    if sys.stderr is not None:
        os.write(2, b"adaptive-terrain: stopped at once; the next run removes the leftovers\n")
    os._exit(128 + number)
