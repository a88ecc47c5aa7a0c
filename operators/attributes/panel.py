# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel *Attributes*: which attributes are computed, their readers and costs, and why others are not.

The list has one row for each, computed or not, and the details of the chosen one have a fixed number of lines, so that
nothing moves.
"""

import bpy

from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
from ..maps.properties import title_of
from ..session import session
from ..text.effect_lines import cost_text, readers_text
from ..text.numbers import plain, time_text, unit_text
from ..text.translations import phrase
from ..ui.panel_parts import TerrainSubpanel, draw_figures, draw_fixed_lines, show_terrain
from .properties import is_number

NAME_WIDTH, COST_WIDTH = 0.62, 0.68  # fractions of a row, and of its rest
ABOUT_LINES, READER_LINES = 5, 4
LIST_ROWS = 6


class AttributeList(bpy.types.UIList):
    """A row for each attribute: whether it is computed, its name, its time, and when it is computed."""

    bl_idname = "ADAPTIVE_TERRAIN_UL_attributes"

    def draw_item(self, context, layout, settings, item, _icon, _active_data, _active_name):
        """Draw the row of one attribute: whether it is computed, its name, its time and when it is computed."""
        name = item.identifier
        status = session.record_of(session.shown_terrain(context)).status.effects.get(name)
        computed = status is not None and not status.skipped
        row = layout.split(factor=NAME_WIDTH, align=True)
        row.label(text=title_of(name), icon="RADIOBUT_ON" if computed else "RADIOBUT_OFF")
        right = row.split(factor=COST_WIDTH, align=True)
        cost = right.row()
        cost.active = computed
        cost.label(text=time_text(status.ms if computed else None))
        terrain = session.shown_terrain(context)
        right.prop(getattr(terrain.adaptive_terrain.effects, name), "when", text="", icon_only=True, emboss=False)

    def filter_items(self, _context, struct, _name):
        """Show the members that are attributes, and of those the ones whose title contains the text of the filter.

        Return Blender's flags by row, and [] to keep the order. struct: RNA of the settings, whose properties are the
        rows.
        """
        sought = self.filter_name.lower()
        names = [item.identifier for item in struct.properties]
        shown = [name in ATTRIBUTES and sought in title_of(name).lower() for name in names]
        return [self.bitflag_filter_item if is_shown else 0 for is_shown in shown], []


class EffectsPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_effects"
    bl_label = "Attributes"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_advanced"

    def draw(self, context):
        """Draw the list of attributes with their total cost, and details and settings of the chosen one."""
        obj = show_terrain(self.layout, context)
        status, settings = session.record_of(obj).status, obj.adaptive_terrain.effects
        draw_figures(self.layout.column(align=True), summary_lines(status.effects, status.effects_bytes))
        members = settings.bl_rna  # the items of the list are its properties, one for each attribute among them
        self.layout.template_list(
            AttributeList.bl_idname, "", members, "properties", settings, "active", rows=LIST_ROWS, maxrows=LIST_ROWS
        )
        name = chosen_attribute(settings)
        _draw_details(self.layout.box(), name, status.effects.get(name))
        column = self._columns()
        column.prop(settings, "geometry_metres")
        for parameter in filter(is_number, ATTRIBUTES[name].parameters):
            column.prop(getattr(settings, name), parameter.name)


def chosen_attribute(settings) -> str:
    """Return the name of the attribute that is chosen in the list, or of the first one if the row is of none."""
    names = settings.bl_rna.properties.keys()
    chosen = names[settings.active] if settings.active < len(names) else ""
    return chosen if chosen in ATTRIBUTES else next(iter(ATTRIBUTES))


def _draw_details(box, name: str, status) -> None:
    """Draw description, readers and cost of an attribute in a fixed number of lines.

    status: EffectStatus, None before an update.
    """
    column = box.column(align=True)
    draw_fixed_lines(column, about_text(name), ABOUT_LINES)
    draw_fixed_lines(column, readers_text(status, phrase), READER_LINES)
    column.label(text=cost_text(status, phrase))


def about_text(name: str) -> str:
    """Return an attribute's translated title, its unit if any, and its description: `Slope (rad): how steep ...`."""
    unit = ATTRIBUTES[name].unit
    return (
        f"{phrase(title_of(name))}{f' ({unit_text(unit)})' if unit not in ('', '1') else ''}: {ATTRIBUTES[name].about}"
    )


def summary_lines(statuses, nbytes: int) -> list[tuple[str, str]]:
    """Return three (name, value) rows: number of computed attributes, their cost, and the memory that they hold.

    statuses: an EffectStatus by name; the cost includes the bytes of the values. nbytes: memory of all attributes,
    including their cache for the next update.
    """
    computed = [status for status in statuses.values() if not status.skipped]
    ms, megabytes = sum(status.ms for status in computed), sum(status.nbytes for status in computed) / 1e6
    return [
        ("Computed", phrase("{} of {}", len(computed), len(ATTRIBUTES))),
        ("Cost", f"{plain(ms)} ms, {plain(megabytes)} MB"),
        ("Held", f"{plain(nbytes / 1e6)} MB"),
    ]
