# SPDX-License-Identifier: GPL-3.0-or-later
"""A while in which no handler of ours runs."""

from contextlib import contextmanager

_pauses = 0


@contextmanager
def paused():
    """No handler of ours runs inside: an exporter may change the frame while it reads meshes that a handler would
    write, and what goes through frames for itself updates each terrain itself. May be nested."""
    global _pauses
    _pauses += 1
    try:
        yield
    finally:
        _pauses -= 1


def paused_now() -> bool:
    return _pauses > 0
