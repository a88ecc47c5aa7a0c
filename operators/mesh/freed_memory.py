# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory of freed meshes, held by the process while meshes are written one after the other.

Blender frees a mesh's arrays and allocates the next one's, 80 MB for a million triangles. Its allocator gives what is
freed back to the system, which then has to clear and to map every page anew: writing a mesh takes 38 ms with glibc and
48 ms with jemalloc (what Blender's programs use on Linux before 5.1) where it takes 18 ms and 20 ms in pages that were
held. So both are told to hold what is freed, until soon after the last mesh or until a render begins. TBB's allocator,
which the programs have since 5.1, holds it by itself.
"""

import ctypes
import sys
import threading
import time
from functools import cache

import bpy

# Fewer triangles have less than 2,000 pages, a microsecond each.
LARGE = 100_000
IDLE_S = 5.0  # after the last mesh

# <malloc.h> of glibc. Its own thresholds grow to 32 MB and twice that; older ones take none that is larger.
_TRIM, _MMAP = -1, -3
_HELD, _MMAP_LIMIT, _TRIM_LIMIT = 1 << 30, 32 << 20, 64 << 20
_FOREVER_MS = -1

_lock = threading.Lock()  # a render gives back on a thread of its own
_decays: dict[bytes, int] = {}  # milliseconds that jemalloc's arenas had, while they hold
_glibc_holds = False
_last = 0.0


def hold() -> None:
    """Hold freed memory until `IDLE_S` after the last call; in Blender without a window, which has no timers, to its
    end. For the main thread."""
    global _last
    _last = time.monotonic()
    with _lock:
        holds = _hold_jemalloc() or _hold_glibc()
    if holds and not bpy.app.background and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=IDLE_S, persistent=True)


def give_back() -> None:
    """Give back what is held. jemalloc then does as before; glibc keeps the thresholds that its own grow to."""
    with _lock:
        for name, decay_ms in _decays.items():
            _set_decay(name, decay_ms)
        _decays.clear()
        _release_glibc()


def _tick() -> float | None:
    """A timer: seconds until it is to be called again, None for never."""
    left = _last + IDLE_S - time.monotonic()
    if left <= 0:
        give_back()
    return left if left > 0 else None


def unregister() -> None:
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    give_back()


@cache
def _function(name: str):
    """A function of this process's C libraries; None where there is none, and on other systems than Linux."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None


def _hold_jemalloc() -> bool:
    """Have every arena keep its dirty pages, also those that were made since the last call; False without jemalloc."""
    control, arenas = _function("mallctl"), ctypes.c_uint()
    size = ctypes.c_size_t(ctypes.sizeof(arenas))
    if control is None or control(b"arenas.narenas", ctypes.byref(arenas), ctypes.byref(size), None, ctypes.c_size_t()):
        return False
    for arena in range(arenas.value):
        name = b"arena.%d.dirty_decay_ms" % arena
        decay_ms = _set_decay(name, _FOREVER_MS)
        if decay_ms not in (None, _FOREVER_MS):
            _decays[name] = decay_ms
    return bool(_decays)


def _set_decay(name: bytes, decay_ms: int) -> int | None:
    """Set a decay time of jemalloc; returns what it was, None for an arena that no thread has used yet."""
    was, now = ctypes.c_ssize_t(), ctypes.c_ssize_t(decay_ms)
    size = ctypes.c_size_t(ctypes.sizeof(now))
    refused = _function("mallctl")(name, ctypes.byref(was), ctypes.byref(size), ctypes.byref(now), size)
    return None if refused else was.value


def _hold_glibc() -> bool:
    """Have all that is freed stay in the heap; False without glibc."""
    global _glibc_holds
    option = _function("mallopt")
    if option is None or _function("malloc_trim") is None:
        return False
    if not _glibc_holds:
        _glibc_holds = True
        if not option(_MMAP, _HELD):
            option(_MMAP, _MMAP_LIMIT)
        option(_TRIM, _HELD)
    return True


def _release_glibc() -> None:
    global _glibc_holds
    if _glibc_holds:
        _glibc_holds = False
        _function("mallopt")(_MMAP, _MMAP_LIMIT)
        _function("mallopt")(_TRIM, _TRIM_LIMIT)
        _function("malloc_trim")(ctypes.c_size_t(0))
