# SPDX-License-Identifier: GPL-3.0-or-later
"""Live updates: the viewport's mesh follows its camera, and the viewport never waits.

Slow effects start with a preview. While nothing changes, short steps refine them to the values of a render.

Handlers only set a flag. A timer on the main thread reads the properties, passes plain numbers to a worker thread, and
writes the mesh when the worker is done. A result is dropped if its terrain was updated by other means, undone, deleted
or replaced in the meantime. A camera that has moved in the meantime gets the next update.
"""

import time
import traceback
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.height_operators import derived_store
from ...cbt_terrain.run import warmup
from .. import jobs
from ..bridge.demand.screens import screens_key
from ..bridge.writing import allow_writing
from ..ground import keep_ground
from ..importing.shared_origin import follow_replaced_store
from ..land import resting_land
from ..terrain.camera_source import follows_viewport
from ..terrain.request import RENDER, VIEWPORT, Request, correct_for_time, gather, record_time
from ..terrain.request_kernels import kernels_for
from . import session

# Seconds between turns of the timer: without work, while the worker computes, and during a render.
IDLE_S, BUSY_S, RENDERING_S = 0.05, 0.005, 0.25
NORMALS_S = 1.0  # without an update before a live mesh gets its exact normals


@dataclass
class LiveUpdate:
    """An update or a step of one: the terrain's session_uid, its Record.generation at the start, and the request."""

    uid: int
    generation: int
    request: Request
    future: Future | None  # None once its result is shown


_dirty = False  # whether a terrain may need an update
_unrefined: dict[int, LiveUpdate] = {}  # last updates whose meshes show a preview, by session_uid
_job: LiveUpdate | None = None
_worker: ThreadPoolExecutor | None = None
_draw_handle = None
_follows_viewport = False
_screens: tuple = ()  # key of the attributes that open windows read
_started = 0.0  # start of the running job
_shown_at = 0.0  # end of the last update
_stage = ""  # current work of the worker, for the status bar


def mark_dirty() -> None:
    """Request an update after a change that a terrain may depend on. Any thread may call it."""
    global _dirty
    _dirty = True


def tick() -> float:
    """Run one turn of the timer, and return the seconds until the next."""
    try:
        return _turn()
    except Exception:  # Blender silently removes a timer that raises
        traceback.print_exc()
        return IDLE_S


def _turn() -> float:
    """Run a turn of the timer: show a finished update, start the next one or use idle time; return seconds to wait."""
    global _dirty, _job
    if _dirty and not bpy.app.background and session.all_terrains():
        warmup.start()  # a terrain was opened or added; without one, Warp and the kernels are not imported
    if warmup.preparing():
        return IDLE_S
    if jobs.is_rendering():
        return RENDERING_S
    if _job is not None:
        if not _job.future.done():
            return BUSY_S
        job, _job = _job, None
        _show_result(job)
        del job  # frees its surface for the next update
    idle = not _dirty and not _windows_changed()
    if idle:
        _job = _next_refinement()
    _dirty |= _refine_resting_land(idle and _job is None)  # finer land needs an update
    if idle:
        if _job is None and time.monotonic() - _shown_at >= NORMALS_S:
            _write_postponed_normals()
        return IDLE_S if _job is None else BUSY_S
    _dirty = False  # before reading the properties, so that no later change is missed
    _job = _next_job()
    if _job is None:
        return IDLE_S
    _dirty = True  # another terrain may be waiting
    return BUSY_S


def _refine_resting_land(idle: bool) -> bool:
    """Let resting_land refine the shaped land of terrains that do not change; return whether any has become finer.

    idle: no update is due or running.
    """
    if not resting_land.has_work():
        return False
    before = jobs.progress_shown()
    has_changed = resting_land.turn(_shown_terrains(), idle)
    if jobs.progress_shown() != before:
        jobs.redraw_panels()
    return has_changed


def _write_postponed_normals() -> None:
    """Write the exact normals that live updates have left out, before Blender 4.5."""
    if any(record.postponed_normals is not None for _, record in session.records()):
        for obj in session.all_terrains():
            if obj.mode == "OBJECT":
                _show_normals(obj)


_show_normals = allow_writing(session.show_normals)


def _windows_changed() -> bool:
    """Return whether windows have changed since the last call.

    A new spreadsheet reads attributes, but Blender calls no handler for it.
    """
    global _screens
    before, _screens = _screens, screens_key()
    return before != _screens


def seconds_under_way() -> float:
    """Return the seconds since the running update started; 0 if none runs."""
    return time.monotonic() - _started if _job is not None and not _job.future.done() else 0.0


def is_behind() -> bool:
    """Return whether an update is due or runs, so that the figures of the last one may be those of another view."""
    # A terrain that follows the viewport is marked after each draw, so there the mark alone means nothing.
    return _job is not None or _dirty and (warmup.preparing() or not _follows_viewport)


def stage() -> str:
    """Return the current work of the worker, for the status bar."""
    return _stage


@allow_writing
def _next_job() -> LiveUpdate | None:
    """Start an update of the first terrain whose request has changed; return it.

    None if there is none, or its kernels are being loaded. Objects that are kept on the ground are placed before.
    """
    global _follows_viewport, _started
    for window in _windows():
        if not keep_ground.settle_shown(window.scene, window.view_layer.depsgraph):
            mark_dirty()  # kernels are being compiled: the next turn tries again
    shown = _shown_terrains()
    _follows_viewport = any(
        depsgraph is not None and follows_viewport(obj, depsgraph.scene) for depsgraph, obj in shown
    )
    for depsgraph, obj in shown:
        record = session.record_of(obj)
        # A mesh that a render has left is replaced by one for the viewport, also without Live Update.
        wanted = obj.adaptive_terrain.live or record.status.mode == RENDER
        if obj.mode != "OBJECT":
            session.forget_in_mode(obj, record)
        # Without a store the panel keeps the error of a failed import.
        if depsgraph is None or not wanted or not obj.adaptive_terrain.store or obj.mode != "OBJECT":
            continue
        if follow_replaced_store(obj):
            depsgraph.update()
        try:
            request = gather(obj, depsgraph, VIEWPORT)
        except Exception as error:
            record.live_key = None  # the next request may equal the last one
            _report_error(record, error)
            if not isinstance(error, TerrainError):
                traceback.print_exc()
            continue
        if request.key() != record.live_key or not session.is_as_written(obj.data, record):
            if not _is_prepared(record, request):
                return None
            record.live_key, _started = request.key(), time.monotonic()  # _started: of the running job
            # The error that fits a time budget is not in the key, so that a still camera gets one mesh.
            request = correct_for_time(request, record.time_correction)
            # With another generation at the end, the terrain was updated by other means and the result is dropped.
            generation = record.generation
            future = _worker.submit(_solve_on_worker, record, request)
            return LiveUpdate(obj.session_uid, generation, request, future)
    return None


def _shown_terrains() -> list[tuple]:
    """Return (dependency graph, object) of the terrains in windows; the graph is None if Blender has not made it yet.

    A terrain in windows of several scenes follows the first: its one mesh would otherwise alternate between cameras.
    """
    found = {}
    for window in _windows():
        for obj in session.terrains_of(window.scene):
            if found.get(obj.session_uid, (None,))[0] is None:
                found[obj.session_uid] = window.view_layer.depsgraph, obj
    return list(found.values())


def _is_prepared(record: session.Record, request: Request) -> bool:
    """Return whether an update can start: the kernels of its request are loaded, or cannot be loaded at all.

    If they are not, start loading them for a later turn.
    """
    try:
        ready = warmup.prepare_modules(kernels_for(request))
    except TerrainError as error:
        _report_error(record, error)
        return True  # the update will fail with the same error
    if not ready:
        mark_dirty()
    return ready


def _next_refinement() -> LiveUpdate | None:
    """Start a refinement step of the first mesh that shows a preview; return it, None if there is none.

    Previews of terrains that are gone or were updated since (another `generation`) are forgotten.
    """
    global _started
    if not _unrefined:
        return None
    terrains = {obj.session_uid: obj for obj in session.all_terrains()}
    for uid, job in list(_unrefined.items()):
        obj = terrains.get(uid)
        if obj is None or session.record_of(obj).generation != job.generation:
            del _unrefined[uid]
        elif obj.mode == "OBJECT":  # otherwise its mesh cannot be written
            _started = time.monotonic()
            future = _worker.submit(_refine_on_worker, session.record_of(obj), job.request)
            return LiveUpdate(uid, job.generation, job.request, future)
    return None


def _windows():
    """Return Blender's open windows."""
    return bpy.context.window_manager.windows


def _solve_on_worker(record: session.Record, request: Request):
    """Compute an update on the worker thread, with previews in place of slow attributes.

    Returns the Update, the serial number of its surface in the record, and whether no preview was needed.
    """
    from . import previews

    global _stage
    _stage = "Refining"
    with session.engine_lock:
        first = previews.with_previews(request, session.field_of(request))
        return _solve_with_overlay(record, first), record.serial, first is request


def _refine_on_worker(record: session.Record, request: Request):
    """Run one step of the slow attributes on the worker thread; return None if more steps are needed.

    After the last step, return the Update, the serial number of its surface and True: no preview is shown.
    """
    from . import previews

    global _stage
    _stage = "Refining effects"
    if not previews.refine(request, session.field_of(request)):
        return None
    with session.engine_lock:
        return _solve_with_overlay(record, request), record.serial, True


def _solve_with_overlay(record: session.Record, request: Request):
    """Compute the update of a request and its overlay; return the Update. The caller holds the engine's lock."""
    global _stage
    update = session.solve(record, request)
    _stage = "Making the overlay"
    session.update_overlay(record, request, update)
    return update


@allow_writing
def _show_result(job: LiveUpdate) -> None:
    """Write the mesh of a finished update, unless the terrain has changed since it was started.

    An error is shown on the panel; one that is no TerrainError is also raised. `_unrefined` then has the update if its
    mesh shows a preview.
    """
    global _shown_at
    _shown_at = time.monotonic()
    obj = next((item for item in session.all_terrains() if item.session_uid == job.uid), None)
    if obj is None or obj.mode != "OBJECT":
        return
    record = session.record_of(obj)
    try:
        result = job.future.result()
        if result is None:  # of a refinement that needs more steps
            return
        update, serial, is_refined = result  # serial: number of the record's surface that the update has made
        with session.engine_lock:
            # Another update may have been shown since then.
            if record.generation == job.generation and record.serial == serial:
                session.show(obj, record, job.request, update, VIEWPORT, exact=False)
                if update.changed:
                    record_time(job.request, update.ms["total"], record.time_correction)
        _unrefined.pop(job.uid, None)
        if not is_refined:
            _unrefined[job.uid] = replace(job, future=None)
    except Exception as error:
        _unrefined.pop(job.uid, None)
        if isinstance(error, TerrainError) and error.code == derived_store.DAMAGED:
            mark_dirty()  # the next update shapes the land again
        else:
            _report_error(record, error)
        if not isinstance(error, TerrainError):
            raise
    jobs.redraw_panels()


def show_soon(obj) -> None:
    """Show the heights of a terrain that have changed: by the next live update, or now without one.

    Raises TerrainError if an update now fails.
    """
    if obj.adaptive_terrain.live and not bpy.app.background:
        mark_dirty()
    else:
        session.update_object(obj)


def _report_error(record: session.Record, error: Exception) -> None:
    """Show an error of an update on the panel, unless it is shown already."""
    if record.status.error != str(session.as_terrain_error(error)):
        session.set_error(record, error)
        jobs.redraw_panels()


def _on_draw() -> None:
    """Check terrains that follow the viewport after each draw, since turning the view calls no handler."""
    if _follows_viewport:
        mark_dirty()


def start() -> None:
    """Start the worker thread, and in a window the timer and the callback that notice changed views."""
    global _worker, _draw_handle
    _worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="adaptive_terrain_live")
    if not bpy.app.background:
        if warmup.is_first_start():  # kernels are compiled now; later starts wait for a terrain
            warmup.start()
        bpy.app.timers.register(tick, first_interval=IDLE_S, persistent=True)
        _draw_handle = bpy.types.SpaceView3D.draw_handler_add(_on_draw, (), "WINDOW", "POST_PIXEL")


def stop() -> None:
    """Stop timer, callback and worker, after the update that is running."""
    global _worker, _job, _dirty, _draw_handle
    warmup.stop()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    if _draw_handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_draw_handle, "WINDOW")
        _draw_handle = None
    _worker.shutdown(wait=True)
    _worker, _job, _dirty = None, None, False
    resting_land.stop()
    _unrefined.clear()
