# SPDX-License-Identifier: GPL-3.0-or-later
"""A context in which our handlers do not run."""

from contextlib import contextmanager

_pauses = 0


@contextmanager
def handlers_paused():
    """Keep this extension's handlers from running in the `with` block; blocks may be nested.

    An exporter may change the frame while it reads meshes that a handler would write, and code that steps through
    frames updates terrains itself.
    """
    global _pauses
    _pauses += 1
    try:
        yield
    finally:
        _pauses -= 1


def is_paused() -> bool:
    """Return whether a `with handlers_paused()` block is active."""
    return _pauses > 0
