# SPDX-License-Identifier: GPL-3.0-or-later
"""Finer land where one looks: while nothing changes, what a preview leaves out is made in a child process.

As a viewport's picture gets better while it rests, so does the land of a terrain with Live Update: only the tiles that
its views need, at a low priority. Other settings of the land end it at once; another view gets its own tiles when it
rests in its turn. What *Shape Now* and renders make of it later begins with these tiles.
"""

import time
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.land import derived_store, requested_tiles
from ...cbt_terrain.land.derived_store import Land
from ...cbt_terrain.land.land_folder import is_of_views
from ...cbt_terrain.land.shape_process import ShapeJob
from ..request.land_request import land_of
from ..request.request import Request
from ..scene import session
from ..scene.land_jobs import Work, running

REST_S = 2.0  # without a change, after which it begins
LOOK_S = 0.5  # between looks at the terrains for one that rests: a scene may have many objects
CHOOSING = "Choosing tiles"


@dataclass
class _Rest:
    """A terrain that rests: with which request, since when. `done`: nothing is left to make."""

    key: tuple
    since: float
    done: bool = False


@dataclass
class _Making:
    """What is being made of a terrain, as its request `key` had it. `begun` gives the job and its tiles, or None where
    all tiles are there."""

    uid: int
    key: tuple
    land: Land
    work: Work
    begun: Future
    wanted: requested_tiles.Tiles | None = None


_rests: dict[int, _Rest] = {}
_looked = 0.0  # when the terrains were last looked at
_making: _Making | None = None
_left: set[str] = set()  # land that the user has stopped, or that failed: not begun again
_chooser: ThreadPoolExecutor | None = None  # tiles are chosen by all heights: too long for the main thread


def concerned() -> bool:
    """Whether `turn` has anything to do: the terrains of many scenes have no land."""
    global _looked
    if _making is not None:
        return True
    if time.monotonic() - _looked < LOOK_S or not any(_may_be_finer(*known) for known in session.records()):
        return False
    _looked = time.monotonic()
    return True


def _may_be_finer(uid: int, record: session.Record) -> bool:
    request, rest = record.status.request, _rests.get(uid)
    if request is None or record.live_key is None or rest is not None and rest.done and rest.key == record.live_key:
        return False
    return request.land is not None or is_of_views(request.store)


def turn(shown: Iterable[tuple], idle: bool) -> bool:
    """Look after what is being made, and begin where there is something to; returns whether meshes are to be updated.

    shown: dependency graph and object of every terrain in a window. idle: nothing else is under way.
    """
    global _making
    terrains = {obj.session_uid: (depsgraph, obj) for depsgraph, obj in shown}
    if _making is not None:
        return _look_after(terrains.get(_making.uid))
    for uid, (depsgraph, obj) in terrains.items() if idle else ():
        if uid not in running and _rests_long(obj) and (land := _land(obj, depsgraph)) is not None:
            work = running[uid] = Work(message=CHOOSING)
            _making = _Making(uid, _rests[uid].key, land, work, _pool().submit(_begin, land))
            break
    return False


def stop() -> None:
    """End what is being made: another file is opened, or the extension goes."""
    global _making
    if _making is not None:
        _end(_making)
    _rests.clear()
    _left.clear()


def _pool() -> ThreadPoolExecutor:
    global _chooser
    if _chooser is None:
        _chooser = ThreadPoolExecutor(max_workers=1, thread_name_prefix="adaptive_terrain_land")
    return _chooser


def _rests_long(obj) -> bool:
    """Whether what the terrain shows is that of some time ago, and may be made better."""
    record, settings = session.record_of(obj), obj.adaptive_terrain
    if not settings.live or settings.frozen or record.status.error or not _may_be_finer(obj.session_uid, record):
        return False
    rest = _rests.get(obj.session_uid)
    if rest is None or rest.key != record.live_key:
        _rests[obj.session_uid] = rest = _Rest(record.live_key, time.monotonic())
    return not rest.done and time.monotonic() - rest.since >= REST_S


def _land(obj, depsgraph) -> Land | None:
    """What is to be made for the views that the terrain was last refined for; None where there is nothing to."""
    request = session.record_of(obj).status.request
    land = _of_settings(obj, depsgraph)
    if land is None or land.is_shaped and not land.of_views or land.of_views_alone.folder in _left:
        _rests[obj.session_uid].done = True
        return None
    return replace(land.of_views_alone, seen=_seen(request))


def _of_settings(obj, depsgraph) -> Land | None:
    try:
        return land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=False)
    except TerrainError:
        return None  # the update says why


def _seen(request: Request) -> requested_tiles.SeenTiles:
    scale = request.vertical_scale, request.vertical_offset
    return requested_tiles.SeenTiles(
        tuple(request.views), np.array(request.placement), request.criterion.error_px, *scale
    )


def _begin(land: Land) -> tuple[ShapeJob, requested_tiles.Tiles] | None:
    """For a thread of its own."""
    wanted = derived_store.wanted_tiles(land, session.open_field)
    if derived_store.is_whole(land, session.open_field) and requested_tiles.has(land.folder, wanted):
        return None
    return derived_store.begin_shaping(land, session.open_field, gentle=True)


def _look_after(terrain: tuple | None) -> bool:
    making = _making
    if terrain is None or not terrain[1].adaptive_terrain.live or making.work.stopped or _is_other(terrain):
        if making.work.stopped:
            _left.add(making.land.folder)
        _end(making)
        return False
    try:
        return _poll(making)
    except TerrainError as error:
        _end(making)
        _left.add(making.land.folder)
        session.record_of(terrain[1]).status.error = str(error)
        return False


def _is_other(terrain: tuple) -> bool:
    """Whether the terrain's settings ask for another land by now."""
    key = session.record_of(terrain[1]).live_key
    if key == _making.key:
        return False
    _making.key, land = key, _of_settings(terrain[1], terrain[0])
    return land is None or land.of_views_alone.folder != _making.land.folder


def _poll(making: _Making) -> bool:
    """Whether the store is there now."""
    if not making.begun.done():
        return False
    if making.work.job is None:
        begun = making.begun.result()
        if begun is None:
            _rests[making.uid].done = True
            _end(making)
            return False
        making.work.job, making.wanted = begun
    progress = making.work.poll()
    if not progress.done:
        return False
    if progress.error:
        raise progress.error
    derived_store.finish(making.land, making.wanted)
    _end(making)
    return True


def _end(making: _Making) -> None:
    """A job that has just begun is stopped, too."""
    global _making
    running.pop(making.uid, None)
    _making = None
    making.work.stop()
    if making.work.job is None:
        making.begun.add_done_callback(_stop_late)


def _stop_late(begun: Future) -> None:
    if not begun.cancelled() and begun.exception() is None and begun.result() is not None:
        begun.result()[0].cancel()
