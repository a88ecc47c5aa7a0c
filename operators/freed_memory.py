# SPDX-License-Identifier: GPL-3.0-or-later
"""Memory of freed meshes, held by the process while meshes are written one after the other.

Blender frees a mesh's arrays and allocates the next one's, 80 MB for a million triangles. Its allocator gives what is
freed back to the system, which then has to clear and to map every page anew: writing a mesh takes 38 ms with glibc and
48 ms with jemalloc (what Blender's programs use on Linux) where it takes 18 ms and 20 ms in pages that were held. So
both are told to hold what is freed, and to go on as before soon after the last mesh, or when a render begins.
"""

import ctypes
import sys
import time
from collections.abc import Callable
from functools import cache

import bpy

# Fewer triangles lie in arrays that allocators hold by themselves.
LARGE = 100_000
IDLE_S = 5.0  # after the last mesh

# <malloc.h>: of glibc. Beyond 32 MB and twice that its own thresholds do not grow.
_TRIM, _MMAP = -1, -3
_HELD, _MMAP_LIMIT, _TRIM_LIMIT = 1 << 30, 32 << 20, 64 << 20
_FOREVER_MS = -1

_let_go: Callable[[], None] | None = None  # while memory is held
_last = 0.0


def hold() -> None:
    """Hold freed memory until `IDLE_S` after the last call; without a window, where no timer runs, to the end."""
    global _let_go, _last
    _last = time.monotonic()
    if _let_go is None:
        _let_go = _hold_jemalloc() or _hold_glibc()
        if _let_go is not None and not bpy.app.background:
            bpy.app.timers.register(_tick, first_interval=IDLE_S, persistent=True)


def let_go() -> None:
    """Give back what is held, and let the allocator do as before."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _give_back()


def _give_back() -> None:
    global _let_go
    if _let_go is not None:
        _let_go()
    _let_go = None


def _tick() -> float | None:
    """A timer: seconds until it is to be called again, None for never."""
    left = _last + IDLE_S - time.monotonic()
    if left <= 0:
        _give_back()
    return left if left > 0 else None


@cache
def _program() -> ctypes.CDLL | None:
    """What is linked into this process; nowhere but on Linux is one of the two allocators found."""
    return ctypes.CDLL(None) if sys.platform == "linux" else None


def _hold_jemalloc() -> Callable[[], None] | None:
    """Have every arena keep its dirty pages; returns what undoes it, None without jemalloc."""
    control = getattr(_program(), "mallctl", None)
    if control is None:
        return None
    sizes, arenas = ctypes.c_size_t, ctypes.c_uint()
    control.argtypes = ctypes.c_char_p, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p, sizes
    if control(b"arenas.narenas", ctypes.byref(arenas), ctypes.byref(sizes(ctypes.sizeof(arenas))), None, 0):
        return None
    before: dict[bytes, ctypes.c_ssize_t] = {}
    forever = ctypes.c_ssize_t(_FOREVER_MS)
    size = ctypes.sizeof(forever)
    for arena in range(arenas.value):  # one that no thread has used yet refuses
        name, was = b"arena.%d.dirty_decay_ms" % arena, ctypes.c_ssize_t()
        if not control(name, ctypes.byref(was), ctypes.byref(sizes(size)), ctypes.byref(forever), size):
            before[name] = was

    def undo() -> None:
        for name, was in before.items():
            control(name, None, None, ctypes.byref(was), size)

    return undo


def _hold_glibc() -> Callable[[], None] | None:
    """Have all that is freed stay in the heap; returns what undoes it, None without glibc."""
    option, trim = getattr(_program(), "mallopt", None), getattr(_program(), "malloc_trim", None)
    if option is None or trim is None:
        return None
    option(_MMAP, _HELD)
    option(_TRIM, _HELD)

    def undo() -> None:
        option(_MMAP, _MMAP_LIMIT)
        option(_TRIM, _TRIM_LIMIT)
        trim(ctypes.c_size_t(0))

    return undo
