# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel *Maps*: effects baked into images."""

import bpy

from ..effects import bake_maps
from ..properties.map_properties import CHOSEN
from .panel_parts import TerrainSubpanel, switched


class MapsPanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_maps"
    bl_label = "Maps"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        column = self._columns()
        settings = context.object.adaptive_terrain.maps
        column.row().prop(settings, "frames", expand=True)
        column.row().prop(settings, "which", expand=True)
        if settings.which == CHOSEN:
            grid = column.grid_flow(columns=2, align=True)
            grid.use_property_split = False
            grid.prop(settings, "chosen")
        switched(column, settings, "use_budget", "budget_mb")
        column.row().prop(settings, "form", expand=True)
        column.prop(settings, "folder")
        row = column.row(align=True)
        under_way = bake_maps.progress()
        if under_way is None:
            row.operator("adaptive_terrain.bake_maps", icon="RENDER_STILL")
        else:
            row.progress(factor=under_way[0], text=under_way[1])
            row.operator("adaptive_terrain.cancel_maps", text="", icon="CANCEL")
