# SPDX-License-Identifier: GPL-3.0-or-later
"""Detection of a child process that hangs inside a library while it reads a file from outside."""

import time

from ..errors import TerrainError

STALL_SECONDS = 180.0


class Stall:
    """Time for which a polled process has sent no message."""

    def __init__(self) -> None:
        self._num_messages, self._silent_s, self._polled = -1, 0.0, time.monotonic()

    def is_over(self, num_messages: int) -> bool:
        """Return whether the process has been silent for too long. num_messages: all that it has sent so far.

        Between two calls at most one second counts: for longer, this process may have been suspended.
        """
        now = time.monotonic()
        is_silent = num_messages == self._num_messages
        self._silent_s = self._silent_s + min(now - self._polled, 1.0) if is_silent else 0.0
        self._num_messages, self._polled = num_messages, now
        return self._silent_s > STALL_SECONDS


def stall_error(source: str) -> TerrainError:
    """Return the error about a process that was stopped while it read `source`."""
    return TerrainError(
        f"Reading {source} made no progress for {STALL_SECONDS:g} s and was stopped",
        expected="a file that is whole and quick to unpack",
        fix="write it again as a plain GeoTIFF",
    )
