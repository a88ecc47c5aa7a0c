# SPDX-License-Identifier: GPL-3.0-or-later
"""Import a height map into a store, in a child process that can neither block nor hurt Blender."""

import math
from contextlib import suppress
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.importing.header_files import is_plain_raw
from ...cbt_terrain.importing.import_process import ImportJob, import_source
from ...cbt_terrain.importing.raster import PLACED_SUFFIXES, RAW_SUFFIXES, ImportSettings
from ...cbt_terrain.run import warmup
from ..properties.properties import land_of
from ..properties.scene_paths import absolute_path
from ..request import imported
from ..scene import session
from ..scene.polls import on_terrain
from ..text.numbers import SMALLEST, plain
from ..viewport import frame_terrain, live
from .placement_notes import neighbour_notes, picture_note
from .store_location import elsewhere, store_folder

POLL_S = 0.1
RESIZED = 2.0  # times the size, or a part of it: what was framed before is not any more
_jobs: dict[int, ImportJob] = {}  # by the object's session_uid
_progress: dict[int, tuple[float, str]] = {}  # fraction and message, for the panel
_gone: set[int] = set()  # terrains that were undone or deleted while they were imported
_added: dict[int, str] = {}  # the stores of those that were imported as they were added


def progress_of(obj) -> tuple[float, str] | None:
    """Fraction done (0 .. 1) and what is being done, or None when nothing is being imported for the object."""
    return _progress.get(obj.session_uid)


def all_progress() -> list[tuple[float, str]]:
    """The same of every import that runs."""
    return list(_progress.values())


def settings_of(obj) -> ImportSettings:
    """What the terrain's properties ask to import."""
    settings = obj.adaptive_terrain
    extent = tuple(settings.extent) if settings.use_extent else None
    heights = {"height_scale": settings.height_scale, "height_offset": settings.height_offset}
    if (land := land_of(settings)) is not None:
        return ImportSettings(source=land.name, size=settings.island_size, seed=settings.seed, extent=extent, **heights)
    if not settings.source_path:
        raise TerrainError("No file is chosen to import; choose a height map on the terrain's panel.")
    raw = {}
    if is_raw(settings.source_path):
        raw = {
            "raw_size": tuple(settings.raw_size) if all(settings.raw_size) else None,
            "raw_dtype": settings.raw_dtype,
            "raw_little_endian": settings.raw_little_endian,
        }
    return ImportSettings(
        source=absolute_path(settings.source_path),
        extent=extent,
        no_data=settings.no_data if settings.use_no_data else None,
        holes=settings.holes,
        band=settings.band,
        channel=settings.channel,
        first_row_south=settings.first_row_south,
        project=settings.project.strip() if placed(settings.source_path) else "",
        **raw,
        **heights,
    )


def is_raw(path: str) -> bool:
    """Return whether a file holds samples alone, so that the panel must say what they are."""
    return path.lower().endswith(RAW_SUFFIXES) or is_plain_raw(Path(absolute_path(path)))


def placed(path: str) -> bool:
    """Whether a file of this kind can say where on Earth it is."""
    return path.lower().endswith(PLACED_SUFFIXES)


def import_now(obj) -> tuple[dict, str]:
    """Import and wait for the end; returns the report and the store, which is not the terrain's yet."""
    settings = settings_of(obj)
    folder = store_folder(obj, settings)
    return import_source(settings, absolute_path(folder)), folder


def summary(report: dict) -> str:
    """One line about an import."""
    width, height = report["raster"]
    line = f"{width} x {height} samples, {plain(report['lowest_m'], 4)} to {plain(report['highest_m'], 4)} m"
    if report["filled"]:
        line += f", {report['filled']:,} without data filled"
    if report.get("cut_out"):
        line += f", {report['cut_out']:,} without data cut out"
    if report["source_step_m"] >= SMALLEST:
        line += f", rounded by the source itself to ±{plain(report['source_step_m'], 2)} m"
    return line


def _size_of(obj) -> float:
    """Metres from one end of the terrain's height map to the other; 0 without one."""
    found = imported.imported_of(obj.adaptive_terrain)
    return math.hypot(*found.extent_m) if found is not None else 0.0


class _Import:
    """What both operators below do."""

    bl_label = "Import"

    @classmethod
    def poll(cls, context):
        if not on_terrain(cls, context):
            return False
        cls.poll_message_set("A height map is being imported already: wait for it, or cancel that beside its bar")
        return context.object.session_uid not in _jobs

    def invoke(self, context, event):
        obj = context.object
        self.uid = obj.session_uid
        try:
            settings = settings_of(obj)
            self.folder = store_folder(obj, settings)
            _jobs[self.uid] = ImportJob(settings, absolute_path(self.folder))
        except TerrainError as error:
            return self._failed(obj, str(error))
        _progress[self.uid] = 0.0, "Starting"
        session.record_of(obj).status.error = ""
        self.timer = context.window_manager.event_timer_add(POLL_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        job = _jobs[self.uid]
        obj = next((item for item in session.all_terrains() if item.session_uid == self.uid), None)
        if obj is None:  # undone, or deleted
            self.cancel(context)
            _gone.add(self.uid)
            return {"CANCELLED"}
        progress = job.poll()
        _progress[self.uid] = progress.fraction, progress.message
        live.redraw_panels()
        if not progress.done or warmup.preparing():  # what follows may update the mesh
            return {"PASS_THROUGH"}
        self._end(context)
        if job.cancelled:
            self.report({"INFO"}, str(progress.error))
            return {"CANCELLED"}
        if progress.error:
            return self._failed(obj, str(progress.error))
        return self._take(context, obj, progress.report, self.folder)

    def execute(self, context):
        obj = context.object
        try:
            report, folder = import_now(obj)
        except TerrainError as error:
            return self._failed(obj, str(error))
        return self._take(context, obj, report, folder)

    def cancel(self, context):
        """The terrain is gone, another file is loaded, or Blender quits."""
        _jobs[self.uid].cancel()
        self._end(context)

    def _end(self, context):
        context.window_manager.event_timer_remove(self.timer)
        del _jobs[self.uid], _progress[self.uid]
        live.redraw_panels()

    def _failed(self, obj, message: str):
        session.record_of(obj).status.error = message
        self.report({"ERROR"}, message)
        return {"CANCELLED"}

    def _take(self, context, obj, report: dict, folder: str):
        """The store is the terrain's from now on. One that is the first, or of another size, is brought into view."""
        before = _size_of(obj)
        obj.adaptive_terrain.store, obj.adaptive_terrain.frozen = folder, ""
        session.record_of(obj).status.error = ""  # that of the heights before, or that there were none
        imported.tag_object(obj)
        after = _size_of(obj)
        if after and not (before and 1 / RESIZED < after / before < RESIZED):
            self._bring_into_view(context, obj)
        return self._update(obj, report)

    def _bring_into_view(self, context, obj):
        viewports = frame_terrain.shown_viewports(context.window_manager, context.scene)
        try:
            done = frame_terrain.frame(obj, context.evaluated_depsgraph_get(), viewports, always=False)
        except TerrainError as error:
            self.report({"WARNING"}, str(error))
            return
        if done:
            self.report({"INFO"}, frame_terrain.said(done))

    def _update(self, obj, report: dict):
        notes = [*elsewhere(obj.adaptive_terrain.store), *neighbour_notes(obj, session.all_terrains())]
        for warning in [*report["warnings"], *notes]:
            self.report({"WARNING"}, warning)
        if note := picture_note(imported.imported_of(obj.adaptive_terrain)):
            self.report({"INFO"}, note)
        self.report({"INFO"}, summary(report))
        if obj.adaptive_terrain.live and not bpy.app.background:
            live.mark_dirty()
            return {"FINISHED"}
        try:
            session.update_object(obj)
        except TerrainError as error:
            self.report({"WARNING"}, str(error))  # the import itself is done
        return {"FINISHED"}


class ImportTerrain(_Import, bpy.types.Operator):
    """Import the height map into a store; Blender stays usable meanwhile"""

    bl_idname = "adaptive_terrain.import_source"
    bl_options = {"REGISTER", "UNDO"}


class ImportAdded(_Import, bpy.types.Operator):
    """Import the land of a terrain that was just added"""

    bl_idname = "adaptive_terrain.import_added"
    # What adds the terrain stays the last operation, for its panel is where one chooses another land or size. So this
    # is none, and no step for Undo either: adding is the step, and has no store yet, which is given back after it.
    bl_options = {"INTERNAL"}

    def _take(self, context, obj, report: dict, folder: str):
        _added[obj.session_uid] = folder
        return super()._take(context, obj, report, folder)


def begin_again() -> None:
    """After Undo or Redo: a terrain that is back, and went while it was imported, is imported anew; one whose import
    ended after the step has its store again."""
    if _gone or _added:
        bpy.app.timers.register(_begin_again, first_interval=0.0)  # a handler may begin nothing that runs on


def _begin_again() -> None:
    for obj in session.all_terrains():
        if obj.session_uid in _gone:
            _gone.remove(obj.session_uid)
            window = bpy.context.window_manager.windows[0]
            with suppress(RuntimeError), bpy.context.temp_override(window=window, object=obj):  # the panel says why
                bpy.ops.adaptive_terrain.import_added("INVOKE_DEFAULT")
        elif obj.session_uid in _added and obj.session_uid not in _jobs and not obj.adaptive_terrain.store:
            _give_back(obj)


def _give_back(obj) -> None:
    """The store, and what else the end of the import changed; what a viewport shows is nothing that is undone."""
    obj.adaptive_terrain.store = _added[obj.session_uid]
    imported.tag_object(obj)
    with suppress(TerrainError):  # the panel says why
        frame_terrain.frame(obj, bpy.context.evaluated_depsgraph_get(), [], always=False)
        if not obj.adaptive_terrain.live:
            session.update_object(obj)


class CancelImport(bpy.types.Operator):
    """Stop the import; the store stays as it was"""

    bl_idname = "adaptive_terrain.cancel_import"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.session_uid in _jobs

    def execute(self, context):
        _jobs[context.object.session_uid].cancel()
        return {"FINISHED"}


CLASSES = (ImportTerrain, ImportAdded, CancelImport)


def register() -> None:
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    for job in _jobs.values():
        job.cancel()
    for known in (_jobs, _progress, _gone, _added):
        known.clear()
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
