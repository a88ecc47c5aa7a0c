# SPDX-License-Identifier: GPL-3.0-or-later
"""What a running Blender knows of its terrains: height fields, engines, and what each mesh shows.

Nothing here holds a reference to Blender data, which undo and loading invalidate: records are found by the object's
`session_uid`.
"""

import dataclasses
import threading
import time
from collections import Counter

import bpy

from ...cbt_terrain.accuracy.time_correction import TimeCorrection
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.evaluate.evaluate import EffectRequest, evaluate
from ...cbt_terrain.evaluate.layered_detail import laid
from ...cbt_terrain.evaluate.plan import plan
from ...cbt_terrain.field.bicubic import interpolated
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.field.store import changed_ns, is_intact, open_store
from ...cbt_terrain.land import derived_store
from ...cbt_terrain.mesh.attributes import Attribute
from ...cbt_terrain.mesh.surface import Surface
from ...cbt_terrain.refine.terms import Terms
from ...cbt_terrain.run import launch, warmup
from ...cbt_terrain.run.owned_files import real_path
from ...cbt_terrain.terrain import Terrain
from ..demand import kept
from ..mesh import freed_memory
from ..mesh.cleanup import clean_up
from ..mesh.writer import write_mesh
from ..properties.properties import ERROR_OVERLAY, NO_OVERLAY
from ..request.asked_effects import EffectStatus, statuses
from ..request.request import VIEWPORT, Request, gather
from ..request.scatters import ScatterRecord, make_points, show_points
from . import frozen
from .overlay import Overlay, make_overlay


@dataclasses.dataclass
class Status:
    """The last update as the panel shows it; `ms` is milliseconds a step, bounds are None where not asked for.
    `left`: triangles that the clean-up has left. `request`: what was asked, of the height field with the key
    `field_key`; None before the first update. `effects`: by name, what was made of each and why; `effects_bytes`: what
    all of them hold, for the next update too."""

    mode: str = ""
    request: Request | None = None
    field_key: str = ""
    changed: bool = False
    leaves: int = 0
    triangles: int = 0
    bound_px: float | None = None
    bound_m: float | None = None
    bound_edge_px: float | None = None
    bound_area_px: float | None = None
    terms_px: Terms | None = None
    terms_m: Terms | None = None
    limited: str = ""
    relaxed: float = 1.0
    left: int = 0
    ms: dict[str, float] = dataclasses.field(default_factory=dict)
    effects: dict[str, EffectStatus] = dataclasses.field(default_factory=dict)
    effects_bytes: int = 0
    error: str = ""

    @property
    def digest(self) -> str:
        """Names the mesh and the views that it was made for."""
        return self.request.digest(self.field_key) if self.request else ""


_OWN = ("mode", "request", "field_key", "left", "ms", "effects", "effects_bytes", "error")
FIGURES = [item.name for item in dataclasses.fields(Status) if item.name not in _OWN]  # those of an Update


@dataclasses.dataclass
class Record:
    """One terrain's engine. `serial` counts surfaces, `shown` tells which one the mesh holds and how it was written;
    `generation` counts everything that makes an update that is under way stale. `overlay` is None while it is off;
    `overlay_key` names what it was made of, in `overlay_ms`. `effects`: the attributes that effects have made, in
    arrays of the terrain's history, which holds `effects_bytes`; `effects_serial` counts their values, `effects_made`
    has the status of each, `effects_runs` how often each was computed.
    `scatters`: by the session_uid of their objects. `time_correction`: from the updates of the live viewport."""

    terrain: Terrain | None = None
    field: object = None
    serial: int = 0
    shown: tuple | None = None
    overlay: Overlay | None = None
    overlay_key: tuple | None = None
    overlay_ms: float = 0.0
    effects: dict[str, Attribute] = dataclasses.field(default_factory=dict)
    effects_serial: int = 0
    effects_made: dict[str, EffectStatus] = dataclasses.field(default_factory=dict)
    effects_bytes: int = 0
    effects_runs: Counter = dataclasses.field(default_factory=Counter)
    live_key: tuple | None = None
    time_correction: TimeCorrection = dataclasses.field(default_factory=TimeCorrection)
    scatters: dict[int, ScatterRecord] = dataclasses.field(default_factory=dict)
    generation: int = 0
    status: Status = dataclasses.field(default_factory=Status)


# Two updates side by side would share the same cores, and values of effects are valid until the next update: hold the
# lock around an update and copy what is needed longer.
engine_lock = threading.RLock()
_records: dict[int, Record] = {}
_fields: dict[tuple[str, int], object] = {}


def is_terrain(obj) -> bool:
    """Whether the object is a terrain whose mesh may be written: neither it nor its mesh is linked from a library, or
    overrides something linked (Cycles crashes on an overridden mesh that is written)."""
    if obj.type != "MESH" or not obj.adaptive_terrain.enabled:
        return False
    return all(block.library is None and block.override_library is None for block in (obj, obj.data))


def all_terrains() -> list:
    """Every terrain of the open file; records of objects that are gone are dropped."""
    found = [obj for obj in bpy.data.objects if is_terrain(obj)]
    for uid in set(_records) - {obj.session_uid for obj in found}:
        del _records[uid]
        derived_store.release(uid)
    return found


def terrains_of(scene) -> list:
    return [obj for obj in all_terrains() if _is_in(scene, obj)]


def _is_in(scene, obj) -> bool:
    """By its name, which is fast; but what is linked from a library may have the same."""
    found = scene.objects.get(obj.name)
    return found == obj or found is not None and any(other == obj for other in scene.objects)


def record_of(obj) -> Record:
    return _records.setdefault(obj.session_uid, Record())


def records() -> list[tuple[int, Record]]:
    """What is known, by session_uid."""
    return list(_records.items())


def update_object(obj, depsgraph=None, mode: str = VIEWPORT, **asked):
    """Refine the terrain `obj` for its camera and write its mesh where it changed; returns the engine's Update.

    `depsgraph`: the evaluated dependency graph (the context's own by default). `asked`: further arguments of
    `request.gather`. Raises TerrainError, which the panel shows too; the mesh then stays as it was.
    """
    record = record_of(obj)
    record.generation += 1
    try:
        try:
            return _update(obj, record, depsgraph, mode, asked)
        except TerrainError as error:
            if error.code != derived_store.DAMAGED:
                raise
            return _update(obj, record, depsgraph, mode, asked)
    except Exception as error:
        record.status.error = explain(error)
        raise


def _update(obj, record: Record, depsgraph, mode: str, asked: dict):
    request = gather(obj, depsgraph or bpy.context.evaluated_depsgraph_get(), mode, **asked)
    with engine_lock:
        update = solve(record, request)
        paint(record, request, update)
        show(obj, record, request, update, mode)
    record.live_key = request.key() if mode == VIEWPORT else None
    return update


def explain(error: Exception) -> str:
    """What the panel says of a failed update."""
    if isinstance(error, TerrainError):
        return str(error)
    return f"The update failed unexpectedly ({type(error).__name__}: {error}); the mesh stays as it was."


def solve(record: Record, request: Request):
    """Run the engine; touches nothing of Blender, so that any thread may call it (holding `engine_lock`). Waits for
    kernels that are being prepared: a render needs its mesh now, the viewport's updates do not begin before."""
    warmup.wait()
    heights = field_of(request)
    try:
        return _refine(record, request, heights)
    except TerrainError as error:
        derived_store.check_after(str(heights.path), error)
        raise


def _refine(record: Record, request: Request, heights: HeightField):
    if record.terrain is None or record.field is not heights:
        record.terrain, record.field, record.serial = Terrain(heights), heights, record.serial + 1
    placed = {"vertical_scale": request.vertical_scale, "vertical_offset": request.vertical_offset}
    if request.frozen:
        tree, meshlet = frozen.from_text(request.frozen)
        update = record.terrain.restore(tree, meshlet=meshlet, **placed)
    else:
        update = record.terrain.update(request.criterion, request.views, request.placement, **placed)
    record.serial += bool(update.changed)
    _make_effects(record, request, update, placed)
    make_points(record.scatters, request, record.field, record.terrain, update.surface, record.serial)
    return update


def _make_effects(record: Record, request: Request, update, placed: dict[str, float]) -> None:
    """The attributes that the request asks for, on the surface of an update."""
    names, asked = set(record.effects), plan(request.effects.asked)
    effects = EffectRequest(
        asked,
        update.surface,
        request.views,
        request.placement,
        **placed,
        geometry_metres=request.effects.geometry_metres,
    )
    made = evaluate(record.field, effects, record.terrain.history, record.terrain.threads)
    record.effects, record.effects_bytes = made.attributes, made.nbytes
    for name, ran in made.ran.items():
        record.effects_runs[name] += ran.computed > 0
    record.effects_serial += names != set(record.effects) or any(step.computed for step in made.ran.values())
    record.effects_made = statuses(request.effects, asked, made.ran, record.field)


def frozen_now(obj) -> str:
    """What `frozen` of the terrain's settings has to be so that it keeps the triangles that the viewport asks for."""
    with engine_lock:
        update_object(obj)
        tree, how = record_of(obj).terrain.saved()
        return frozen.to_text(tree, how["meshlet"])


def paint(record: Record, request: Request, update) -> None:
    """Make the overlay that the request asks for, or drop it; after `solve`, and like it for any thread."""
    key = None
    if request.overlay != NO_OVERLAY:
        # The error is another one in each view, also on the same mesh.
        key = (record.serial, request.overlay, request.key() if request.overlay == ERROR_OVERLAY else None)
    if key != record.overlay_key:
        if key is not None:
            warmup.wait(overlay=True)
        start = time.perf_counter()
        record.overlay = None if key is None else make_overlay(record.field, request, update.surface)
        record.overlay_key, record.overlay_ms = key, (time.perf_counter() - start) * 1e3


def field_of(request: Request):
    """The height field that a request refines, with its interpolation and its detail."""
    raster = derived_store.raster_of(request.store, request.land, open_field)
    field = interpolated(raster, request.interpolation)
    placed = request.vertical_scale, request.vertical_offset
    return laid(field, request.ground, *placed, launch.default_threads())


def open_field(store: str):
    """The height field of a store folder, opened once for as long as the folder is the same and no file is cut off."""
    changed = changed_ns(store)
    if not changed:
        raise TerrainError(f"There is no terrain store at {store!r}: choose its folder under Store, or import again.")
    key = str(real_path(store)), changed
    if key not in _fields or not is_intact(_fields[key]):
        for old in [other for other in _fields if other[0] == key[0]]:
            del _fields[old]
        _fields[key] = open_store(store)
    return _fields[key]


def show(obj, record: Record, request: Request, update, mode: str) -> bool:
    """Write the mesh, unless it shows this surface already; returns whether it was written."""
    _own_mesh(obj)
    written = record.shown != _what_is_shown(obj.data, record, request)
    ms = dict(update.ms)
    if written:
        start = time.perf_counter()
        if mode == VIEWPORT and update.triangles >= freed_memory.LARGE:
            freed_memory.hold()
        record.shown = None
        write_mesh(obj.data, clean_up(shown_surface(record, update), request.cleanup), smooth=request.smooth)
        record.shown = _what_is_shown(obj.data, record, request)
        ms["mesh"] = (time.perf_counter() - start) * 1e3
        if record.overlay is not None:
            ms["overlay"] = record.overlay_ms
    show_points(obj, record.scatters, request)
    if record.effects:
        ms["effects"] = sum(made.ms for made in record.effects_made.values())
    record.status = Status(
        mode=mode,
        request=request,
        field_key=record.field.key,
        left=len(obj.data.polygons),
        ms=ms,
        effects=record.effects_made,
        effects_bytes=record.effects_bytes,
        **{name: getattr(update, name) for name in FIGURES},
    )
    return written


def shown_surface(record: Record, update) -> Surface:
    """What an update has made, with the attributes of effects and of the overlay."""
    return update.surface.with_attributes(record.effects | (record.overlay.attributes if record.overlay else {}))


def _what_is_shown(mesh, record: Record, request: Request) -> tuple:
    counts = len(mesh.vertices), len(mesh.edges), len(mesh.polygons)
    attributes = tuple(name in mesh.attributes for name in record.effects)  # which a user may take away
    made = record.serial, record.overlay_key, record.effects_serial, attributes
    return mesh.session_uid, counts, request.smooth, request.cleanup.key(), *made


def _own_mesh(obj) -> None:
    """A terrain that shares its mesh gets one of its own: another place is another refinement, and the mesh of an
    object that is no terrain is not ours to write."""
    if obj.data.users > 1 and any(other.data == obj.data and other != obj for other in bpy.data.objects):
        obj.data = obj.data.copy()


def forget_shown() -> None:
    """Undo may have put back anything: write each mesh again at its next update, and drop what is under way."""
    kept.forget()
    for record in _records.values():
        record.shown = record.live_key = None
        for scatter in record.scatters.values():
            scatter.shown = ()
        record.generation += 1


def clear() -> None:
    """Forget every terrain and height field (another file is opened, or the extension goes)."""
    kept.forget()
    with engine_lock:
        for record in _records.values():
            record.generation += 1
        _records.clear()
        _fields.clear()
        derived_store.forget()
