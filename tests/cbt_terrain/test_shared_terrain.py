# SPDX-License-Identifier: GPL-3.0-or-later
"""One terrain in several threads, in forked processes, and with results that are used after later updates."""

import hashlib
import os
import pickle
import subprocess
import sys
import textwrap
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain import terrain as terrains
from adaptive_terrain.cbt_terrain.errors import TerrainError
from adaptive_terrain.cbt_terrain.field.bicubic import interpolated
from adaptive_terrain.cbt_terrain.field.build import from_array
from adaptive_terrain.cbt_terrain.history.frame_history import FrameHistory
from adaptive_terrain.cbt_terrain.query.ground import ground_at
from adaptive_terrain.cbt_terrain.run import launch
from adaptive_terrain.cbt_terrain.scatter.points import ScatterRequest, place_points, scatter_points
from adaptive_terrain.cbt_terrain.scatter.scatter import Scatter
from adaptive_terrain.cbt_terrain.terrain import Terrain
from adaptive_terrain.cbt_terrain.view.criterion import Criterion
from adaptive_terrain.cbt_terrain.view.view import View

VIEWS = [View.look((40.0 * k - 200.0, -500.0, 250.0), (0, 0, 0), resolution=(640, 360)) for k in range(8)]
FINE = Criterion(error_px=0.5)


def hills(holes: bool = False, size: tuple[int, int] = (81, 150)):
    """Return a field that does not fill its squares, with holes or without."""
    heights = np.random.default_rng(5).normal(0, 6, size).astype(np.float32).cumsum(0).cumsum(1) * np.float32(0.1)
    if holes:
        heights[20:30, 40:55] = np.nan
    return from_array(heights, 10.0, holes=holes)


def digest(surface) -> str:
    return hashlib.sha1(b"".join(array.tobytes() for array in surface.arrays().values())).hexdigest()


def test_threads_share_one_terrain(monkeypatch):
    monkeypatch.setattr(launch, "SLICE_ITEMS", 64)
    field = hills()
    expected = [digest(Terrain(field, 2).update(FINE, [view]).surface) for view in VIEWS]
    terrain = Terrain(field, 2)
    with ThreadPoolExecutor(8) as pool:
        # Digests are taken outside of the lock, while other threads update.
        found = list(pool.map(lambda k: digest(terrain.update(FINE, [VIEWS[k % 8]]).surface), range(24)))
    assert found == expected * 3 and len(set(expected)) == 8


def test_threads_ask_one_terrain_for_triangles():
    terrain, places = Terrain(hills(), 1), np.random.default_rng(1).uniform(-300, 300, (500, 2))

    def corners(k: int) -> bool:
        terrain.update(FINE, [VIEWS[k % 8]])
        found = terrain.triangles_at(places)
        return bool((found >= -1).all()) and len(terrain.saved()[0]) > 100

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(corners, range(24)))


def test_threads_share_one_field():
    """What a field caches is made once, and every thread sees it whole."""
    field, places = hills(), np.random.default_rng(2).uniform(-300, 300, (1000, 2))
    expected = ground_at(interpolated(hills(), "bicubic"), places).heights
    meshlets = Terrain(hills(), 1).update(Criterion(error_m=1.0, error_px=0, meshlet=1)).surface.positions

    def ask(_):
        heights = ground_at(interpolated(field, "bicubic"), places).heights
        update = Terrain(field, 1).update(Criterion(error_m=1.0, error_px=0, meshlet=1))
        return interpolated(field, "bicubic"), heights, update.surface.positions

    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(ask, range(16)))
    assert len({id(surface) for surface, _, _ in found}) == 1
    assert all(np.array_equal(heights, expected, equal_nan=True) for _, heights, _ in found)
    assert all(np.array_equal(positions, meshlets) for _, _, positions in found)


def test_threads_share_one_scatter():
    field, scatter = hills(), Scatter(spacing=8.0, full_until=100.0)
    history = FrameHistory()

    def ids(k: int) -> list[int]:
        return place_points(field, ScatterRequest(scatter, [VIEWS[k % 8]]), history, 1).id.tolist()

    expected = [scatter_points(field, scatter, [view], threads=1).id.tolist() for view in VIEWS]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(ids, range(24)))
    assert found == expected * 3


@pytest.mark.parametrize(
    ("meshlet", "holes"),
    [(0, True), (1, False), *(pytest.param(*case, marks=pytest.mark.thorough) for case in ((0, False), (1, True)))],
)
def test_later_updates_keep_earlier_surfaces(meshlet, holes, monkeypatch):
    """Also those of which a caller has one array only, and with meshes whose points are copied from the last frame."""
    monkeypatch.setattr(launch, "SLICE_ITEMS", 64)
    field = hills(holes)
    criterion, terrain = Criterion(error_px=0.5, meshlet=meshlet), Terrain(field, 2)
    flight = [View.look((x, -500.0, 250.0), (x, 0, 0), resolution=(640, 360)) for x in np.linspace(-20, 20, 4)]
    kept = [terrain.update(criterion, [view]).surface for view in flight]
    normals = [surface.normals[:-1] for surface in kept]
    expected = [Terrain(field, 2).update(criterion, [view]).surface for view in flight]
    assert [digest(surface) for surface in kept] == [digest(surface) for surface in expected]
    assert len({digest(surface) for surface in expected}) == 4
    kept.clear()  # one view of one array of each surface is still in use
    for view in flight:
        terrain.update(criterion, [view])
    assert all(np.array_equal(a, b.normals[:-1]) for a, b in zip(normals, expected, strict=True))


def test_arrays_of_an_update_cannot_be_written():
    update = Terrain(hills(), 1).update(FINE, VIEWS[:1])
    for array in update.surface.arrays().values():
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
        with pytest.raises(ValueError, match="WRITEABLE"):
            array.flags.writeable = True
    copied = update.copy()
    assert digest(copied.surface) == digest(update.surface) and copied != update
    copied.surface.positions[:] = 0.0
    assert update.surface.positions.any() and copied.bound_px == update.bound_px


def test_memory_of_unused_surfaces_is_reused():
    terrain, kept = Terrain(hills(), 1), []
    for k in range(24):
        kept = [*kept, terrain.update(FINE, [VIEWS[k % 8]]).surface][-3:]
    held = terrain.buffer_bytes
    for k in range(24):
        kept = [*kept, terrain.update(FINE, [VIEWS[k % 8]]).surface][-3:]
    assert terrain.buffer_bytes <= 1.1 * held
    kept.clear()
    for k in range(4):
        terrain.update(FINE, [VIEWS[k % 8]])
    assert terrain.buffer_bytes < held


FORKS = """
    import multiprocessing, os, signal, sys, threading, time
    from adaptive_terrain.cbt_terrain.run import launch
    launch.SLICE_ITEMS = 64  # the pool of threads is used by small meshes, too
    from tests.cbt_terrain.test_shared_terrain import FINE, VIEWS, Terrain, digest, ground_at, hills

    def work(k):
        return digest(Terrain(FIELD, 2).update(FINE, [VIEWS[k]]).surface)

    FIELD = hills()
    SHARED = Terrain(FIELD, 2)
"""
POOL = """
    expected = [work(k) for k in range(4)]
    ground_at(FIELD, [(0.0, 0.0)])
    with multiprocessing.get_context("fork").Pool(2) as pool:
        assert pool.map_async(work, range(4)).get(timeout=300) == expected
"""
# One thread of the parent updates all the time: most forks come while it holds the lock and is inside of a build.
BUSY = """
    expected = [work(k) for k in range(4)]

    def update():
        while not done:
            for view in VIEWS:
                SHARED.update(FINE, [view])

    done, busy = [], 0
    thread = threading.Thread(target=update)
    thread.start()
    for n in range(8):
        time.sleep(0.005)
        child = os.fork()
        if not child:
            signal.alarm(120)
            status = 2 if SHARED.history._lock.broken else 0
            right = [digest(SHARED.update(FINE, [VIEWS[k]]).surface) for k in range(4)] == expected
            right = right and work(1) == expected[1]
            os._exit(status if right else 1)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        assert code in (0, 2), code
        busy += code == 2
    done.append(True)
    thread.join()
    assert busy >= 2, busy
"""


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.parametrize("script", [POOL, BUSY], ids=["after", "during"])
def test_forked_processes_go_on_after_an_update(script):
    code = textwrap.dedent(FORKS + script)
    root = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=root, timeout=600)
    assert result.returncode == 0, result.stderr


def test_a_pickled_field_gives_the_same_mesh():
    """As multiprocessing sends it to a new process, with the methods spawn and forkserver."""
    field = hills(holes=True)
    expected = digest(Terrain(field, 2).update(FINE, VIEWS[:1]).surface)
    assert digest(Terrain(pickle.loads(pickle.dumps(field)), 1).update(FINE, VIEWS[:1]).surface) == expected


def test_a_call_inside_an_update_is_refused(monkeypatch):
    """As from a signal handler, on the same thread; the terrain works on afterwards."""
    terrain = Terrain(hills(), 1)
    build = terrains.build_surface

    def build_and_call(*arguments):
        with pytest.raises(TerrainError, match="is being updated on this thread"):
            terrain.update(FINE, VIEWS[1:2])
        return build(*arguments)

    monkeypatch.setattr(terrains, "build_surface", build_and_call)
    found = terrain.update(FINE, VIEWS[:1]).surface
    monkeypatch.undo()
    assert digest(found) == digest(Terrain(hills(), 1).update(FINE, VIEWS[:1]).surface)
    assert terrain.update(FINE, VIEWS[1:2]).changed
