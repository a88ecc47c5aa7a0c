# SPDX-License-Identifier: GPL-3.0-or-later
"""Import a height map into a store, in a child process that can neither block nor hurt Blender."""

import dataclasses
import math
from contextlib import closing, suppress
from functools import partial
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.store import changed_ns, read_json
from ...cbt_terrain.formats.file_options import ROWS, options_of
from ...cbt_terrain.importing.source_list import may_name_several, names_several
from ...cbt_terrain.importing.thinning import QUICK_SAMPLES
from ...cbt_terrain.rasters.raster import ImportSettings
from ...cbt_terrain.rasters.source_formats import BAND, CELL, CHANNEL, ENCODING, RAW
from .. import jobs
from ..bridge.evaluated import anchor_of
from ..bridge.scene_origin import origin_of
from ..bridge.scene_paths import absolute_path
from ..bridge.writing import allow_writing
from ..job_operator import JobOperator
from ..maps.images import outdated_note
from ..session import live, session
from ..session.polls import run_nested
from ..terrain import frame_terrain, request, sidebar
from ..terrain.camera_source import follows_viewport
from ..terrain.properties import built_in_land
from ..text.gap_note import missing_text
from ..text.numbers import SMALLEST, plain
from . import imported, shared_origin, view_tiles
from .expected_work import warn_of_work
from .placement_notes import neighbour_notes, picture_note, scatter_note, unit_note
from .store_location import location_warnings, store_folder, stored_path

RESIZED = 2.0  # ratio of sizes from which on the terrain is framed again
_gone: set[int] = set()  # terrains that were undone or deleted while they were imported
_added: dict[int, str] = {}  # stores of terrains that were imported when they were added


def settings_of(obj) -> ImportSettings:
    """Return the import settings of a terrain's properties. Raises TerrainError if no file is chosen.

    An option that the file's format lacks keeps its default, whatever the property is. A scale of heights that the user
    has not set is None, so that the import chooses one for an image.
    """
    settings = obj.adaptive_terrain
    extent = tuple(settings.extent) if settings.use_extent else None
    heights = {"height_offset": settings.height_offset}
    if settings.is_property_set("height_scale"):
        heights["height_scale"] = settings.height_scale
    if (land := built_in_land(settings)) is not None:
        return ImportSettings(source=land.name, size=settings.island_size, seed=settings.seed, extent=extent, **heights)
    if not settings.source_path:
        raise TerrainError("No file is chosen to import", fix="choose a height map on the terrain's panel")
    if settings.use_heights:
        heights = {"lowest": settings.lowest, "highest": settings.highest}
    files = _files_of(settings)
    several = names_several(files)  # of any formats: the import then finds out what applies to each file
    mosaic = {}
    if may_name_several(files):  # an archive may hold several, too
        mosaic = {"priority": settings.priority, "step": settings.sample_step or None, "blend": settings.blend}
    options = (BAND, ENCODING, CELL) if several else options_of(Path(files.source))
    raw = {}
    if RAW in options:
        raw = {
            "raw_size": tuple(settings.raw_size) if all(settings.raw_size) else None,
            "raw_dtype": settings.raw_dtype,
            "raw_little_endian": settings.raw_little_endian,
        }
    return ImportSettings(
        source=files.source,
        more_sources=files.more_sources,
        extent=extent,
        no_data=settings.no_data if settings.use_no_data else None,
        holes=settings.holes,
        band=settings.band if BAND in options else 1,
        channel=settings.channel if CHANNEL in options else "",
        encoding=settings.encoding if settings.encoding != "AUTO" and ENCODING in options else "",
        cell=settings.cell if settings.cell and CELL in options else None,
        first_row_south=settings.first_row_south and ROWS in options,
        project=settings.project.strip() if BAND in options else "",  # formats with bands can record a position
        **raw,
        **heights,
        **mosaic,
    )


def has_several_files(settings) -> bool:
    """Return whether a terrain's source is several files, a folder, a pattern or a tile index."""
    return bool(settings.source_path) and names_several(_files_of(settings))


def may_hold_several(settings) -> bool:
    """Return whether a terrain's source is several files, or an archive that may hold several."""
    return bool(settings.source_path) and may_name_several(_files_of(settings))


def _files_of(settings) -> ImportSettings:
    """Return import settings with the absolute paths of a terrain's sources alone."""
    more = tuple(absolute_path(item.path) for item in settings.more_sources if item.path)
    return ImportSettings(absolute_path(settings.source_path), more_sources=more)


def has_option(path: str, option: str) -> bool:
    """Return whether an import option, such as RAW or BAND, applies to a file, by its name and the header beside it.

    Files that have BAND can record their position on Earth, too.
    """
    return option in options_of(Path(absolute_path(path)))


def summary(report: dict) -> str:
    """Describe an import in one line, from the report that the import wrote."""
    width, height = report["raster"]
    line = f"{width} x {height} samples, {plain(report['lowest_m'], 4)} to {plain(report['highest_m'], 4)} m"
    for name, verb in (("filled", "filled"), ("cut_out", "cut out")):
        if count := report.get(name):
            line += f", {missing_text(count, width * height)} without data {verb}"
    if report.get("loaded"):
        line += f", loaded {report['loaded']}"
    if report["source_step_m"] >= SMALLEST:
        line += f", rounded by the source itself to ±{plain(report['source_step_m'], 2)} m"
    return line


def _size_of(found: imported.Imported | None) -> float:
    """Return the diagonal of an imported height map in metres; 0 for None."""
    return math.hypot(*found.extent_m) if found is not None else 0.0


def start_import(operator, run, **properties) -> set[str]:
    """Run an import operator inside another one: as a job beside the window if there is one, else to its end.

    run: its function in bpy.ops. Return FINISHED (of a job, once it has begun), or CANCELLED with the operator's report
    if it refuses or, without a window, fails.
    """
    return run_nested(operator, run, "EXEC_DEFAULT" if bpy.app.background else "INVOKE_DEFAULT", **properties)


class ImportOperator(JobOperator):
    """Base of the operators that import.

    Attributes:
        shows_first_picture: whether a quick import is shown first.
        before: Imported of the store that the terrain had before, None without one. An import may write its folder.
        box: corners of the terrain with that store in the world, float64 [8, 3], None without one.
        baked: path of the baked land that the import replaces, "" for none.
    """

    bl_label = "Import"

    kind = jobs.IMPORT
    shows_first_picture = True
    box = None
    baked = ""

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Import the terrain's height map in a child process; return its report and the path of the store.

        With a window, a large map without a store is first imported quickly, with every n-th sample, and `finish`
        shows that first picture. Its complete store then replaces the quick one in the same folder, so neither the
        terrain nor Undo changes the path. If the second import is cancelled or fails, the quick store stays, and its
        report has the error as its warning. Tiles that views need come before the others, also when an incomplete store
        is completed.
        """
        settings = settings_of(context.object)
        self.before = imported.imported_of(context.object.adaptive_terrain)
        self.box = frame_terrain.box_or_none(context.object)
        self.baked = context.object.adaptive_terrain.store if self.before and self.before.is_shaped else ""
        folder = absolute_path(store_folder(context.object, settings))  # for a file that is saved elsewhere meanwhile
        if not (self.shows_first_picture and self.beside_window):
            return (yield from self._import(job, settings, folder))
        quick, quick_settings = None, dataclasses.replace(settings, quick=QUICK_SAMPLES)
        if not changed_ns(folder):  # 0: there is no store yet
            quick = yield from self._import(job, quick_settings, folder)
            if "loaded" not in quick[0] or job.terrain() is None:  # complete, or its terrain is gone
                return quick
            self.finish(bpy.context, job.terrain(), quick)
        try:
            with view_tiles.loading(job.uid, quick_settings, folder) as loader:
                if quick is not None:
                    yield from self._load_seen(job, loader, folder)
                return (yield from self._complete(job, loader, settings, folder))
        except (jobs.JobStopped, TerrainError) as error:
            if quick is None or job.is_orphan:
                raise
            notes = [str(error)] if isinstance(error, TerrainError) else []
            return read_json(Path(folder))["report"] | {"warnings": notes}, folder

    def _load_seen(self, job: jobs.BackgroundJob, loader: view_tiles.TileLoader, folder: str) -> jobs.Steps:
        """Load the tiles that the views of a first picture need, and show them; the picture stays if that fails.

        A camera that is not placed does not count: its tiles would delay those of the viewports. loader: loads tiles
        into the store at `folder`, by one child process at a time.
        """
        job.raise_if_stopped()
        depsgraph, obj = bpy.context.evaluated_depsgraph_get(), job.terrain()
        modes = [request.VIEWPORT] if follows_viewport(obj, bpy.context.scene) else [request.VIEWPORT, request.RENDER]
        try:
            if child := loader.start(obj, depsgraph, *modes):
                report = yield from jobs.run_in_child(job, child)
                if job.terrain() is not None:
                    self.finish(bpy.context, job.terrain(), (report, folder))
        except TerrainError:
            pass  # the complete import then reports it
        finally:
            loader.child = None

    def _complete(
        self, job: jobs.BackgroundJob, loader: view_tiles.TileLoader, settings: ImportSettings, folder: str
    ) -> jobs.Steps:
        """Import all samples; `loader` meanwhile loads tiles that moved views need. Return the report and the path."""
        with closing(self._import(job, settings, folder)) as work:
            while True:
                try:
                    next(work)
                except StopIteration as end:
                    return end.value
                if loader.turn(job.terrain()):  # a child process has loaded tiles
                    with suppress(TerrainError):  # the panel says why
                        live.show_soon(job.terrain())
                yield

    def _import(self, job: jobs.BackgroundJob, settings: ImportSettings, folder: str) -> jobs.Steps:
        """Import into the store `folder` in a child process; return the import's report and the path."""
        from ...cbt_terrain.importing.import_process import ImportJob

        job.raise_if_stopped()
        report = yield from jobs.run_in_child(job, ImportJob(settings, folder), partial(warn_of_work, self))
        yield from jobs.wait_with_result(job)  # until the kernels that refine the imported terrain are compiled
        return report, folder

    def abandon(self) -> None:
        """Remember a terrain that was removed during its import: an undo may bring it back."""
        _gone.add(self.job.uid)

    def finish(self, context, obj, result: tuple[dict, str]) -> None:
        """Give the store to the terrain, place it, show it in viewports, and report.

        A quick import calls it up to three times: for the first picture, for its tiles in view and for the complete
        store. result: the import's report and the absolute path of the store.
        """
        report, before, anchor_before, folder = result[0], self.before, anchor_of(obj), stored_path(result[1])
        # Whether the terrain is where its coordinates are in the scene, and so moves to those of the new raster.
        follows = shared_origin.follows_coordinates(obj, context.scene, before)
        # Frozen triangles, and the error of the last update, are those of the heights before.
        obj.adaptive_terrain.store, obj.adaptive_terrain.frozen = folder, ""
        session.record_of(obj).status.error = ""
        imported.tag_object(obj)
        found = imported.imported_of(obj.adaptive_terrain)
        shared_origin.keep_anchor_inside(obj, found)
        # How far the new raster moves the origin of the object's space, in metres: the ground itself has to stay.
        shift = shared_origin.origin_shift(obj, before, found, anchor_before)
        if follows:
            if before is None and shared_origin.forget_left_origin(obj, context.scene, found):
                self.report({"INFO"}, "The scene's origin is now here, since no terrain is left at the earlier one")
            if before is not None:
                shared_origin.adopt_system(obj, context.scene, found)
            notes = shared_origin.place_terrain(obj, context.scene, found)
        else:
            notes = shared_origin.system_notes(obj, origin_of(context.scene), found)
        shared_origin.keep_ground(obj, shift, is_placed=follows)
        shared_origin.follow_store(obj)
        if not shared_origin.keep_scatter_corner(obj, before, found):
            notes += filter(None, [scatter_note(obj, before)])
        self.before = found  # for the next call of a quick import
        context.view_layer.update()
        self._show_in_viewports(context, obj, before)
        self._report_and_update(obj, report, notes)
        if self.baked not in ("", folder):
            self.report(
                {"WARNING"}, f"The terrain has its imported heights again; its baked land stays in {self.baked}"
            )
            self.baked = ""

    def _show_in_viewports(self, context, obj, before: imported.Imported | None) -> None:
        """Frame a terrain that is new, or whose size has changed by the factor RESIZED or more.

        One that has grown by less is framed only in viewports that showed all of it; others may be in use. before:
        facts of the earlier raster, None without one. self.before: those of the new raster by now.
        """
        size, size_before = _size_of(self.before), _size_of(before)
        viewports = frame_terrain.shown_viewports(context.window_manager, context.scene)
        box_before, self.box = self.box, frame_terrain.box_or_none(obj)
        if size and not (size_before and 1 / RESIZED < size / size_before < RESIZED):
            self._bring_into_view(context, obj, viewports)
            if follows_viewport(obj, context.scene):
                self.report({"INFO"}, "The mesh follows the viewports until you place a camera, as by Set Up Scene")
        elif size > size_before:
            self._bring_into_view(context, obj, frame_terrain.with_all_of(box_before, viewports))

    def _bring_into_view(self, context, obj, viewports: list[tuple]) -> None:
        """Show the terrain in those viewports that do not show all of it, extend clip ranges, and report the changes.

        viewports: (window, area, region, region_3d) of each.
        """
        try:
            done = frame_terrain.frame_terrain(obj, context.evaluated_depsgraph_get(), viewports, always=False)
        except TerrainError as error:
            self.report({"WARNING"}, str(error))
            return
        if done:
            self.report({"INFO"}, frame_terrain.to_sentence(done))

    def _report_and_update(self, obj, report: dict, placing: list[str]) -> None:
        """Report figures and warnings of an import, and update the mesh or let the live update do it.

        Warnings are last, because the status bar shows only the last message of an operator. An error of the update is
        a warning, too. report: of the import. placing: notes about the place of the terrain and its scatters.
        """
        if note := picture_note(imported.imported_of(obj.adaptive_terrain)):
            self.report({"INFO"}, note)
        self.report({"INFO"}, summary(report))
        notes = [*location_warnings(obj.adaptive_terrain.store), *neighbour_notes(obj, session.all_terrains())]
        notes += [note for note in [outdated_note(obj), unit_note(bpy.context.scene, obj.adaptive_terrain)] if note]
        notes += placing
        for warning in [*report["warnings"], *notes]:
            self.report({"WARNING"}, warning)
        try:
            live.show_soon(obj)
        except TerrainError as error:
            self.report({"WARNING"}, str(error))  # the import itself is done


class ImportTerrain(ImportOperator, bpy.types.Operator):
    """Read the height map into this terrain. You can go on working meanwhile"""

    bl_idname = "adaptive_terrain.import_source"
    bl_options = {"REGISTER", "UNDO"}


class ImportAdded(ImportOperator, bpy.types.Operator):
    """Import the land of the new terrain"""

    bl_idname = "adaptive_terrain.import_added"
    # What adds the terrain stays the last operation, for its panel is where one chooses another land or size. So this
    # is none, and no step for Undo either: adding is the step, and has no store yet, which is given back after it.
    bl_options = {"INTERNAL"}

    def invoke(self, context, event):
        """Open the tab for the first terrain of a scene before the end of the import frames the land next to it."""
        if session.terrains_of(context.scene) == [context.object]:
            sidebar.open_tab(frame_terrain.shown_viewports(context.window_manager, context.scene))
        return ImportOperator.invoke(self, context, event)

    def finish(self, context, obj, result: tuple[dict, str]) -> None:
        """Remember the store, too, because Undo goes back to a terrain without one."""
        _, _added[obj.session_uid] = result
        ImportOperator.finish(self, context, obj, result)


def resume_after_undo() -> None:
    """Schedule the repair of terrains that were being added when an undo or a redo came.

    A terrain that was removed during its import is imported again once it is back; one that lost its store gets it
    back.
    """
    if _gone or _added:
        bpy.app.timers.register(_resume_imports, first_interval=0.0)  # the handler of an undo may start no job


@allow_writing
def _resume_imports() -> None:
    """Import terrains again that are back after an undo (`_gone`), and give back lost stores; a timer calls it once.

    `_added` has the stores of terrains that were imported when added, since an undo may clear the property with their
    path.
    """
    for obj in session.all_terrains():
        if obj.session_uid in _gone:
            _gone.remove(obj.session_uid)
            window = bpy.context.window_manager.windows[0]
            with suppress(RuntimeError), bpy.context.temp_override(window=window, object=obj):  # the panel says why
                bpy.ops.adaptive_terrain.import_added("INVOKE_DEFAULT")
        elif obj.session_uid in _added and jobs.find(jobs.IMPORT, obj) is None and not obj.adaptive_terrain.store:
            _restore_store(obj)


def _restore_store(obj) -> None:
    """Set the store of a terrain again, with its custom properties, its camera's clip range and its mesh.

    Its place and the viewports are as Undo has left them.
    """
    obj.adaptive_terrain.store = stored_path(_added[obj.session_uid])
    imported.tag_object(obj)
    with suppress(TerrainError):  # the panel says why
        depsgraph = bpy.context.evaluated_depsgraph_get()
        frame_terrain.frame_terrain(obj, depsgraph, viewports=[], always=False)  # the camera's clip range alone
        if not obj.adaptive_terrain.live:
            session.update_object(obj)


def forget() -> None:
    """Forget the stores of terrains imported by Add, and the terrains that were removed during their import."""
    _gone.clear()
    _added.clear()
