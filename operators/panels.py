# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab "Terrain" in the sidebar of the 3D viewport."""

import bpy

from ..cbt_terrain import warmup
from . import import_terrain, session
from .properties import CHOSEN_CAMERA, FILE

LIMITS = {
    "max_triangles": "the triangle limit",
    "max_depth": "the depth limit",
    "resampling": "resampling at import",
}

STEPS = {"total": "Engine in all", "mesh": "Into Blender"}


class _TerrainPanel:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Terrain"

    @classmethod
    def poll(cls, context):
        return context.object is not None and session.is_terrain(context.object)

    def _columns(self):
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        return self.layout.column()


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
        box = layout.box()
        box.alert = True
        for number, line in enumerate(wrapped(status.error, 44)):
            box.label(text=line, icon="ERROR" if number == 0 else "NONE")
    if not context.scene.render.use_lock_interface:
        box = layout.box()
        box.label(text="A render may crash the viewport", icon="ERROR")
        box.operator("adaptive_terrain.lock_interface", icon="LOCKED")


def wrapped(text: str, width: int) -> list[str]:
    """The text in lines of at most `width` characters, cut between words."""
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


class StatisticsPanel(_TerrainPanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_statistics"
    bl_label = "Last Update"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        column = self._columns()
        for name, value in statistics_lines(session.record_of(context.object).status):
            row = column.split(factor=0.5)
            row.label(text=name)
            row.label(text=value)


def statistics_lines(status) -> list[tuple[str, str]]:
    """What the panel says of an update: pairs of a name and a figure with its unit."""
    if not status.mode:
        return [("No update yet", "")]
    lines = [("Leaves", f"{status.leaves:,}"), ("Triangles", f"{status.triangles:,}")]
    bounds = [("Screen error", status.bound_px, "px"), ("Vertical error", status.bound_m, "m")]
    bounds += [("Longest edge", status.bound_edge_px, "px"), ("Largest triangle", status.bound_area_px, "px²")]
    lines += [(name, f"≤ {value:.4g} {unit}") for name, value, unit in bounds if value is not None]
    if status.limited:
        lines.append(("Held back by", LIMITS.get(status.limited, status.limited)))
    if status.relaxed != 1.0:
        lines.append(("Coarser than asked", f"{status.relaxed:.3g} times"))
    return lines + [(STEPS.get(step, step.capitalize()), f"{ms:.2f} ms") for step, ms in status.ms.items()]


class SourcePanel(_TerrainPanel, bpy.types.Panel):
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
        _switched(column, settings, "use_extent", "extent")
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
        _switched(column, settings, "use_no_data", "no_data")


def _switched(column, settings, switch: str, name: str) -> None:
    """A value and the check box that switches it on."""
    column.prop(settings, switch)
    if getattr(settings, switch):
        column.prop(settings, name)


class CameraPanel(_TerrainPanel, bpy.types.Panel):
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
    for name, unit in (("error_px", " (px)"), ("edge_px", " (px)"), ("area_px", " (px²)"), ("error_m", "")):
        column.prop(detail, name, text=detail.bl_rna.properties[name].name + unit)
    column.separator()
    column.prop(detail, "guard_deg", text="Guard Band (°)")
    column.prop(detail, "off_screen_factor")
    column.prop(detail, "meshlet")
    column.separator()
    _switched(column, detail, "limit_depth", "max_depth")
    _switched(column, detail, "limit_triangles", "max_triangles")


class ViewportPanel(_TerrainPanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_viewport"
    bl_label = "Detail in Viewport"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        _draw_detail(self._columns(), context.object.adaptive_terrain.viewport)


class RenderPanel(_TerrainPanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_render"
    bl_label = "Detail in Render"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        _draw_detail(self._columns(), context.object.adaptive_terrain.render)


class MeshPanel(_TerrainPanel, bpy.types.Panel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_mesh"
    bl_label = "Mesh"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        column = self._columns()
        settings = context.object.adaptive_terrain
        column.prop(settings, "smooth")
        cleanup = settings.cleanup
        _switched(column, cleanup, "use_below", "below")
        column.prop(cleanup, "boundary")
        if cleanup.use_below or cleanup.boundary is not None:
            column.prop(cleanup, "remove_loose")


class OutputPanel(_TerrainPanel, bpy.types.Panel):
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


CLASSES = (TerrainPanel, StatisticsPanel, SourcePanel, CameraPanel, ViewportPanel, RenderPanel, MeshPanel, OutputPanel)
register, unregister = bpy.utils.register_classes_factory(CLASSES)
