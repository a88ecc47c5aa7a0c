# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "Terrain" in the sidebar of the 3D viewport, and the same panels in the Properties editor."""

from .. import jobs
from ..accuracy import panel as statistics_panel
from ..attributes import panel as effects_panel
from ..ground import panel as ground_panel
from ..importing import panel as height_map_panel
from ..land import panel as land_panel
from ..land import water_surface
from ..layers import panel as layers_panel
from ..maps import panel as maps_panel
from ..overlay import panel as overlay_panel
from ..scatter import panel as scatter_panel
from ..session import live, session
from ..session.polls import LEFT_ALONE
from ..terrain import panel as detail_panel
from ..terrain.camera_source import follows_viewport
from ..terrain.properties import CHOSEN_CAMERA, SCENE_CAMERA
from ..text.translations import phrase
from .panel_parts import (
    TerrainSubpanel,
    draw_figures,
    draw_message,
    draw_switched,
    panels_of,
    show_terrain,
    split_column,
)
from .status_row import draw_preparation, draw_status, has_view


class TerrainPanel:
    """The rows that every scene needs. Their number is fixed, so that nothing moves; the rest is in sub-panels."""

    bl_idname = "ADAPTIVE_TERRAIN_PT_main"
    bl_label = "Adaptive Terrain"

    @classmethod
    def poll(cls, context):
        """Show the panel for a terrain, and in the sidebar always: there it offers to add one."""
        obj = context.object
        in_properties = getattr(cls, "bl_space_type", "") == "PROPERTIES"
        return not in_properties or obj is not None and obj.adaptive_terrain.enabled

    def draw(self, context):
        """Draw the main rows: update, state, source, errors and the buttons for the look; without a terrain,
        how to add one.
        """
        layout = self.layout
        obj = show_terrain(layout, context)
        if obj is None:
            _draw_without_terrain(layout, context.object)
            return
        settings = obj.adaptive_terrain
        # Always enabled: Blender keeps a button under the mouse disabled until the mouse leaves it, as after Add.
        row = layout.row(align=True)
        row.operator("adaptive_terrain.update", icon="FILE_REFRESH")
        row.operator("adaptive_terrain.frame", text="Frame", icon="ZOOM_SELECTED")
        row.prop(settings, "live", text="Live", toggle=True)
        _draw_state(layout.box().column(align=True), context, obj)
        height_map_panel.draw_source(split_column(layout), obj)
        detail_panel.draw_errors(split_column(layout), settings)
        buttons = layout.column()
        buttons.enabled = bool(settings.store)
        buttons.operator("adaptive_terrain.set_up_scene", icon="LIGHT_SUN")
        buttons.operator("adaptive_terrain.terrain_material", icon="MATERIAL")
        water_surface.draw_button(buttons, obj)
        buttons.operator_menu_enum("adaptive_terrain.scatter_add", "kind", icon="OUTLINER_OB_POINTCLOUD")


def _draw_without_terrain(layout, obj) -> None:
    """Draw the buttons that add a terrain; for a linked terrain, why it cannot be changed.

    obj: the active object or None.
    """
    if obj is not None and obj.type == "MESH" and obj.adaptive_terrain.enabled:
        draw_message(layout, LEFT_ALONE, "LINKED")
    layout.operator("mesh.adaptive_terrain_add", text="Add Adaptive Terrain", icon="ADD")
    layout.operator("mesh.adaptive_terrain_from_file", icon="FILE_IMAGE")
    draw_preparation(layout)


def _figures_of(context, obj) -> list[tuple[str, str]]:
    """Return three (name, value) rows about the last update: triangles, error bound and time.

    A bound of 0 px is replaced by a word while no view shows the terrain or an update is due.
    """
    status = session.record_of(obj).status
    return statistics_panel.summary_lines(status, not has_view(context, obj), live.is_behind())


def _draw_state(box, context, obj) -> None:
    """Draw two rows: the state, and the triangles and the error of the last update."""
    state, figures = box.row(), box.row()
    (_, triangles), (_, bound), _ = _figures_of(context, obj)
    bound = phrase("error {}", bound) if bound.startswith("≤") else phrase(bound)
    mode = session.record_of(obj).status.mode  # "" before the first update
    figures.label(text=phrase("{} triangles, {}", triangles, bound) if mode else "", icon="BLANK1")
    draw_status(state, context, obj, below=figures)


class LookPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_look"
    bl_label = "Look"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, _context):
        """Draw nothing: the sub-panels have the rows."""


class AdvancedPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_advanced"
    bl_label = "Advanced"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        """Draw the figures of the last update and the button that freezes the triangles."""
        obj = session.shown_terrain(context)
        column = self._columns()
        draw_figures(column.box().column(align=True), _figures_of(context, obj))
        column.operator("adaptive_terrain.freeze", icon="FREEZE", depress=bool(obj.adaptive_terrain.frozen))


class CameraPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_camera"
    bl_label = "Camera"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_advanced"

    def draw(self, context):
        """Draw the setting of the camera that the detail follows, the object if one is chosen, and a note if viewports
        replace the scene's camera.
        """
        column = self._columns()
        terrain = session.shown_terrain(context)
        settings = terrain.adaptive_terrain
        column.prop(settings, "camera_source")
        if settings.camera_source == SCENE_CAMERA and follows_viewport(terrain, context.scene):
            column.label(text="Follows viewports: no camera placed", icon="INFO")
        if settings.camera_source == CHOSEN_CAMERA:
            column.prop(settings, "camera")


class MeshPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_mesh"
    bl_label = "Mesh"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_advanced"

    def draw(self, context):
        """Draw the settings of the finished mesh: smooth shading and the parts that are cut away."""
        column = self._columns()
        settings = session.shown_terrain(context).adaptive_terrain
        column.prop(settings, "smooth")
        cleanup = settings.cleanup
        draw_switched(column, cleanup, "use_below", "below")
        column.prop(cleanup, "boundary")


class OutputPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_output"
    bl_label = "Bake and Export"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        """Draw the buttons that bake, export, render maps and submit to a farm."""
        column = self._columns()
        column.prop(session.shown_terrain(context).adaptive_terrain, "bake_error_m")
        column.prop(session.shown_terrain(context).adaptive_terrain, "bake_fit")
        column.operator("adaptive_terrain.bake", icon="MESH_GRID")
        column.separator()
        column.operator("adaptive_terrain.export", icon="EXPORT")
        terrain = session.shown_terrain(context)
        jobs.draw_button(column, jobs.EXPORT, terrain, "adaptive_terrain.export_tiles", icon="TEXTURE")
        column.operator("adaptive_terrain.export_tileset", icon="WORLD")
        row = column.row(align=True)
        if (job := jobs.find(jobs.MAP)) is not None:
            jobs.draw_progress(row, job)
        else:
            row.operator("adaptive_terrain.map_camera", icon="CAMERA_DATA")
            row.operator("adaptive_terrain.render_map", icon="RENDER_STILL")
        jobs.draw_button(column, jobs.SUBMIT, terrain, "adaptive_terrain.submit", icon="NETWORK_DRIVE")


PANELS = (
    TerrainPanel,
    *height_map_panel.SOURCE_PANELS,
    LookPanel,
    layers_panel.LayersPanel,
    *height_map_panel.SURFACE_PANELS,
    maps_panel.MapsPanel,
    *land_panel.PANELS,
    *scatter_panel.PANELS,
    ground_panel.GroundPanel,
    OutputPanel,
    AdvancedPanel,
    CameraPanel,
    *detail_panel.PANELS,
    MeshPanel,
    overlay_panel.OverlayPanel,
    effects_panel.EffectsPanel,
    *statistics_panel.PANELS,
)
CLASSES = panels_of(PANELS)
