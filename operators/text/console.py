# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line's output: a progress bar, lines for render farms, and suppressed output of other code."""

import ctypes
import json
import os
import sys
import time
from contextlib import contextmanager

from ...cbt_terrain.run import stopping

BAR_WIDTH = 28
# Kinds of progress: a bar, or lines of Open Job Description ("How Jobs Are Run", stdout messages).
BAR, OPENJD = "bar", "openjd"
LONGEST_LINE = 10_000  # a coordinate system may be long
MESSAGE = "openjd_"  # the start of a line that a farm obeys


def one_line(text: object) -> str:
    """Return a text as one line without control characters, which terminals and farms obey. Spaces stay."""
    line = "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in str(text))
    return line if len(line) <= LONGEST_LINE else f"{line[:LONGEST_LINE]}..."


def print_line(text: object, message: str = "", file=None) -> None:
    """Print a line that may hold untrusted names. All output of the product is printed here.

    Args:
        message: kind of an Open Job Description message, such as "openjd_status"; "" for an ordinary line.
        file: standard output by default.
    """
    line = one_line(text)
    if message:
        line = f"{message}: {line}"
    elif line.startswith(MESSAGE):
        line = f" {line}"
    print(line, file=file, flush=True)


def print_json(content: object, file=None) -> None:
    """Print JSON as one line of any length: a part of it would be no JSON.

    content: numbers, texts, lists and dicts. file: standard output by default.
    """
    print(json.dumps(content), file=file, flush=True)


class Progress:
    """A bar on stderr, redrawn in place, in a terminal or on request; a context manager, whose end removes it.

    Args:
        total: number of steps. Steps without work do not count in the estimate of the time left.
        label: name of the work, before the bar.
        show: whether to draw the bar; OPENJD for a line on stdout at each whole per cent instead; None for a bar if
            stderr is a terminal.
    """

    def __init__(self, total: float, label: str, show: bool | str | None = None):
        self.total, self.label = total, one_line(label)
        self.show = sys.stderr.isatty() if show is None else show
        self.done = self._worked = 0.0
        self._drawn = ""
        self._start = time.monotonic()
        self._draw()

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *_error) -> None:
        self.close()

    def to(self, done: float, worked: bool = True) -> None:
        """Move the bar to `done` steps. Raises Stopped.

        worked: False for steps without work, as skipped frames, which do not count in the estimate of the time left.
        """
        if worked:
            self._worked += done - self.done
        self.done = done
        self._draw()
        stopping.check()

    def say(self, line: str) -> None:
        """Print a line to stdout, above the bar."""
        self._clear()
        print_line(line, "openjd_status" if self.show == OPENJD else "")
        self._draw()

    def close(self) -> None:
        """Remove the bar from the terminal."""
        self._clear()
        self.show = False

    def left_s(self) -> float | None:
        """Estimate the seconds left; None before any work."""
        if not self._worked > 0:
            return None
        return (time.monotonic() - self._start) / self._worked * (self.total - self.done)

    def _draw(self) -> None:
        """Redraw the bar, or print the per cent for a farm, if it has changed."""
        if not self.show:
            return
        fraction = self.done / self.total if self.total else 1.0
        if self.show == OPENJD:
            line = f"openjd_progress: {int(100 * fraction)}"
            if line != self._drawn:
                self._drawn = line
                print(line, flush=True)
            return
        filled = int(BAR_WIDTH * fraction)
        left = self.left_s()
        remaining = "" if left is None else f"  {duration(left)} left"
        bar = f"{self.label} [{'#' * filled}{'.' * (BAR_WIDTH - filled)}] {fraction:4.0%}{remaining}"
        if bar != self._drawn:
            self._drawn = bar
            sys.stderr.write(f"\r\x1b[K{bar}")
            sys.stderr.flush()

    def _clear(self) -> None:
        """Erase the bar's line in the terminal, before other output."""
        if self.show and self.show != OPENJD:
            self._drawn = ""
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()


def duration(seconds: float) -> str:
    """Format seconds as `8 s`, `2:05 min` or `1:02 h`, for the time that is left."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole // 60 % 60:02d} h"


def open_streams() -> None:
    """Open closed standard streams on the null device; otherwise the next opened file would get their output.

    Characters that the encoding of stdout lacks are printed as escapes.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:  # the lowest free descriptor
        os.set_inheritable(number, True)
    os.close(number)
    sys.stdout, sys.stderr = (stream or open(os.devnull, "w") for stream in (sys.stdout, sys.stderr))
    sys.stdout.reconfigure(errors="backslashreplace")


def why_stdout_failed(error: Exception) -> str:
    """Return why stdout cannot be written, or "" if `error` has another cause. error: the exception of a command.

    The rest of the output is dropped, since Python would try to write it at exit and report another error.
    """
    try:
        print(end="", flush=True)
    except OSError as reason:
        error = reason
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)
    else:  # Nothing is left to write: stdout works, or Python has dropped the output because the pipe is broken.
        if not isinstance(error, BrokenPipeError):
            return ""
    return f"stdout cannot be written ({error.strerror}): make room, or keep reading from the pipe."


@contextmanager
def quiet(*streams: int):
    """Suppress output of native code, such as Blender's reports of files. `streams`: descriptors, stdout by default.

    Everything that the process writes to them in the `with` block is lost, on any thread.
    """
    streams = streams or (1,)
    _flush()
    copies, nowhere = [os.dup(stream) for stream in streams], os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in streams:
            os.dup2(nowhere, stream)
        yield
    finally:
        _flush()
        for stream, copy in zip(streams, copies, strict=True):
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nowhere)


def _flush() -> None:
    """Flush the buffers of Python and of the C library."""
    sys.stdout.flush()
    sys.stderr.flush()
    library = ctypes.cdll.ucrtbase if sys.platform == "win32" else ctypes.CDLL(None)
    library.fflush(None)
