# SPDX-License-Identifier: GPL-3.0-or-later
"""Add Tiles: further files for a terrain that was imported from files. The object and its settings stay."""

import os
from pathlib import Path

import bpy

from ...cbt_terrain.importing.source_list import INDEX_SUFFIXES
from ...cbt_terrain.rasters.source_formats import FORMATS
from .. import jobs
from ..bridge.scene_paths import absolute_path
from ..session.polls import cancelled_by_errors, remember_object, remembered_object
from ..terrain.properties import FILE
from .import_terrain import ImportOperator, start_import

FILTER = ";".join(f"*{suffix}" for suffix in (*FORMATS, *INDEX_SUFFIXES))


class ChosenFiles:
    """Properties of an operator for which a user chooses files or a folder, in the dialog or by dropping them."""

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE", "HIDDEN"})
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE", "HIDDEN"})
    filter_glob: bpy.props.StringProperty(default=FILTER, options={"HIDDEN"})

    def chosen(self) -> list[str]:
        """Return the paths of the chosen files; if `files` has none, that of `filepath` or the folder of the dialog.

        Without any of them the result is [""].
        """
        names = [item.name for item in self.files if item.name]
        return [os.path.join(self.directory, name) for name in names] if names else [self.filepath or self.directory]

    def draw_rules(self) -> None:
        """Draw how the chosen files form a terrain, in the file browser."""
        column = self.layout.column(align=True)
        column.label(text="Several files form one terrain", icon="INFO")
        column.label(text="No file chosen: the whole folder", icon="BLANK1")

    def invoke(self, context, _event):
        """Add the files that were dropped, or open a file browser in the .blend file's folder."""
        if self.filepath or len(self.files):  # dropped
            return self.execute(context)
        remember_object(self, context)
        if not self.directory and (beside := bpy.data.filepath):  # or the dialog proposes the name of the .blend file
            self.directory = str(Path(beside).parent)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}


class AddTiles(ChosenFiles, bpy.types.Operator):
    """Add height maps to this terrain, and import all of them as one. Later files cover earlier ones"""

    bl_idname = "adaptive_terrain.add_tiles"
    bl_label = "Add Tiles"
    bl_options = {"REGISTER"}  # ImportTiles makes the step for Undo, with the files and their store

    @classmethod
    def poll(cls, context):
        """Return whether the active object is a terrain from a file; otherwise set the reason that Blender shows."""
        obj = context.object
        settings = getattr(obj, "adaptive_terrain", None)
        cls.poll_message_set("Select a terrain whose source is a file")
        if not (settings is not None and settings.enabled and settings.source == FILE and settings.source_path):
            return False
        cls.poll_message_set(f"{jobs.IMPORT.title} is under way: wait for it, or cancel it beside its progress bar")
        return jobs.find(jobs.IMPORT, obj) is None

    def invoke(self, context, event):
        """Ask for files, beginning in the folder of those that the terrain has."""
        folder = Path(absolute_path(context.object.adaptive_terrain.source_path)).parent
        if not self.directory and os.path.isdir(folder):
            self.directory = str(folder)
        return ChosenFiles.invoke(self, context, event)

    def draw(self, _context):
        """Draw the rules of the file browser: there are no options."""
        self.draw_rules()

    @cancelled_by_errors
    def execute(self, context):
        """Import the terrain's files and the chosen ones as one, for the terrain whose button opened the dialog."""
        with remembered_object(self, context):
            return self._add(context.object.adaptive_terrain)

    def _add(self, settings):
        """Import the terrain's files and the new ones among the chosen as one; return Blender's result set.

        ImportTiles adds the new ones to the settings. It is cancelled with a report if none is new.
        """
        known = sources_of(settings)
        # Each new file once, at its last place, since later files cover earlier ones; reversed again below.
        new = {
            absolute_path(path): path for path in reversed(self.chosen()) if path and absolute_path(path) not in known
        }
        if not new:
            self.report({"ERROR"}, "No new file is chosen: choose height maps that the terrain does not have")
            return {"CANCELLED"}
        tiles = [{"name": path} for path in reversed(new.values())]
        return start_import(self, bpy.ops.adaptive_terrain.import_tiles, tiles=tiles)


class ImportTiles(ImportOperator, bpy.types.Operator):
    """Add files to those of the terrain and import all as one"""

    bl_idname = "adaptive_terrain.import_tiles"
    bl_label = AddTiles.bl_label
    bl_options = {"INTERNAL", "UNDO"}

    tiles: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE", "HIDDEN"})

    def steps(self, context, job: jobs.BackgroundJob) -> jobs.Steps:
        """Add the tiles to the terrain's settings and import; remove them again if that fails or is cancelled."""
        added = [tile.name for tile in self.tiles]
        for path in added:
            context.object.adaptive_terrain.more_sources.add().path = path
        try:
            return (yield from ImportOperator.steps(self, context, job))
        except BaseException:
            if (terrain := job.terrain()) is not None:
                sources = terrain.adaptive_terrain.more_sources
                for number in reversed(range(len(sources))):
                    if sources[number].path in added:
                        sources.remove(number)
            raise

    def finish(self, context, obj, result: tuple[dict, str]) -> None:
        """Also list the tiles again that an undo during the import has removed: the store has them."""
        sources = obj.adaptive_terrain.more_sources
        listed = {item.path for item in sources}
        for tile in self.tiles:
            if tile.name not in listed:
                sources.add().path = tile.name
        ImportOperator.finish(self, context, obj, result)


def sources_of(settings) -> list[str]:
    """Return the absolute paths of a terrain's sources."""
    return [absolute_path(path) for path in (settings.source_path, *(item.path for item in settings.more_sources))]


def name_of(paths: list[str]) -> str:
    """Return a name for a terrain of these files: that of the only one, else of their folder."""
    return Path(paths[0]).stem if len(paths) == 1 else Path(paths[0]).parent.name or Path(paths[0]).stem
