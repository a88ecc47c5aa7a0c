# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel *Effects*: which effects are computed, their readers and costs, and why others are not.

Every effect has one row, computed or not, and one of them has its details in as many lines whatever they say: nothing
moves while someone aims at it.
"""

import bpy

from ...cbt_terrain.attributes.catalogue import ATTRIBUTES
from ...cbt_terrain.attributes.evaluate import MAX_BYTES
from .. import jobs
from ..maps.properties import label
from ..session import session
from ..text.effect_lines import cost_text, readers_text
from ..text.numbers import plain, time_text, unit_text
from ..ui.panel_parts import TerrainSubpanel, figures, fixed_lines, show_terrain
from .properties import is_number

NAME_WIDTH, COST_WIDTH = 0.58, 0.65  # fractions of a row, and of its rest
ABOUT_LINES, READER_LINES = 5, 4
_shown = next(iter(ATTRIBUTES))


class EffectsPanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_effects"
    bl_label = "Effects"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        obj = show_terrain(self.layout, context)
        status, settings = session.record_of(obj).status, obj.adaptive_terrain.effects
        statuses = status.effects
        self.layout.operator("adaptive_terrain.terrain_material", icon="MATERIAL")
        figures(self.layout.column(align=True), summary_lines(statuses, status.effects_bytes))
        rows = self.layout.column(align=True)
        for name in ATTRIBUTES:
            _draw_row(rows, settings, name, statuses.get(name))
        _draw_details(self.layout.box(), _shown, statuses.get(_shown))
        column = self._columns()
        column.prop(settings, "geometry_metres")
        for parameter in filter(is_number, ATTRIBUTES[_shown].parameters):
            column.prop(getattr(settings, _shown), parameter.name)


def _draw_row(rows, settings, name: str, status) -> None:
    computed = status is not None and not status.skipped
    row = rows.split(factor=NAME_WIDTH, align=True)
    left = row.row(align=True)
    left.alignment = "LEFT"
    icon = "RADIOBUT_ON" if computed else "RADIOBUT_OFF"
    left.operator("adaptive_terrain.show_effect", text=label(name), icon=icon, emboss=name == _shown).name = name
    right = row.split(factor=COST_WIDTH, align=True)
    cost = right.row()
    cost.active = computed
    cost.label(text=time_text(status.ms if computed else None))
    right.prop(getattr(settings, name), "when", text="", icon_only=True)


def _draw_details(box, name: str, status) -> None:
    column = box.column(align=True)
    fixed_lines(column, about_text(name), ABOUT_LINES)
    fixed_lines(column, readers_text(status), READER_LINES)
    column.label(text=cost_text(status))


def about_text(name: str) -> str:
    """`Slope (rad): how steep ...`; a share has no unit."""
    unit = ATTRIBUTES[name].unit
    return f"{label(name)}{f' ({unit_text(unit)})' if unit not in ('', '1') else ''}: {ATTRIBUTES[name].about}"


def summary_lines(statuses, nbytes: int) -> list[tuple[str, str]]:
    """Return the three lines above the list. `nbytes`: memory that the effects hold, see MAX_BYTES."""
    computed = [status for status in statuses.values() if not status.skipped]
    ms, megabytes = sum(status.ms for status in computed), sum(status.nbytes for status in computed) / 1e6
    return [
        ("Computed", f"{len(computed)} of {len(ATTRIBUTES)}"),
        ("Cost", f"{plain(ms)} ms, {plain(megabytes)} MB"),
        ("Held", f"{plain(nbytes / 1e6)} of {plain(MAX_BYTES / 1e6)} MB"),
    ]


class ShowEffect(bpy.types.Operator):
    """Show the readers of this effect, its cost and its settings"""

    bl_idname = "adaptive_terrain.show_effect"
    bl_label = "Show Effect"
    bl_options = {"INTERNAL"}

    name: bpy.props.StringProperty(name="Effect")

    def execute(self, context):
        global _shown
        if self.name not in ATTRIBUTES:
            self.report({"ERROR"}, f"There is no effect {self.name!r}; expected one of {', '.join(ATTRIBUTES)}.")
            return {"CANCELLED"}
        _shown = self.name
        jobs.redraw_panels()
        return {"FINISHED"}


register, unregister = bpy.utils.register_classes_factory((ShowEffect,))
