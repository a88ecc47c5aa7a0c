# SPDX-License-Identifier: GPL-3.0-or-later
"""Finer land in view while nothing changes: a child process makes the tiles that a preview leaves out.

A terrain rests while its `live_key`, the key of the last request of the live update (settings and views), stays the
same. Once it has rested for REST_S, its land is refined at a low priority, only in the tiles that its views need, or
everywhere if that costs less. A change of the land's settings ends the job. A moved view does not: the terrain rests
anew, and the tiles of that view are made after the job. *Shape Now* and renders reuse the result.
"""

import time
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.height_operators import derived_store, requested_tiles, shaping_cost
from ...cbt_terrain.height_operators.derived_store import Land
from ...cbt_terrain.height_operators.land_folder import is_of_views
from ...cbt_terrain.height_operators.shape_process import ShapeJob
from .. import jobs
from ..bridge.evaluated import about_middle
from ..session import session
from ..terrain.request import Request
from .properties import SEEN
from .request import land_of

REST_S = 2.0  # without a change before it begins
LOOK_S = 0.5  # between looks at the terrains for one that rests: a scene may have many objects
CHOOSING = "Choosing tiles"


@dataclass
class _Rest:
    """A terrain that rests with the request `key` since a time in monotonic seconds. `done`: no tile is missing."""

    key: tuple
    since: float
    done: bool = False


@dataclass
class _Making:
    """The land that is shaped for a terrain (`uid`) with the request `key`. `begun`: future of `_create_job`."""

    uid: int
    key: tuple
    land: Land
    job: jobs.BackgroundJob
    begun: Future


_rests: dict[int, _Rest] = {}
_looked = 0.0  # when the terrains were last looked at
_making: _Making | None = None
_refused: set[str] = set()  # folders of land that the user has stopped, or that failed: not begun again
_chooser: ThreadPoolExecutor | None = None  # tiles are chosen by all heights: too long for the main thread


def has_work() -> bool:
    """Return whether `turn` may have work; quick, so that the timer may ask at each tick.

    Without a running job it is True once in LOOK_S seconds at most.
    """
    global _looked
    if _making is not None:
        return True
    if time.monotonic() - _looked < LOOK_S or not any(_may_be_finer(*known) for known in session.records()):
        return False
    _looked = time.monotonic()
    return True


def _may_be_finer(uid: int, record: session.Record) -> bool:
    """Return whether a terrain's land could be shaped more finely than at its last update.

    Land of a stack could, and a store that is fine only where earlier views looked. It cannot if the terrain had no
    live update yet, or if a job for the same request has found no missing tile.
    """
    request, rest = record.status.request, _rests.get(uid)
    if request is None or record.live_key is None or rest is not None and rest.done and rest.key == record.live_key:
        return False
    return request.land is not None or is_of_views(request.store)


def turn(shown: Iterable[tuple], idle: bool) -> bool:
    """Advance the running job, or start one for a terrain that rests; return whether meshes have to be updated.

    shown: (dependency graph, object) of every terrain in a window. idle: no update is due or running.
    """
    global _making
    terrains = {obj.session_uid: (depsgraph, obj) for depsgraph, obj in shown}
    if _making is not None:
        return _advance_job(terrains.get(_making.uid))
    for uid, (depsgraph, obj) in terrains.items() if idle else ():
        if (
            jobs.find(jobs.SHAPE, obj) is None
            and _has_rested(obj)
            and (land := _land_to_make(obj, depsgraph)) is not None
        ):
            tiles_alone = obj.adaptive_terrain.land.where == SEEN  # renders use land that is fine only in view
            # Choosing the tiles reads all heights, too long for the main thread; the steps wait for this future.
            begun = _start_thread().submit(_create_job, land, tiles_alone)
            job = jobs.BackgroundJob(jobs.SHAPE, uid, lambda job, begun=begun: _shape_in_steps(job, begun))
            job.message = CHOOSING
            _making = _Making(uid, _rests[uid].key, land, job, begun)
            break
    return False


def give_way() -> None:
    """End the job, because a render or Shape Now needs the same land at once."""
    if _making is not None:
        _end_job(_making)


def stop() -> None:
    """Stop the running job and forget all terrains, because another file is opened or the extension is disabled."""
    give_way()
    _rests.clear()
    _refused.clear()


def _start_thread() -> ThreadPoolExecutor:
    """Return the thread on which tiles are chosen; it is started at the first call."""
    global _chooser
    if _chooser is None:
        _chooser = ThreadPoolExecutor(max_workers=1, thread_name_prefix="adaptive_terrain_land")
    return _chooser


def _has_rested(obj) -> bool:
    """Return whether a live terrain has shown the same for REST_S seconds, and its land may get finer.

    The first call for a request starts its time.
    """
    record, settings = session.record_of(obj), obj.adaptive_terrain
    if not settings.live or settings.frozen or record.status.error or not _may_be_finer(obj.session_uid, record):
        return False
    rest = _rests.get(obj.session_uid)
    if rest is None or rest.key != record.live_key:
        _rests[obj.session_uid] = rest = _Rest(record.live_key, time.monotonic())
    return not rest.done and time.monotonic() - rest.since >= REST_S


def _land_to_make(obj, depsgraph) -> Land | None:
    """Return the land to shape for the views of the last update; None if there is nothing to make.

    That is so without land, if all of it exists, or if it is in `_refused`: the user stopped it, or it failed. The
    terrain is then left alone until its request changes (`done`). Land that is fine only in view (`of_views`) may lack
    tiles after it was shaped; `of_views_alone` is the same land in that form, stored in another folder. The result has
    that form, and `_create_job` may replace it by the whole.
    """
    request = session.record_of(obj).status.request
    land = _current_land(obj, depsgraph)
    if land is None or land.is_shaped and not land.of_views or land.of_views_alone.folder in _refused:
        _rests[obj.session_uid].done = True
        return None
    return replace(land.of_views_alone, seen=_tiles_in_view(request))


def _current_land(obj, depsgraph) -> Land | None:
    """Return the land that the terrain's present settings describe, None without a stack or if they are invalid."""
    try:
        return land_of(obj, obj.evaluated_get(depsgraph), depsgraph, waits=False)
    except TerrainError:
        return None  # the update reports the error


def _tiles_in_view(request: Request) -> requested_tiles.SeenTiles:
    """Return the views and the error of a request, from which shaping derives the tiles that it needs.

    Its `placement` has the raster's middle as the origin, instead of the terrain's anchor (the object's origin).
    """
    return requested_tiles.SeenTiles(
        tuple(request.views),
        placement=about_middle(request.placement, request.anchor),
        error_px=request.criterion.error_px,
        vertical_scale=request.vertical_scale,
        vertical_offset=request.vertical_offset,
    )


def _create_job(land: Land, tiles_alone: bool) -> tuple[ShapeJob, requested_tiles.Tiles | None, Land] | None:
    """Return a new job, its tiles (None for all) and its land, or None if all tiles exist. Call it on another thread.

    It is slow. The job makes the whole land if that costs less than the missing tiles. tiles_alone: never do that,
    because renders of this terrain use land that is fine only in view (Detail: In the Shot).
    """
    wanted = derived_store.wanted_tiles(land, session.open_field)
    if derived_store.has_tiles(land, wanted, session.open_field):
        return None
    lattice = shaping_cost.lattice_of(land.source)
    if not tiles_alone and shaping_cost.costs_less_whole_than(lattice, land.stack, land.folder, wanted):
        land, wanted = replace(land, of_views=False, seen=None), None
    return *derived_store.begin_shaping(land, wanted, gentle=True), land


def _shape_in_steps(job: jobs.BackgroundJob, begun: Future) -> jobs.Steps:
    """Wait for `_create_job` and then for its child process, as steps of a job; return whether any land was made.

    begun: future of `_create_job`.
    """
    while not begun.done():
        yield
    if begun.result() is None:
        return False
    child, wanted, land = begun.result()
    yield from jobs.run_in_child(job, child)
    derived_store.finish_shaping(land, wanted)  # records which tiles exist now
    return True


def _advance_job(terrain: tuple | None) -> bool:
    """Advance the running job, or end it if its terrain changed; return whether it has ended and made land.

    Land that the user stopped or that failed is noted in `_refused`, so that it is not begun again. terrain:
    (dependency graph, object), None if no window shows it any more.
    """
    making, job = _making, _making.job
    depsgraph, obj = terrain or (None, None)
    if obj is None or not obj.adaptive_terrain.live or job.stopped or _has_new_settings(depsgraph, obj):
        if job.stopped:
            _refused.add(making.land.folder)
        _end_job(making)
        return False
    if not job.advance():
        return False
    _end_job(making)
    if job.error:
        _refused.add(making.land.folder)
        session.record_of(obj).status.error = job.error
    elif not job.result:  # no tile was missing
        _rests[making.uid].done = True
    return bool(job.result)


def _has_new_settings(depsgraph, obj) -> bool:
    """Return whether the terrain's settings describe other land than the one that is being made.

    If only the request has changed, such as after a move of the view, the job goes on for its old views, and the new
    key is noted.
    """
    key = session.record_of(obj).live_key
    if key == _making.key:
        return False
    _making.key, land = key, _current_land(obj, depsgraph)
    return land is None or land.of_views_alone.folder != _making.land.folder


def _end_job(making: _Making) -> None:
    """End a job, and cancel its child process; one that is only about to start (`begun`) is cancelled once it has."""
    global _making
    _making = None
    making.job.close()
    making.begun.add_done_callback(_cancel_child)


def _cancel_child(begun: Future) -> None:
    """Cancel the child process of a job that was ended before `_create_job` had started the process."""
    if not begun.cancelled() and begun.exception() is None and begun.result() is not None:
        begun.result()[0].cancel()
