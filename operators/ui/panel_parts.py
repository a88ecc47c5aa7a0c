# SPDX-License-Identifier: GPL-3.0-or-later
"""Parts that the panels of the tab "Terrain" share."""

import bpy

from ..session import session

LINE_LENGTH = 36  # characters of a line in a narrow panel
LIMITS = ("low", "high", "edge")  # the numbers of a band, for draw_band


SIDEBAR = {"bl_space_type": "VIEW_3D", "bl_region_type": "UI", "bl_category": "Terrain"}
PROPERTIES = {"bl_space_type": "PROPERTIES", "bl_region_type": "WINDOW", "bl_context": "object"}
SUFFIX = "_properties"  # of the names of the panels in the Properties editor


def panels_of(classes) -> list[type]:
    """Return Blender's panels for plain classes: those of the sidebar, then the same ones of the Properties editor.

    A class is a panel or a sub-panel without `bpy.types.Panel`, because Blender cannot register one for two editors.
    """
    found = []
    for editor, suffix in ((SIDEBAR, ""), (PROPERTIES, SUFFIX)):
        for cls in classes:
            names = {key: getattr(cls, key) + suffix for key in ("bl_idname", "bl_parent_id") if hasattr(cls, key)}
            found.append(type(f"{cls.__name__}{suffix}", (cls, bpy.types.Panel), names | editor))
    return found


class TerrainSubpanel:
    """Base of the panels below the first: shown for a terrain only, and closed at first."""

    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        """Return whether there is a terrain for the panel to show."""
        return session.shown_terrain(context) is not None

    def _columns(self):
        """Return a column for the panel's settings, whose buttons act on the shown terrain."""
        show_terrain(self.layout, bpy.context)
        return split_column(self.layout)


def split_column(layout):
    """Return a new column of a layout whose properties have their names on the left and no button for keyframes."""
    column = layout.column()
    column.use_property_split, column.use_property_decorate = True, False
    return column


def show_terrain(layout, context):
    """Make a layout's buttons act on the terrain that panels show, whatever object is active; return the terrain."""
    terrain = session.shown_terrain(context)
    if terrain is not None and terrain != context.object:
        layout.context_pointer_set("object", terrain)
    return terrain


def draw_switched(column, settings, switch: str, name: str) -> None:
    """Draw a check box, and below it a setting if the box is checked.

    switch, name: names of the two properties of `settings`.
    """
    column.prop(settings, switch)
    if getattr(settings, switch):
        column.prop(settings, name)


def draw_band(column, band, names: tuple[str, ...]) -> None:
    """Draw the switch of a rule, and its numbers below it if it is on.

    band: the rule's property group, with the switch `use`. names: its properties to draw.
    """
    column.row(heading=band.bl_rna.properties["use"].name).prop(band, "use", text="")
    if band.use:
        numbers = column.column(align=True)
        for name in names:
            numbers.prop(band, name)


def draw_ground(column, ground) -> None:
    """Draw the settings of a displacement: those of an image, or of noise."""
    column.prop(ground, "amplitude")
    column = column.column()
    column.active = ground.amplitude > 0.0
    column.prop(ground, "image")
    for name in ("tile",) if ground.image is not None else ("wavelength", "roughness", "seed"):
        column.prop(ground, name)


def draw_figures(column, lines: list[tuple[str, ...]], factor: float = 0.5) -> None:
    """Draw rows of a name and one or more values.

    factor: fraction of the width for the names.
    """
    for name, *values in lines:
        row = column.split(factor=factor)
        row.label(text=name)
        right = row.row()
        for value in values:
            right.label(text=value)


def draw_message(layout, text: str, icon: str) -> None:
    """Draw a sentence in a box, wrapped; red if `icon` is "ERROR"."""
    box = layout.box()
    box.alert = icon == "ERROR"
    column = box.column(align=True)  # lines of one text without the space between rows; alert like the box
    for number, line in enumerate(wrap_words(text, LINE_LENGTH)):
        column.label(text=line, icon=icon if number == 0 else "NONE")


def error_lines(status: session.Status) -> list[tuple[str, str]]:
    """Return (text, icon) lines for the error of a terrain's last update: the problem, and the fix if it is known.

    [] without an error. An error of a job, which has set `status.error` alone, has no separate fix.
    """
    failure = status.failure
    if failure is None or str(failure) != status.error or not failure.fix:
        return [(status.error, "ERROR")] if status.error else []
    return [(failure.problem, "ERROR"), (f"{failure.fix[0].upper()}{failure.fix[1:]}.", "FORWARD")]


def draw_fixed_lines(column, text: str, count: int) -> None:
    """Draw a sentence in exactly `count` lines, so that rows below do not move; a longer one is cut."""
    lines = wrap_words(text, LINE_LENGTH)
    if len(lines) > count:
        lines[count - 1] += " ..."
    for line in (lines + [""] * count)[:count]:
        column.label(text=line)


def wrap_words(text: str, width: int) -> list[str]:
    """Return the text in lines of at most `width` characters, broken between words; a longer word gets its own line.

    The result is [""] for a text without words.
    """
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines
