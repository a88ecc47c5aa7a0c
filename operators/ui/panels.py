# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "Terrain" in the sidebar of the 3D viewport."""

import bpy

from ...cbt_terrain.run import warmup
from ..accuracy import panel as statistics_panel
from ..attributes import panel as effects_panel
from ..ground import panel as ground_panel
from ..importing import panel as height_map_panel
from ..land import panel as land_panel
from ..layers import panel as layers_panel
from ..maps import panel as maps_panel
from ..overlay import panel as overlay_panel
from ..scatter import panel as scatter_panel
from ..session import session
from ..session.polls import LEFT_ALONE
from ..terrain import panel as detail_panel
from ..terrain.properties import CHOSEN_CAMERA
from .panel_parts import TerrainSubpanel, figures, message, show_terrain, switched
from .status_row import NO_VIEW, draw_preparation, draw_status, sight_notice


class TerrainPanel(bpy.types.Panel):
    """State of a terrain. The number of rows is fixed, so that the settings below never move."""

    bl_idname = "ADAPTIVE_TERRAIN_PT_main"
    bl_label = "Adaptive Terrain"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Terrain"

    def draw(self, context):
        layout = self.layout
        obj = show_terrain(layout, context)
        if obj is not None:
            row = layout.row(align=True)
            row.operator("adaptive_terrain.update", icon="FILE_REFRESH")
            row.operator("adaptive_terrain.frame", text="Frame", icon="ZOOM_SELECTED")
            row = layout.row()
            row.prop(obj.adaptive_terrain, "live")
            row.operator("adaptive_terrain.freeze", icon="FREEZE", depress=bool(obj.adaptive_terrain.frozen))
            box = layout.box().column(align=True)
            sees_nothing = sight_notice(context, obj)[0] in NO_VIEW
            figures(box, statistics_panel.summary_lines(session.record_of(obj).status, sees_nothing))
            draw_status(box, context, obj)
            layout.operator("adaptive_terrain.set_up_scene", icon="LIGHT_SUN")
            return
        obj = context.object
        if obj is not None and obj.type == "MESH" and obj.adaptive_terrain.enabled:
            message(layout, LEFT_ALONE, "LINKED")
        layout.operator("mesh.adaptive_terrain_add", text="Add Adaptive Terrain", icon="ADD")
        draw_preparation(layout)


def _waiting_row(layout):
    """Return a row for operators that need the kernels.

    It is greyed out while they are prepared, because they would block the window.
    """
    row = layout.row()
    row.enabled = not warmup.preparing()
    return row


class CameraPanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_camera"
    bl_label = "Camera"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        column = self._columns()
        settings = session.shown_terrain(context).adaptive_terrain
        column.prop(settings, "camera_source")
        if settings.camera_source == CHOSEN_CAMERA:
            column.prop(settings, "camera")


class MeshPanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_mesh"
    bl_label = "Mesh"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        column = self._columns()
        settings = session.shown_terrain(context).adaptive_terrain
        column.prop(settings, "smooth")
        cleanup = settings.cleanup
        switched(column, cleanup, "use_below", "below")
        column.prop(cleanup, "boundary")


class OutputPanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_output"
    bl_label = "Bake and Export"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        column = self._columns()
        column.prop(session.shown_terrain(context).adaptive_terrain, "bake_error_m")
        column.prop(session.shown_terrain(context).adaptive_terrain, "bake_fit")
        _waiting_row(column).operator("adaptive_terrain.bake", icon="MESH_GRID")
        column.separator()
        _waiting_row(column).operator("adaptive_terrain.export", icon="EXPORT")
        _waiting_row(column).operator("adaptive_terrain.export_tiles", icon="TEXTURE")
        _waiting_row(column).operator("adaptive_terrain.export_tileset", icon="WORLD")
        row = column.row(align=True)
        row.operator("adaptive_terrain.map_camera", icon="CAMERA_DATA")
        row.operator("adaptive_terrain.render_map", icon="RENDER_STILL")
        column.operator("adaptive_terrain.submit", icon="NETWORK_DRIVE")


CLASSES = (
    TerrainPanel,
    *height_map_panel.CLASSES,
    *land_panel.CLASSES,
    CameraPanel,
    *detail_panel.CLASSES,
    overlay_panel.OverlayPanel,
    MeshPanel,
    effects_panel.EffectsPanel,
    *layers_panel.CLASSES,
    *scatter_panel.CLASSES,
    maps_panel.MapsPanel,
    ground_panel.GroundPanel,
    OutputPanel,
    *statistics_panel.CLASSES,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
