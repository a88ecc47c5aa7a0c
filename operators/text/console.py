# SPDX-License-Identifier: GPL-3.0-or-later
"""What the command line shows: a progress bar with the time left, or lines that a render farm reads, and silence from
programs that talk."""

import ctypes
import os
import sys
import time
from contextlib import contextmanager

from ...cbt_terrain.run import stopping

BAR_WIDTH = 28
# How progress is told: a bar for people, or the lines of Open Job Description ("How Jobs Are Run", stdout messages).
BAR, OPENJD = "bar", "openjd"


LONGEST_LINE = 10_000  # a coordinate system may be long
# What a line begins with that a farm obeys.
MESSAGE = "openjd_"


def one_line(text: object) -> str:
    """Return a text as one line without control characters, which terminals and farms obey. Spaces stay as they are."""
    line = "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in str(text))
    return line if len(line) <= LONGEST_LINE else f"{line[:LONGEST_LINE]}..."


def print_line(text: object, message: str = "", file=None) -> None:
    """Print a line that may hold names of strangers; everything that the product prints goes through here.

    Args:
        message: the kind of Open Job Description message, such as "openjd_status"; no other line is one.
        file: standard output by default.
    """
    line = one_line(text)
    if message:
        line = f"{message}: {line}"
    elif line.startswith(MESSAGE):
        line = f" {line}"
    print(line, file=file, flush=True)


class Progress:
    """A bar on stderr, redrawn in place; it shows only where someone looks at a terminal, or where it is asked for.

    `total` is the number of steps; a step that had nothing to do is not counted in the estimate of the time left.
    `show`: OPENJD for a line on stdout at each whole per cent instead.
    """

    def __init__(self, total: float, label: str, show: bool | str | None = None):
        self.total, self.label = total, one_line(label)
        self.show = sys.stderr.isatty() if show is None else show
        self.done = self._worked = 0.0
        self._drawn = ""
        self._start = time.monotonic()
        self._draw()

    def to(self, done: float, worked: bool = True) -> None:
        """Move the bar to `done` steps; `worked` is False if getting there was free. Raises Stopped."""
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
        """Take the bar off the terminal."""
        self._clear()
        self.show = False

    def left_s(self) -> float | None:
        """Seconds left at the speed so far; None while nothing is known."""
        if not self._worked > 0:
            return None
        return (time.monotonic() - self._start) / self._worked * (self.total - self.done)

    def _draw(self) -> None:
        if not self.show:
            return
        part = self.done / self.total if self.total else 1.0
        if self.show == OPENJD:
            self._draw_line(f"openjd_progress: {int(100 * part)}")
            return
        filled = int(BAR_WIDTH * part)
        left = self.left_s()
        remaining = "" if left is None else f"  {duration(left)} left"
        bar = f"{self.label} [{'#' * filled}{'.' * (BAR_WIDTH - filled)}] {part:4.0%}{remaining}"
        if bar != self._drawn:
            self._drawn = bar
            sys.stderr.write(f"\r\x1b[K{bar}")
            sys.stderr.flush()

    def _draw_line(self, line: str) -> None:
        if line != self._drawn:
            self._drawn = line
            print(line, flush=True)

    def _clear(self) -> None:
        if self.show and self.show != OPENJD:
            self._drawn = ""
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()


def duration(seconds: float) -> str:
    """`8 s`, `2:05 min`, `1:02 h`."""
    whole = max(0, round(seconds))
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d} min"
    return f"{whole // 3600}:{whole // 60 % 60:02d} h"


def open_streams() -> None:
    """Before anything else: standard streams that whoever started the process has closed lead nowhere. Else the next
    file gets their number, and what is printed. A name that a stream's encoding lacks is shown in escapes."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    sys.stdout, sys.stderr = (stream or open(os.devnull, "w") for stream in (sys.stdout, sys.stderr))
    sys.stdout.reconfigure(errors="backslashreplace")


def unwritten(error: Exception) -> str:
    """Why stdout has not taken what was printed, or "" if `error` came from elsewhere. Python tries again when it ends,
    and reports that in its own words; so what is left goes nowhere."""
    try:
        print(end="", flush=True)
    except OSError as reason:
        error = reason
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.close(nowhere)
    else:
        if not isinstance(error, BrokenPipeError):  # which drops what is left
            return ""
    return f"stdout takes no more ({error.strerror}): expected a file or a pipe that does; make room, or read on."


@contextmanager
def quiet(*streams: int):
    """Send what native code prints nowhere: Blender reports every file that it reads and writes. `streams`: file
    descriptors, stdout by default."""
    streams = streams or (1,)
    _flush()
    kept, nowhere = [os.dup(stream) for stream in streams], os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in streams:
            os.dup2(nowhere, stream)
        yield
    finally:
        _flush()
        for stream, copy in zip(streams, kept, strict=True):
            os.dup2(copy, stream)
            os.close(copy)
        os.close(nowhere)


def _flush() -> None:
    """Write out what Python and the C library still hold back."""
    sys.stdout.flush()
    sys.stderr.flush()
    library = ctypes.cdll.ucrtbase if sys.platform == "win32" else ctypes.CDLL(None)
    library.fflush(None)
