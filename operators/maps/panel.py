# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel *Maps*: effects baked into images."""

from .. import jobs
from ..session import session
from ..ui.panel_parts import TerrainSubpanel, draw_message, draw_switched
from .images import outdated_note
from .properties import CHOSEN


class MapsPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_maps"
    bl_label = "Maps"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_look"

    def draw(self, context):
        """Draw which maps are baked, how fine and where, and the button or the progress of baking."""
        column = self._columns()
        obj = session.shown_terrain(context)
        settings = obj.adaptive_terrain.maps
        column.row().prop(settings, "frames", expand=True)
        column.row().prop(settings, "which", expand=True)
        if settings.which == CHOSEN:
            grid = column.grid_flow(columns=2, align=True)
            grid.use_property_split = False
            grid.prop(settings, "chosen")
        draw_switched(column, settings, "use_budget", "budget_mb")
        column.row().prop(settings, "form", expand=True)
        column.prop(settings, "folder")
        job = jobs.find(jobs.BAKE)
        if job is None:
            column.operator("adaptive_terrain.bake_maps", icon="RENDER_STILL")
        else:
            jobs.draw_progress(column, job)
        if note := outdated_note(obj):
            draw_message(column, note, "INFO")
