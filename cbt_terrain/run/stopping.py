# SPDX-License-Identifier: GPL-3.0-or-later
"""A wish to stop: a signal that is heard at once and obeyed at the next place where work can be left.

An exception out of a signal handler comes anywhere: between taking a lock and the `try` that gives it back, or inside a
callback or a `__del__`, where Python drops it. So nothing is raised there. A thread notes the signal, and `check`,
which is called between steps, raises `Stopped` on the main thread.
"""

import ctypes
import os
import signal
import sys
import threading
import time
from contextlib import contextmanager

SIGNALS = (signal.SIGINT, signal.SIGTERM)
# So long may a step take to come to an end, a render in Blender's own code, say; then the process ends where it is.
# Less than what supervisors wait before they kill (10 s and more).
GRACE_SECONDS = 5.0
# A terminal and a wrapper (timeout, make) both pass one Ctrl-C on; a second one of the user comes later.
ONE_PRESS_SECONDS = 0.5

_natives: dict[int, int] = {}  # by signal: the address of the handler of a host program that `listening` has replaced
_asked: int | None = None
_listening = False
_held = 0


class Stopped(KeyboardInterrupt):
    """The process was asked to stop, and work has been left where it can be."""


def ask(number: int) -> None:
    """Have the next `check` raise; `number`: of the signal. For any thread."""
    global _asked
    _asked = number


def check() -> None:
    """Raise Stopped on the main thread if someone has asked for it and nobody holds it off."""
    if _asked is not None and not _held and threading.current_thread() is threading.main_thread():
        raise Stopped


def answer() -> int | None:
    """The number of the signal that has asked to stop, which is done with now; None if there is none."""
    global _asked
    number, _asked = _asked, None
    return number


def end_host_work() -> None:
    """Have the host program hear the SIGINT whose handler `listening` has replaced: Blender's ends a render, and at its
    second call Blender. Without such a handler nothing happens."""
    native = _natives.pop(signal.SIGINT, None)
    if native:
        ctypes.CFUNCTYPE(None, ctypes.c_int)(native)(signal.SIGINT)


@contextmanager
def held():
    """Let a stop wait for the end of the block: Blender prints a traceback of what leaves a handler, and goes on."""
    global _held
    _held += 1
    try:
        yield
    finally:
        _held -= 1


@contextmanager
def listening():
    """Turn SIGINT and SIGTERM into wishes to stop until the block ends; then they mean what they meant before, and one
    that nobody has answered is sent again.

    A second signal, or a step that takes longer than GRACE_SECONDS to end, ends the process at once with the code 128 +
    the signal's number: what it leaves behind, the next run removes. Inside another such block, and on any thread but
    the main one, this does nothing.
    """
    global _listening
    if _listening or threading.current_thread() is not threading.main_thread():
        yield
        return
    # What is ignored (nohup, a job in the background) stays ignored.
    numbers = [number for number in SIGNALS if signal.getsignal(number) != signal.SIG_IGN]
    reader, writer = os.pipe()
    if hasattr(os, "set_blocking"):  # Windows, which does not ask for it, has it from Python 3.12
        os.set_blocking(writer, False)
    thread = threading.Thread(target=_listen, args=(reader,), name="adaptive_terrain_signals", daemon=True)
    thread.start()
    fd = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    restore = [_replace(number) for number in numbers]
    _listening = True
    try:
        yield
    finally:
        _listening = False
        for put_back in restore:
            put_back()
        signal.set_wakeup_fd(fd)
        os.write(writer, b"\0")
        thread.join()
        os.close(reader)
        os.close(writer)
        number = answer()
        if number is not None:
            signal.raise_signal(number)


def _replace(number: int):
    """Have Python hear a signal, and do nothing; returns a function that puts the handler of before back."""
    getsig, setsig = ctypes.pythonapi.PyOS_getsig, ctypes.pythonapi.PyOS_setsig
    getsig.argtypes, getsig.restype = (ctypes.c_int,), ctypes.c_void_p
    setsig.argtypes, setsig.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
    native = getsig(number)
    before = signal.signal(number, lambda *_: None)
    if before is None:  # Blender's own, which Python does not know
        _natives[number] = native
        return lambda: (_natives.pop(number, None), setsig(number, native))
    return lambda: signal.signal(number, before)


def _listen(reader: int) -> None:
    """The thread that hears signals; a 0 ends it."""
    first, end = None, None
    while number := os.read(reader, 1)[0]:
        if first is None:
            first = time.monotonic()
            ask(number)
            end = threading.Timer(GRACE_SECONDS, _end, (number,))
            end.daemon = True
            end.start()
        elif time.monotonic() - first > ONE_PRESS_SECONDS:
            _end(number)
    if end is not None:
        end.cancel()


def _end(number: int) -> None:
    """End the process where it is. Nothing half-done has a final name, so it may be left."""
    if sys.stderr is not None:
        os.write(2, b"adaptive-terrain: stopped at once; the next run removes what is left over\n")
    os._exit(128 + number)
