# SPDX-License-Identifier: GPL-3.0-or-later
"""A child process that opens a file from outside may hang inside a library; its parent notices that it is silent."""

import time

STALL_SECONDS = 180.0


class Stall:
    """How long a process that is asked about again and again has said nothing new."""

    def __init__(self):
        self._news, self._silent_s, self._asked = -1, 0.0, time.monotonic()

    def is_over(self, news: int) -> bool:
        """Whether it has been silent for too long; `news` counts what it has said. Between two calls a second counts at
        most: for longer it may have been this process that stood still."""
        now = time.monotonic()
        self._silent_s = self._silent_s + min(now - self._asked, 1.0) if news == self._news else 0.0
        self._news, self._asked = news, now
        return self._silent_s > STALL_SECONDS


def stalled_text(source: str) -> str:
    """What the user is told of it."""
    return (
        f"Reading {source} made no progress for {STALL_SECONDS:g} s and was stopped: the file is damaged, or packed so "
        "that it takes too long; write it again as a plain GeoTIFF."
    )
