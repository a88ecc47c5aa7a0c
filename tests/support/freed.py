# SPDX-License-Identifier: GPL-3.0-or-later
"""What an allocator makes of memory that is freed: page faults of large arrays that come and go.

Imported by a test of the bpy module and, as a script, by the real Blender program, which has another allocator.
"""

import resource

import numpy as np

# Larger than what glibc keeps in its heap by itself, where it may happen to stay.
ARRAYS, BYTES, PAGE = 3, 40 << 20, 4096


def faults() -> int:
    """Page faults while arrays are allocated, touched and freed, when as many were freed just before: the fewest of
    some times, because other threads of the process have faults too."""
    found = []
    for _ in range(5):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        _touch_arrays()
        found.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
    return min(found[1:])


def _touch_arrays() -> None:
    for array in [np.empty(BYTES, np.uint8) for _ in range(ARRAYS)]:
        array[::PAGE] = 1


def measured(memory) -> dict[str, int]:
    """Count page faults before `memory` (freed_memory.py) holds memory, meanwhile, after, and when held again."""
    found = {"before": faults()}
    memory.hold_freed_memory()
    found["held"] = faults()
    memory.give_back()
    found["after"] = faults()
    memory.hold_freed_memory()
    found["again"] = faults()
    memory.give_back()
    return found
