# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "Terrain" in the sidebar of the 3D viewport."""

import bpy

from ..cbt_terrain import warmup
from ..cbt_terrain.cost_curve import CostCurve
from ..cbt_terrain.criterion import unit_asked
from ..cbt_terrain.errors import TerrainError
from . import import_terrain, overlay_panel, session, statistics_panel
from .panel_parts import TerrainSubpanel, message, switched
from .properties import CHOSEN_CAMERA, FILE
from .request import criterion_from, within_time

ROUNDED = 1e-3  # part by which an error, rounded up to four digits, may cost less than its budget


class TerrainPanel(bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_main"
    bl_label = "Adaptive Terrain"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Terrain"

    def draw(self, context):
        layout = self.layout
        obj = context.object
        if obj is not None and session.is_terrain(obj):
            layout.operator("adaptive_terrain.update", icon="FILE_REFRESH")
            layout.prop(obj.adaptive_terrain, "live")
            _draw_preparation(layout)
            draw_warnings(layout, context, obj)
            return
        if obj is not None and obj.type == "MESH" and obj.adaptive_terrain.enabled:
            layout.label(text="Linked from a library: left alone", icon="LINKED")
        layout.operator("mesh.adaptive_terrain_add", text="Add Adaptive Terrain", icon="ADD")
        _draw_preparation(layout)


def _draw_preparation(layout) -> None:
    fraction = warmup.progress()
    if fraction is not None:
        layout.progress(factor=fraction, text="Preparing kernels (first start only)")


def _waiting_row(layout):
    """A row for what needs the kernels now: greyed out while they are prepared, because it would hold up the window."""
    row = layout.row()
    row.enabled = not warmup.preparing()
    return row


def draw_warnings(layout, context, obj) -> None:
    status = session.record_of(obj).status
    if status.error:
        message(layout, status.error, "ERROR")
    if not context.scene.render.use_lock_interface:
        box = layout.box()
        box.label(text="A render may crash the viewport", icon="ERROR")
        box.operator("adaptive_terrain.lock_interface", icon="LOCKED")


class SourcePanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_source"
    bl_label = "Height Map"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        column = self._columns()
        obj = context.object
        settings = obj.adaptive_terrain
        column.prop(settings, "source")
        if settings.source == FILE:
            self._draw_file(column, settings)
        else:
            column.prop(settings, "island_size")
            column.prop(settings, "seed")
        switched(column, settings, "use_extent", "extent")
        column.prop(settings, "height_scale")
        column.prop(settings, "height_offset")
        progress = import_terrain.progress_of(obj)
        if progress is None:
            column.operator("adaptive_terrain.import_source", icon="IMPORT")
        else:
            row = column.row(align=True)
            row.progress(factor=progress[0], text=progress[1])
            row.operator("adaptive_terrain.cancel_import", text="", icon="CANCEL")
        column.prop(settings, "store")
        column.prop(settings, "interpolation")
        column.prop(settings, "vertical_scale")
        column.prop(settings, "vertical_offset")

    def _draw_file(self, column, settings):
        column.prop(settings, "source_path")
        if import_terrain.is_raw(settings.source_path):
            column.prop(settings, "raw_size")
            column.prop(settings, "raw_dtype")
            column.prop(settings, "raw_little_endian")
        elif settings.source_path.lower().endswith(".exr"):
            column.prop(settings, "channel")
        else:
            column.prop(settings, "band")
        column.prop(settings, "first_row_south")
        if import_terrain.placed(settings.source_path):
            column.prop(settings, "project")
        switched(column, settings, "use_no_data", "no_data")


class CameraPanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_camera"
    bl_label = "Camera"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        column = self._columns()
        settings = context.object.adaptive_terrain
        column.prop(settings, "camera_source")
        if settings.camera_source == CHOSEN_CAMERA:
            column.prop(settings, "camera")


def _draw_detail(column, detail) -> None:
    column.prop(detail, "error_px")
    column.prop(detail, "edge_px")
    column.prop(detail, "area_px", text="Area (px²)")
    column.prop(detail, "error_m")
    column.separator()
    column.prop(detail, "guard_deg", text="Guard (°)")
    column.prop(detail, "off_screen_factor")
    column.prop(detail, "meshlet")
    column.separator()
    switched(column, detail, "limit_depth", "max_depth")
    switched(column, detail, "limit_triangles", "max_triangles")
    switched(column, detail, "limit_time", "max_ms")
    if detail.limit_time:
        _draw_budget(column, detail)


def _draw_budget(column, detail) -> None:
    """The error that fits the time, or why none is known."""
    try:
        criterion, note = within_time(criterion_from(detail), detail)
    except TerrainError as error:  # every criterion is off
        note = str(error)
    if note:
        message(column, note, "INFO")
        return
    unit, curve = unit_asked(criterion), CostCurve.from_json(detail.curve)
    error = getattr(criterion, f"error_{unit}")
    fits = curve.at(error)[1] <= detail.max_ms * (1 + ROUNDED)
    column.label(text=f"{'Finest error that fits' if fits else 'None fits; coarsest error'}: {error:.4g} {unit}")
    if not curve.error[-1] <= error <= curve.error[0]:
        column.label(text="Beyond what was measured", icon="INFO")


class ViewportPanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_viewport"
    bl_label = "Detail in Viewport"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        _draw_detail(self._columns(), context.object.adaptive_terrain.viewport)


class RenderPanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_render"
    bl_label = "Detail in Render"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        _draw_detail(self._columns(), context.object.adaptive_terrain.render)
        self.layout.prop(context.scene.adaptive_terrain, "stop_stale_renders")


class MeshPanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_mesh"
    bl_label = "Mesh"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        column = self._columns()
        settings = context.object.adaptive_terrain
        column.prop(settings, "smooth")
        cleanup = settings.cleanup
        switched(column, cleanup, "use_below", "below")
        column.prop(cleanup, "boundary")
        if cleanup.use_below or cleanup.boundary is not None:
            column.prop(cleanup, "remove_loose")


class OutputPanel(TerrainSubpanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_output"
    bl_label = "Bake and Export"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        column = self._columns()
        column.prop(context.object.adaptive_terrain, "bake_error_m")
        column.prop(context.object.adaptive_terrain, "bake_fit")
        _waiting_row(column).operator("adaptive_terrain.bake", icon="MESH_GRID")
        column.separator()
        _waiting_row(column).operator("adaptive_terrain.export", icon="EXPORT")


CLASSES = (
    TerrainPanel,
    statistics_panel.StatisticsPanel,
    statistics_panel.AccuracyReportPanel,
    SourcePanel,
    CameraPanel,
    ViewportPanel,
    RenderPanel,
    overlay_panel.OverlayPanel,
    MeshPanel,
    OutputPanel,
)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
