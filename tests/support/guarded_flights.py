# SPDX-License-Identifier: GPL-3.0-or-later
"""Flights in which every buffer of the engine ends where a page begins that may not be touched.

A separate process, which a read or a write beyond an array ends; tests/cbt_terrain/run/test_buffer_ends.py runs it.
"""

import ctypes
import faulthandler
import mmap
from types import SimpleNamespace

import numpy as np
from adaptive_terrain.cbt_terrain.run import buffers, launch
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View
from fields import rough
from invariants import arrays
from level_ground import level_scenes

PROT_NONE = 0
CRITERIA = (
    Criterion(error_px=0.3, max_depth=18),
    Criterion(error_px=0.0, edge_px=6.0),
    Criterion(error_px=0.1, max_triangles=3000),
    Criterion(error_px=1.0, meshlet=2),
)
mprotect = ctypes.CDLL(None).mprotect
mprotect.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]


def guarded(shape, dtype) -> np.ndarray:
    """Return an uninitialised array, as `np.empty` does, with an inaccessible page behind it."""
    nbytes = int(np.prod(shape)) * np.dtype(dtype).itemsize
    page = mmap.PAGESIZE
    pages = -(-nbytes // page) * page
    memory = np.frombuffer(mmap.mmap(-1, pages + page), np.uint8)
    assert mprotect(memory.ctypes.data + pages, page, PROT_NONE) == 0
    array = memory[pages - nbytes : pages]
    array[:] = 0xA5
    return array.view(dtype).reshape(shape)


def guarded_numpy() -> SimpleNamespace:
    """Return numpy with guarded arrays where it makes new ones."""
    return SimpleNamespace(
        **vars(np) | {"empty": guarded, "empty_like": lambda array: guarded(array.shape, array.dtype)}
    )


def fly(field, flights, threads: int) -> None:
    """Update a terrain for each view; check that each mesh is the one of a new terrain with one thread."""
    terrain = Terrain(field, threads)
    terrain.history.hints.capacity = 7
    for criterion, views in flights:
        found = terrain.update(criterion, views).surface
        assert arrays(found) == arrays(Terrain(field, 1).update(criterion, views).surface)


def main() -> None:
    faulthandler.enable()
    buffers.np = guarded_numpy()
    launch.SLICE_ITEMS = 2
    for shape in ((65, 65), (33, 97)):  # one square; three, and a spare one
        field = rough(*shape, relief=20.0)
        views = [[View.look((0.05 * frame, -300.0 + 0.1 * frame, 120.0), (0, 0, 0))] for frame in range(2)]
        for threads in (1, 7):
            fly(field, [(criterion, view) for criterion in CRITERIA for view in views], threads)
    for k, (field, criterion, views, _scale) in enumerate(level_scenes()[::2]):
        fly(field, 2 * [(criterion, views)], 1 + k % 3)


if __name__ == "__main__":
    main()
    print("no page behind an array was touched")
