# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel *Land*: the stack of height operators, its state, and its by-products.

The list and the rows below it have a fixed number: nothing moves while a user aims at it.
"""

import bpy
from bl_ui.utils import PresetPanel

from ...cbt_terrain.height_operators.catalogue import operator_of
from .. import jobs
from ..session import session
from ..text.numbers import length_text, time_text, unit_text
from ..text.translations import phrase
from ..ui.panel_parts import LIMITS, TerrainSubpanel, draw_band, draw_figures, draw_fixed_lines, show_terrain
from . import shaped_land
from . import stack as land_stack
from .presets import FOLDER, PRESET_PANEL, PRESETS, SHIPPED, SUFFIX, AddLandPreset, ApplyLandPreset, user_files
from .properties import BY_IMAGE, BY_OBJECT, BY_RULE, RULES

NAME_WIDTH = 0.7  # of a row of the list
ABOUT_LINES = NOTE_LINES = 3
ALWAYS = ("height", "slope")  # the rules that are shown though they are switched off


class LandList(bpy.types.UIList):
    """A row for each effect: a switch, its name, its time."""

    bl_idname = "ADAPTIVE_TERRAIN_UL_land"

    def draw_item(self, context, layout, _data, entry, _icon, _active_data, _active_name, index):
        """Draw the row of one entry: its switch, name, mask icon, and the time that it took."""
        row = layout.row(align=True)
        row.prop(entry, "on", text="", icon="CHECKBOX_HLT" if entry.on else "CHECKBOX_DEHLT", emboss=False)
        row = row.split(factor=NAME_WIDTH, align=True)
        left = row.row(align=True)
        left.active = entry.on
        known = operator_of(entry.effect) is not None
        left.prop(entry, "name", text="", emboss=False, icon="NONE" if known else "ERROR")
        if entry.mask.kind != "NONE":
            left.label(icon="MOD_MASK")
        took = row.row()
        took.alignment = "RIGHT"
        ms = shaped_land.state_of(session.shown_terrain(context)).ms
        took.label(text=shaping_time_text(ms, index))


def shaping_time_text(ms: dict[int, float | None], *numbers: int) -> str:
    """Return the time that entries took together, "Reused" if all their tiles were cached, "-" if unknown.

    ms: milliseconds by the number of the entry, None for a reused one, as in LandState. numbers: entries to add up.
    """
    times = [ms[number] for number in numbers if number in ms]
    if times and all(time is None for time in times):
        return phrase("Reused")
    return time_text(sum(time or 0.0 for time in times) if times else None)


class LandPresets(PresetPanel, bpy.types.Panel):
    """The presets of a land; the buttons act on the terrain that the panel shows."""

    bl_label = "Land Presets"
    preset_subdir = PRESETS

    def draw(self, context):
        """Draw the shipped presets in groups, then the user's: Blender would sort them all by their file names."""
        layout = self.layout
        show_terrain(layout, context)
        layout.emboss, layout.operator_context = "PULLDOWN_MENU", "EXEC_DEFAULT"
        for heading, group in SHIPPED.items():
            column = layout.column(align=True)
            column.label(text=heading)
            for name, (label, _tooltip) in group.items():
                column.operator(ApplyLandPreset.bl_idname, text=label).filepath = str(FOLDER / f"{name}{SUFFIX}")
            layout.separator()
        column = layout.column(align=True)
        for file in user_files():
            row, name = column.row(align=True), bpy.path.display_name(file.name, title_case=False)
            row.operator(ApplyLandPreset.bl_idname, text=name, translate=False).filepath = str(file)
            remove = row.operator(AddLandPreset.bl_idname, text="", icon="REMOVE")
            remove.name, remove.remove_name = name, True
        row = layout.row()
        name = row.row()
        name.emboss = "NORMAL"
        name.prop(context.window_manager, "preset_name", text="")
        row.operator(AddLandPreset.bl_idname, text="", icon="ADD").name = context.window_manager.preset_name


# Blender finds the panel by the name of its class.
LandPresets.__name__ = LandPresets.bl_idname = PRESET_PANEL


class AddLandMenu(bpy.types.Menu):
    """Effects on heights, with what each is"""

    bl_idname = "ADAPTIVE_TERRAIN_MT_land_add"
    bl_label = "Add Land Effect"

    def draw(self, _context):
        """Draw an entry for each effect, which adds it to the list."""
        self.layout.operator_enum("adaptive_terrain.land_add", "effect")


class LandPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_land"
    bl_label = "Land"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw_header_preset(self, _context):
        """Draw the menu of presets in the panel's header."""
        LandPresets.draw_panel_header(self.layout)

    def draw(self, context):
        """Draw the list with its buttons, the row that shapes the land, and three lines about the state."""
        obj = show_terrain(self.layout, context)
        land, state = obj.adaptive_terrain.land, shaped_land.state_of(obj)
        row = self.layout.row()
        row.template_list(LandList.bl_idname, "", land, "entries", land, "active", rows=6)
        buttons = row.column(align=True)
        buttons.menu(AddLandMenu.bl_idname, text="", icon="ADD")
        buttons.operator("adaptive_terrain.land_remove", text="", icon="REMOVE")
        buttons.separator()
        buttons.operator("adaptive_terrain.land_duplicate", text="", icon="DUPLICATE")
        buttons.separator()
        buttons.operator("adaptive_terrain.land_move", text="", icon="TRIA_UP").by = -1
        buttons.operator("adaptive_terrain.land_move", text="", icon="TRIA_DOWN").by = 1
        self._columns().prop(land, "where")  # full detail on the whole terrain or only in the shot
        _draw_shaping(self.layout.row(align=True), obj, state)
        box = self.layout.box().column(align=True)
        draw_figures(box, status_lines(state), factor=0.3)
        draw_fixed_lines(box, state.note, NOTE_LINES)


def _draw_shaping(row, obj, state) -> None:
    """Draw one row: a render's wait for this land, else the button Shape Now, else the progress of shaping.

    state: a LandState, `wanted` if the button would do anything. The progress of shaping has buttons that end it.
    """
    job, wait = jobs.find(jobs.SHAPE, obj), shaped_land.render_wait_of(obj)
    if wait is not None:
        row.progress(factor=wait.fraction, text=phrase("Render: {}", wait.brief))
        return
    if job is None:
        has_failed = state.active and bool(session.record_of(obj).status.error)
        row.enabled = has_work = state.wanted or has_failed
        text = _shape_button_text(obj) if has_work else "Shaped" if state.active else "Nothing to Shape"
        row.operator("adaptive_terrain.shape", text=text, icon="RNDCURVE" if has_work else "CHECKMARK")
        return
    row = jobs.draw_progress(row, job)
    row.operator("adaptive_terrain.shape_finish", text="", icon="CHECKMARK")


def _shape_button_text(obj) -> str:
    """Return the text of the button Shape Now, with the estimated seconds if they are known."""
    seconds = shaped_land.seconds_to_shape(obj)
    if seconds is None:
        return "Shape Now"
    rounded = f"{seconds:.1g}" if seconds < 10.0 else f"{5 * round(seconds / 5)}"  # it is only an estimate
    return phrase("Shape Now (about {} s)", rounded)


def status_lines(state) -> list[tuple[str, str]]:
    """Return three (name, value) lines about a LandState: always three, so that no row moves.

    Values: the shown data with the metres between samples, the number of built tiles, and the time of all entries.
    """
    tiles = phrase("{} of {}", *(f"{number:,}" for number in state.tiles)) if state.tiles else "-"
    shown = phrase(state.shown)
    shown = phrase("{}, {} apart", shown, length_text(state.step_m)) if state.step_m else shown
    all_entries = state.ms.keys()
    return [("Shown", shown), ("Tiles", tiles), ("Time", shaping_time_text(state.ms, *all_entries))]


class LandEffectPanel(TerrainSubpanel):
    """The chosen effect: its numbers, where it acts."""

    bl_idname = "ADAPTIVE_TERRAIN_PT_land_effect"
    bl_label = "Effect"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_land"
    bl_options = set()

    @classmethod
    def poll(cls, context):
        """Return whether the shown terrain's list has a chosen effect."""
        terrain = session.shown_terrain(context)
        return terrain is not None and 0 <= (land := terrain.adaptive_terrain.land).active < len(land.entries)

    def draw(self, context):
        """Draw the chosen entry: what its effect is, its parameters, seed and mask."""
        land = show_terrain(self.layout, context).adaptive_terrain.land
        entry = land.entries[land.active]
        effect = operator_of(entry.effect)
        if effect is None:
            draw_fixed_lines(self.layout.column(align=True), str(land_stack.unknown_operator(entry.effect)), 4)
            return
        draw_fixed_lines(self.layout.column(align=True), effect.about, ABOUT_LINES)
        column = self._columns()
        column.active = entry.on
        for parameter in effect.parameters:
            column.prop(getattr(entry, entry.effect), parameter.name)
        column.separator()
        column.prop(entry, "seed")
        _draw_mask(column, entry.mask)


def _draw_mask(column, mask) -> None:
    """Draw the settings of an entry's mask (a LandMask): of an image, an object or rules, whichever it uses.

    Rules are drawn if they are switched on or in ALWAYS; a menu adds others.
    """
    column.separator()
    column.prop(mask, "kind")
    if mask.kind == BY_IMAGE:
        column.prop(mask, "image")
    elif mask.kind == BY_OBJECT:
        column.prop(mask, "object")
    elif mask.kind == BY_RULE:
        for of in RULES:
            if of in ALWAYS or getattr(mask, of).use:
                draw_band(column, getattr(mask, of), LIMITS)
        draw_band(column, mask.aspect, ("direction", "within", "edge"))
        column.operator_menu_enum("adaptive_terrain.land_rule_add", "of", icon="ADD")
    if mask.kind != "NONE":
        column.prop(mask, "factor")


class LandLayersPanel(TerrainSubpanel):
    """Layers that the stack leaves, and the number of materials and nodes that read each."""

    bl_idname = "ADAPTIVE_TERRAIN_PT_land_layers"
    bl_label = "By-Products"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_land"

    def draw(self, context):
        """Draw a row for each layer: its name and unit, and the number of its readers."""
        # Of all attributes by name; layers are among them.
        statuses = session.record_of(session.shown_terrain(context)).status.effects
        column = self.layout.column(align=True)
        layers = shaped_land.layers_left_by(session.shown_terrain(context).adaptive_terrain.land)
        for layer in layers:
            row = column.split(factor=0.55)
            row.label(text=f"{layer.name} ({unit_text(layer.unit)})" if layer.unit else layer.name)
            row.label(text=_readers_text(statuses.get(layer.name)))
        if not layers:
            column.label(text="None", icon="INFO")


def _readers_text(status) -> str:
    """Return how many readers a layer has; the panel *Attributes* names them.

    status: of the layer's attribute in the last update, None if it was not part of one.
    """
    if status is None:
        return "No update yet"
    count = len(status.readers)
    if status.skipped:
        return phrase("Switched off") if count else phrase("No reader")
    return phrase("1 reader") if count == 1 else phrase("{} readers", count)


class LandOutputPanel(TerrainSubpanel):
    """The shaped land for other programs, or as a store that needs no stack."""

    bl_idname = "ADAPTIVE_TERRAIN_PT_land_output"
    bl_label = "Export and Cache"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_land"

    def draw(self, context):
        """Draw the buttons, or the progress of their jobs in the same rows."""
        column, terrain = self._columns(), session.shown_terrain(context)
        jobs.draw_button(column, jobs.BAKE_LAND, terrain, "adaptive_terrain.bake_land", icon="FILE_TICK")
        jobs.draw_button(column, jobs.EXPORT, terrain, "adaptive_terrain.export_heights", icon="EXPORT")
        column.operator("adaptive_terrain.land_clear", icon="TRASH")


PANELS = (LandPanel, LandEffectPanel, LandLayersPanel, LandOutputPanel)
