# SPDX-License-Identifier: GPL-3.0-or-later
"""The state of terrains in a running Blender: height fields, engines, and the surface that each mesh shows.

Records hold no reference to Blender data, which undo and loading invalidate. Their key is the object's `session_uid`.
"""

import threading
import time

import bpy

from ...cbt_terrain.attributes.layered_detail import displaced
from ...cbt_terrain.attributes.plan import plan
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField, anchored
from ...cbt_terrain.field.store import check_exists, is_intact, open_store
from ...cbt_terrain.height_operators import derived_store
from ...cbt_terrain.mesh.surface import Surface
from ...cbt_terrain.run import launch, warmup
from ...cbt_terrain.run.owned_files import real_path
from ..attributes.request import statuses
from ..bridge import freed_memory
from ..bridge.applied import remember
from ..bridge.cleanup import clean_up
from ..bridge.demand import demand_cache
from ..bridge.writer import write_mesh, write_normals
from ..overlay.colors import make_overlay
from ..scatter.request import make_points, show_points
from ..terrain import frozen
from ..terrain.properties import ERROR_OVERLAY, NO_OVERLAY
from ..terrain.request import VIEWPORT, Request, gather
from .record import Record, Status

# Hold the lock during an update: two would share the same cores. Effect values are valid until the next update, so copy
# them for longer use.
engine_lock = threading.RLock()
_records: dict[int, Record] = {}  # by session_uid
_fields: dict[tuple[str, int], object] = {}  # opened height fields by real path and time of change of their store
_last_shown = ""  # name of the terrain that was active last


def is_terrain(obj) -> bool:
    """Return whether the object is a terrain whose mesh may be written.

    Neither object nor mesh may be linked from a library or be an override: Cycles crashes on an override whose mesh is
    written.
    """
    if obj.type != "MESH" or not obj.adaptive_terrain.enabled:
        return False
    return all(block.library is None and block.override_library is None for block in (obj, obj.data))


def all_terrains() -> list:
    """Return every terrain of the open file that may be written, and drop the records of all other objects."""
    found = [obj for obj in bpy.data.objects if is_terrain(obj)]
    for uid in set(_records) - {obj.session_uid for obj in found}:
        del _records[uid]
        derived_store.release(uid)  # the store of its shaped heights may be deleted from the disk
    return found


def shown_terrain(context):
    """Return the terrain that panels show, None if there is none.

    It is the active object if that is a terrain; otherwise the terrain last shown, if it is in the scene; otherwise the
    scene's only terrain. If the active terrain is linked from a library or an override, panels show none.
    """
    global _last_shown
    obj, scene = context.object, getattr(context, "scene", None)
    if obj is not None and obj.type == "MESH" and obj.adaptive_terrain.enabled:
        if not is_terrain(obj):
            return None
        _last_shown = obj.name
        return obj
    if scene is None:
        return None
    last = scene.objects.get(_last_shown)
    if last is not None and is_terrain(last):
        return last
    found = terrains_of(scene)
    return found[0] if len(found) == 1 else None


def terrains_of(scene) -> list:
    """Return the terrain objects of a scene."""
    return [obj for obj in all_terrains() if _is_in(scene, obj)]


def _is_in(scene, obj) -> bool:
    """Return whether a scene has an object. The look-up by name is fast, but a linked object may have the same name."""
    by_name = scene.objects.get(obj.name)
    return by_name == obj or by_name is not None and any(other == obj for other in scene.objects)


def record_of(obj) -> Record:
    """Return the record of a terrain object, its state in this session; create it if it is missing."""
    return _records.setdefault(obj.session_uid, Record())


def records() -> list[tuple[int, Record]]:
    """Return (session_uid, record) of all terrains."""
    return list(_records.items())


def update_object(obj, depsgraph=None, mode: str = VIEWPORT, **options):
    """Refine the terrain `obj` for its camera, write its mesh if it changed, and return the engine's Update.

    Args:
        depsgraph: the evaluated dependency graph, the context's by default.
        mode: VIEWPORT or RENDER, whose settings are read.
        options: `criterion`, `camera`, `scene_cameras`, `resolution` or `overrides` in place of those of the scene.

    Raises:
        TerrainError: the update failed. The panel shows the error, and the mesh stays.
    """
    record = record_of(obj)
    record.generation += 1  # an update that is running now is out of date
    try:
        try:
            return _update(obj, record, depsgraph, mode, options)
        except TerrainError as error:
            if error.code != derived_store.DAMAGED:
                raise
            return _update(obj, record, depsgraph, mode, options)  # the damaged shaped land was removed: make it again
    except Exception as error:
        set_error(record, error)
        raise


def _update(obj, record: Record, depsgraph, mode: str, options: dict):
    """Refine and show a terrain's mesh in this thread, and return its Update.

    mode: VIEWPORT or RENDER. options: those of `update_object`.
    """
    request = gather(obj, depsgraph or bpy.context.evaluated_depsgraph_get(), mode, **options)
    with engine_lock:
        update = solve(record, request)
        update_overlay(record, request, update)
        show(obj, record, request, update, mode)
    record.live_key = request.key() if mode == VIEWPORT else None
    return update


def set_error(record: Record, error: Exception) -> None:
    """Have the panel show an error of the last update."""
    record.status.failure = as_terrain_error(error)
    record.status.error = str(record.status.failure)


def as_terrain_error(error: Exception) -> TerrainError:
    """Return the error of a failed update as one for the user."""
    if isinstance(error, TerrainError):
        return error
    return TerrainError(
        f"The update failed unexpectedly ({type(error).__name__}: {error}), and the mesh has not changed",
        fix="report it with the traceback of the console",
    )


def solve(record: Record, request: Request):
    """Run the engine for a request, keep its attributes and points in the record, and return its Update.

    It uses no Blender data, so any thread that holds `engine_lock` may call it. It waits for kernels that are being
    prepared, as a render must. Raises TerrainError, with the code DAMAGED if shaped land was damaged and removed.
    """
    warmup.wait()
    heights = field_of(request)
    try:
        return _refine(record, request, heights)
    except TerrainError as error:
        derived_store.raise_if_damaged(str(heights.path), error)
        raise


def _refine(record: Record, request: Request, heights: HeightField):
    """Return the Update for a request, or that of its frozen detail; compute attributes and scatter points for it.

    The record gets a new engine for another height field.
    """
    from ...cbt_terrain.terrain import Terrain

    if record.terrain is None or record.field is not heights:
        record.terrain, record.field, record.serial = Terrain(heights), heights, record.serial + 1
    vertical = {"vertical_scale": request.vertical_scale, "vertical_offset": request.vertical_offset}
    if request.frozen:
        with frozen.name_remedy():
            tree, meshlet = frozen.decode_tree(request.frozen)
            update = record.terrain.restore(tree, meshlet=meshlet, **vertical)
    else:
        update = record.terrain.update(request.criterion, request.views, request.placement, **vertical)
    record.serial += bool(update.changed)
    _make_effects(record, request, update, vertical)
    make_points(record.scatters, request, record.field, record.terrain, update.surface, record.serial)
    return update


def _make_effects(record: Record, request: Request, update, vertical: dict[str, float]) -> None:
    """Compute the attributes of the request on the surface of an update; store values, costs and counts in the record.

    vertical: `vertical_scale` and `vertical_offset` of the terrain. record.effects_runs: how often each attribute was
    computed. record.effects_serial: number of the present values, which grows if any of them is new.
    """
    from ...cbt_terrain.attributes.evaluate import EffectRequest, evaluate

    names_before, planned = set(record.effects), plan(request.effects.requests)
    effects = EffectRequest(
        planned,
        update.surface,
        request.views,
        request.placement,
        **vertical,
        geometry_metres=request.effects.geometry_metres,
    )
    result = evaluate(record.field, effects, record.terrain.history, record.terrain.threads)
    record.effects, record.effects_bytes = result.attributes, result.nbytes
    for name, ran in result.ran.items():
        record.effects_runs[name] += ran.computed > 0
    record.effects_serial += names_before != set(record.effects) or any(step.computed for step in result.ran.values())
    record.effects_status = statuses(request.effects, planned, result.ran, record.field)


def freeze(obj) -> str:
    """Update the terrain for the viewport, and return its triangles as the text for its property `frozen`.

    The caller sets the property. Raises TerrainError.
    """
    with engine_lock:
        update_object(obj)
        tree, settings = record_of(obj).terrain.saved()
        return frozen.encode_tree(tree, settings["meshlet"])


def update_overlay(record: Record, request: Request, update) -> None:
    """Make or drop the record's overlay for a request, after `solve` and on any thread that holds `engine_lock`.

    update: result of `solve`. An overlay with the same inputs is kept.
    """
    key = None
    if request.overlay != NO_OVERLAY:
        # the error depends on the view, also on the same mesh
        key = (record.serial, request.overlay, request.key() if request.overlay == ERROR_OVERLAY else None)
    if key != record.overlay_key:
        if key is not None:
            warmup.wait(overlay=True)
        start = time.perf_counter()
        record.overlay = None if key is None else make_overlay(record.field, request, update.surface)
        record.overlay_key, record.overlay_ms = key, (time.perf_counter() - start) * 1e3


def field_of(request: Request):
    """Return the height field of a request: its store or shaped land, anchored, interpolated and displaced.

    Its callees cache it, and `_refine` keeps the engine of the same object. Raises TerrainError.
    """
    from ...cbt_terrain.field.bicubic import interpolated

    raster = derived_store.raster_of(request.store, request.land, open_field)
    field = interpolated(anchored(raster, *request.anchor), request.interpolation)
    return displaced(
        field, request.ground, request.vertical_scale, request.vertical_offset, threads=launch.default_threads()
    )


def open_field(store: str):
    """Return the height field of a store folder, opened again only if the folder changed or a file was truncated.

    Raises TerrainError for a missing or damaged store.
    """
    key = str(real_path(store)), check_exists(store)
    if key not in _fields or not is_intact(_fields[key]):
        for old in [other for other in _fields if other[0] == key[0]]:
            del _fields[old]
        _fields[key] = open_store(store)
    return _fields[key]


def show(obj, record: Record, request: Request, update, mode: str, *, exact: bool = True) -> bool:
    """Write the mesh unless it already shows this surface; return whether it was written.

    update: the engine's Update of the terrain for `request`; scatter points and the record's status become those of it
    in any case. mode: VIEWPORT or RENDER. exact: write exact normals at once, which is slow before Blender 4.5;
    otherwise those versions get them by a later `show_normals`. On the main thread, with `engine_lock` held.
    """
    _make_mesh_single_user(obj)
    written = record.shown != _what_is_shown(obj.data, record, request)
    ms = dict(update.ms)
    if written:
        start = time.perf_counter()
        if mode == VIEWPORT and update.triangles >= freed_memory.LARGE:
            freed_memory.hold_freed_memory()  # the next mesh gets the memory of this one
        record.shown = record.postponed_normals = None  # nothing, should the writing fail
        surface = clean_up(shown_surface(record, update), request.cleanup)
        if write_mesh(obj.data, surface, smooth=request.smooth, exact=exact):
            record.postponed_normals = surface.normals.copy()
        record.shown = _what_is_shown(obj.data, record, request)
        remember(record.placed, obj)
        ms["mesh"] = (time.perf_counter() - start) * 1e3
        if record.overlay is not None:
            ms["overlay"] = record.overlay_ms
    elif exact:
        show_normals(obj)
    show_points(obj, record.scatters, request)
    if record.effects:
        ms["effects"] = sum(status.ms for status in record.effects_status.values())
    record.status = Status(
        mode=mode,
        request=request,
        field_key=record.field.key,
        triangles_left=len(obj.data.polygons),
        ms=ms,
        effects=record.effects_status,
        effects_bytes=record.effects_bytes,
        changed=update.changed,
        leaves=update.leaves,
        triangles=update.triangles,
        bounds=update.bounds,
    )
    return written


def show_normals(obj) -> bool:
    """Write the exact normals that a live update has postponed; return whether they were written.

    They are dropped if the mesh has changed since then or is being edited.
    """
    record, mesh = record_of(obj), obj.data
    normals, record.postponed_normals = record.postponed_normals, None
    if normals is None or record.shown is None or len(normals) != len(mesh.vertices) or mesh.is_editmode:
        return False
    write_normals(mesh, normals)
    return True


def shown_surface(record: Record, update) -> Surface:
    """Return the updated surface with effect and overlay attributes."""
    return update.surface.with_attributes(record.effects | (record.overlay.attributes if record.overlay else {}))


def _what_is_shown(mesh, record: Record, request: Request) -> tuple:
    """Return a key that changes whenever the mesh in Blender is no longer the one that the record has written."""
    attributes = tuple(name in mesh.attributes for name in record.effects)  # a user may remove some
    serials = record.serial, record.overlay_key, record.effects_serial, attributes
    return _elements(mesh), request.smooth, request.cleanup.key(), *serials


def _elements(mesh) -> tuple[int, int, int, int]:
    """Return which mesh it is, by its session_uid, and its numbers of vertices, edges and faces."""
    return mesh.session_uid, len(mesh.vertices), len(mesh.edges), len(mesh.polygons)


def is_as_written(mesh, record: Record) -> bool:
    """Return False if a terrain's mesh has other elements than were written, as after Apply of a modifier."""
    return record.shown is None or record.shown[0] == _elements(mesh)


def _make_mesh_single_user(obj) -> None:
    """Give an object its own copy of a shared mesh.

    Another location needs another refinement, and other objects must not change.
    """
    if obj.data.users > 1 and any(other.data == obj.data and other != obj for other in bpy.data.objects):
        obj.data = obj.data.copy()


def forget_shown() -> None:
    """After undo, write each mesh again at its next update, and drop running updates."""
    demand_cache.forget()  # the attributes that node trees read
    for record in _records.values():
        record.shown = record.postponed_normals = record.live_key = None
        for scatter in record.scatters.values():
            scatter.shown = ()
        record.generation += 1


def forget_in_mode(obj, record: Record) -> None:
    """While a terrain is in another mode than Object Mode, have its next live update run, and write an edited mesh.

    An update that ends in such a mode is dropped, and a mesh may have moved vertices and the same numbers of them.
    """
    record.live_key = None
    if obj.mode in ("EDIT", "SCULPT"):
        record.shown = record.postponed_normals = None


def clear() -> None:
    """Drop every terrain and height field, after another file or before the extension is disabled."""
    demand_cache.forget()  # the attributes that node trees read
    with engine_lock:
        for record in _records.values():
            record.generation += 1
        _records.clear()
        _fields.clear()
        derived_store.forget()
