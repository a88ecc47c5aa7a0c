# SPDX-License-Identifier: GPL-3.0-or-later
"""Keep the memory of freed meshes in the process while new meshes are written.

Blender frees a mesh's arrays and allocates those of the next one, 80 MB for a million triangles. Its allocator returns
freed memory to the system, which then clears and maps every page again. Writing a mesh takes 38 ms with glibc and 48 ms
with jemalloc (in Blender's Linux programs before 5.1), but 18 ms and 20 ms in retained pages. So both allocators retain
freed memory until shortly after the last mesh or until a render starts. TBB's allocator, in programs since 5.1, does so
by default.
"""

import ctypes
import sys
import threading
import time
from functools import cache

import bpy

LARGE = 100_000  # triangles; fewer need less than 2,000 pages of a microsecond each
IDLE_S = 5.0  # after the last mesh

# Options of `mallopt`, M_TRIM_THRESHOLD and M_MMAP_THRESHOLD, and their values while memory is held and afterwards:
# glibc's default thresholds grow to 32 MB and 64 MB, and older versions accept no larger ones.
_TRIM, _MMAP = -1, -3
_HELD, _MMAP_LIMIT, _TRIM_LIMIT = 1 << 30, 32 << 20, 64 << 20
_FOREVER_MS = -1

_lock = threading.Lock()  # a render calls `give_back` on another thread
_decays: dict[bytes, int] = {}  # original decay times of jemalloc's arenas in milliseconds, while they hold memory
_glibc_holds = False
_last = 0.0  # monotonic seconds of the last call of `hold_freed_memory`


def hold_freed_memory() -> None:
    """Keep freed memory in the process until IDLE_S seconds after the last call; without a window until it ends.

    Call it on the main thread, before a large mesh is written.
    """
    global _last
    _last = time.monotonic()
    with _lock:
        holds = _hold_jemalloc() or _hold_glibc()
    if holds and not bpy.app.background and not bpy.app.timers.is_registered(_give_back_when_idle):
        bpy.app.timers.register(_give_back_when_idle, first_interval=IDLE_S, persistent=True)


def give_back() -> None:
    """Return held memory to the system, if any. jemalloc gets its old settings.

    The thresholds of glibc, which cannot be read, become the largest that it chooses itself.
    """
    with _lock:
        for name, decay_ms in _decays.items():
            _set_decay(name, decay_ms)
        _decays.clear()
        _release_glibc()


def _give_back_when_idle() -> float | None:
    """Give back memory that was held long enough; return the seconds until the next call, None to stop the timer."""
    left = _last + IDLE_S - time.monotonic()
    if left <= 0:
        give_back()
    return left if left > 0 else None


def unregister() -> None:
    """Stop the timer and return freed memory to the system at once."""
    if bpy.app.timers.is_registered(_give_back_when_idle):
        bpy.app.timers.unregister(_give_back_when_idle)
    give_back()


@cache
def _c_function(name: str):
    """Return a function of this process's C libraries, None if there is none or the system is not Linux."""
    return getattr(ctypes.CDLL(None), name, None) if sys.platform == "linux" else None


def _hold_jemalloc() -> bool:
    """Make jemalloc keep freed pages, in every arena; return whether an arena has an old time to restore.

    There is none if the process has another allocator, or if jemalloc keeps its pages anyway.
    """
    control, arenas = _c_function("mallctl"), ctypes.c_uint()
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
    """Set how long a jemalloc arena keeps freed pages; return the old time, None for an arena that no thread has used.

    name: setting of the arena. decay_ms: milliseconds, -1 for ever.
    """
    was, now = ctypes.c_ssize_t(), ctypes.c_ssize_t(decay_ms)
    size = ctypes.c_size_t(ctypes.sizeof(now))
    refused = _c_function("mallctl")(name, ctypes.byref(was), ctypes.byref(size), ctypes.byref(now), size)
    return None if refused else was.value


def _hold_glibc() -> bool:
    """Make glibc keep all freed memory in the heap; return False if the process has no glibc."""
    global _glibc_holds
    option = _c_function("mallopt")
    if option is None or _c_function("malloc_trim") is None:
        return False
    if not _glibc_holds:
        _glibc_holds = True
        if not option(_MMAP, _HELD):  # an older version refuses more than its limit
            option(_MMAP, _MMAP_LIMIT)
        option(_TRIM, _HELD)
    return True


def _release_glibc() -> None:
    """Set glibc's thresholds back and return its free memory to the system."""
    global _glibc_holds
    if _glibc_holds:
        _glibc_holds = False
        _c_function("mallopt")(_MMAP, _MMAP_LIMIT)
        _c_function("mallopt")(_TRIM, _TRIM_LIMIT)
        _c_function("malloc_trim")(ctypes.c_size_t(0))
