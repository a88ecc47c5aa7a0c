# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels of the height map: the import's options, the imported store, and its surface in the scene."""

from pathlib import PurePath

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.rasters.source_formats import BAND, CELL, CHANNEL, ENCODING, RAW
from ..bridge.scene_origin import origin_of
from ..session import session
from ..terrain.properties import FILE
from ..text.translations import phrase
from ..ui.panel_parts import TerrainSubpanel, draw_figures, draw_ground, draw_message, draw_switched
from . import import_terrain, store_paths
from .import_terrain import has_option
from .imported import changed_settings, filled_note, imported_of, info_lines, loaded_text
from .placement_notes import picture_note
from .shared_origin import system_notes

SHOWN_FILES = 4
PATH_FACTOR, LONGEST_NAME = 0.5, 16  # of a row with a path: the part of the width for the name, and its characters


def draw_source(column, obj) -> None:
    """Draw the source, its file or its seed, further files, and the button that imports it.

    The button says that settings have changed, or that a quick import is to be completed.
    """
    settings = obj.adaptive_terrain
    column.prop(settings, "source")
    if settings.source == FILE:
        _draw_path(column, settings, "source_path")
    else:
        column.prop(settings, "seed")
    if settings.source == FILE and len(settings.more_sources):
        _draw_more(column, settings)
    again = is_stale(obj)
    text = "Import Again: settings changed" if again else "Load All" if loaded_text(settings) else "Import"
    column.operator("adaptive_terrain.import_source", text=text, icon="FILE_REFRESH" if again else "IMPORT")


def _draw_more(column, settings) -> None:
    """Draw the further files; of many only the last SHOWN_FILES, below a line with the number of files."""
    count = len(settings.more_sources)
    hidden = count - SHOWN_FILES if count > SHOWN_FILES + 1 else 0  # a single hidden file would fit into that line
    if hidden:
        column.label(text=phrase("{} files, {} not listed", count + 1, hidden))
    for item in settings.more_sources[hidden:]:
        _draw_path(column, item, "path")


def _draw_path(column, owner, name: str) -> None:
    """Draw a path with its file's name as the label: the field itself shows only the beginning of a long path.

    owner: property group. name: of its property.
    """
    file = PurePath(getattr(owner, name)).name
    row = column.split(factor=PATH_FACTOR)
    left = row.row()
    left.alignment = "RIGHT"
    left.label(
        text=f"...{file[-LONGEST_NAME:]}" if len(file) > LONGEST_NAME else file or phrase("File"), translate=False
    )
    row.prop(owner, name, text="")


class SourcePanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_source"
    bl_label = "Import Options"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        """Draw the options of an import, those that the kind of source has."""
        column = self._columns()
        settings = session.shown_terrain(context).adaptive_terrain
        several = settings.source == FILE and import_terrain.has_several_files(settings)
        if settings.source == FILE:
            row = column.row(align=True)
            row.operator("adaptive_terrain.add_tiles", icon="ADD")
            row.operator("adaptive_terrain.join", icon="AUTOMERGE_ON")
            if import_terrain.may_hold_several(settings):
                for name in ("priority", "blend", "sample_step"):
                    column.prop(settings, name)
            (_draw_mosaic if several else _draw_file)(column, settings)
            draw_switched(column, settings, "use_no_data", "no_data")
            column.prop(settings, "holes")
        else:
            column.prop(settings, "island_size")
        # An import of several files refuses an extent: it is shown only so that it can be switched off.
        if not several or settings.use_extent:
            draw_switched(column, settings, "use_extent", "extent")
        _draw_heights(column, settings)


def _draw_heights(column, settings) -> None:
    """Draw the lowest and the highest height if a file is to get them, otherwise scale and offset."""
    if settings.source == FILE:
        column.prop(settings, "use_heights")
    is_range = settings.source == FILE and settings.use_heights
    for name in ("lowest", "highest") if is_range else ("height_scale", "height_offset"):
        column.prop(settings, name)


def is_stale(obj) -> bool:
    """Return whether import settings have changed since the last import, so that the panel offers another.

    True too if an imported terrain has no file chosen any more; False before the first import.
    """
    imported = imported_of(obj.adaptive_terrain)
    try:
        return imported is not None and bool(changed_settings(import_terrain.settings_of(obj), imported))
    except TerrainError:  # no file is chosen
        return True


def _draw_file(column, settings) -> None:
    """Draw the options of one file: those that its format has."""
    if has_option(settings.source_path, RAW):
        column.prop(settings, "raw_size")
        column.prop(settings, "raw_dtype")
        column.prop(settings, "raw_little_endian")
    for name in (CHANNEL, CELL, BAND, ENCODING):
        if has_option(settings.source_path, name):
            column.prop(settings, name)
    column.prop(settings, "first_row_south")
    if has_option(settings.source_path, BAND):
        column.prop(settings, "project")


def _draw_mosaic(column, settings) -> None:
    """Draw the options of several files that one file has, too."""
    for name in ("band", "encoding", "cell", "project"):
        column.prop(settings, name)


class ImportedPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_imported"
    bl_label = "Imported"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        """Draw the figures of the imported store, its path, and notes about it."""
        column = self._columns()
        terrain = session.shown_terrain(context)
        settings, imported = terrain.adaptive_terrain, imported_of(terrain.adaptive_terrain)
        draw_figures(column, info_lines(imported), factor=0.28)
        column.separator()
        column.prop(settings, "store")
        column.operator("adaptive_terrain.pack_store", icon="PACKAGE")
        for notice in store_paths.notices.values():
            draw_message(self.layout, notice, "INFO")
        if imported is None:
            return
        placing = system_notes(terrain, origin_of(context.scene), imported)
        notes = loaded_text(settings), *placing, *imported.warnings, filled_note(imported), picture_note(imported)
        for text in filter(None, notes):
            draw_message(column, text, "INFO")


class SurfacePanel(TerrainSubpanel):
    """What acts at once, without another import."""

    bl_idname = "ADAPTIVE_TERRAIN_PT_surface"
    bl_label = "Surface"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_look"

    def draw(self, context):
        """Draw the settings of the surface that take effect without another import."""
        column = self._columns()
        settings = session.shown_terrain(context).adaptive_terrain
        column.prop(settings, "vertical_scale")
        column.prop(settings, "vertical_offset")
        column.prop(settings, "interpolation")


class DisplacementPanel(TerrainSubpanel):
    """Relief finer than the height map."""

    bl_idname = "ADAPTIVE_TERRAIN_PT_ground"
    bl_label = "Displacement"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_surface"

    def draw(self, context):
        """Draw the settings of relief below the height map's cells."""
        draw_ground(self._columns(), session.shown_terrain(context).adaptive_terrain.ground)


SOURCE_PANELS = (SourcePanel, ImportedPanel)
SURFACE_PANELS = (SurfacePanel, DisplacementPanel)
