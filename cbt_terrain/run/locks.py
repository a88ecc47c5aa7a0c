# SPDX-License-Identifier: GPL-3.0-or-later
"""Locks for state that several threads share, and their state in a forked child process.

A forked child has only the forking thread. A lock that another thread of the parent held would stay locked for ever,
and the state that it protected may be inconsistent.
"""

import os
import threading
from collections.abc import Callable, Hashable, MutableMapping
from typing import Any, TypeVar
from weakref import WeakSet

Value = TypeVar("Value")


class SharedLock:
    """A reentrant lock that no thread holds in a forked child.

    `broken`: another thread held it at the fork, so its owner must rebuild its state, and then set this to False.
    """

    def __init__(self) -> None:
        self.broken = False
        self._lock = threading.RLock()
        _locks.add(self)

    def __enter__(self) -> "SharedLock":
        self._lock.acquire()
        return self

    def __exit__(self, *_error: object) -> None:
        self._lock.release()

    def free(self) -> None:
        """Free the lock in a forked child, unless the thread that forked holds it.

        A lock that another thread held is replaced, and marked as broken.
        """
        if self._lock.acquire(blocking=False):
            self._lock.release()
        else:
            self._lock, self.broken = threading.RLock(), True


_locks: WeakSet[SharedLock] = WeakSet()
# One lock for everything that is computed once and cached, so that no two threads wait for each other.
caching = SharedLock()


def cached(cache: MutableMapping[Any, Any], key: Hashable, make: Callable[[], Value]) -> Value:
    """Return `cache[key]`. If it is missing, compute it with `make` on this thread.

    Other threads that need any missing value wait meanwhile. If `make` raises, nothing is cached.
    """
    try:
        return cache[key]
    except KeyError:
        pass
    with caching:
        if key not in cache:
            cache[key] = make()
        return cache[key]


def in_forked_child(reset: Callable[[], None]) -> None:
    """Call `reset` in every child process that is forked from this one."""
    if hasattr(os, "register_at_fork"):
        os.register_at_fork(after_in_child=reset)


def _free_all() -> None:
    """Free all locks, in a forked child: their owners are threads that it lacks."""
    for lock in list(_locks):
        lock.free()


in_forked_child(_free_all)
