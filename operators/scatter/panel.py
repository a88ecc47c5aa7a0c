# SPDX-License-Identifier: GPL-3.0-or-later
"""Scatters: those of a terrain with what they take, and the settings of the one that is selected."""

from mathutils import Matrix

from ..layers.panel import draw_rules
from ..session import session
from ..text.numbers import length_text, time_text
from ..text.shown_bounds import bound_text
from ..text.translations import phrase
from ..ui.panel_parts import TerrainSubpanel, draw_figures, draw_message, draw_switched, show_terrain
from ..ui.status_row import NO_VIEW, draw_failure, sight_notice
from .fitting import count_on_land, size_of
from .properties import MESH
from .request import ScatterRecord, is_scatter, scatters_of

ORPHAN = "Its parent is no terrain, so its points stay as they are: parent it to one, or delete it."
LABELS = {"margin_deg": {"text": "Margin (°)"}}  # labels of settings whose unit Blender does not know
IDENTITY = Matrix()  # transform of a scatter in its terrain's space, in which its points are written


class ScattersPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_scatters"
    bl_label = "Scatter"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"

    def draw(self, context):
        """Draw two rows for each scatter of the terrain, its points and time, and the button that adds one."""
        terrain = show_terrain(self.layout, context)
        column = self.layout.column(align=True)
        for obj in scatters_of(terrain):
            points, took = summary(session.record_of(terrain).scatters.get(obj.session_uid))
            row = column.row()
            row.label(text=obj.name, icon="OUTLINER_OB_POINTCLOUD")
            row.prop(obj, "hide_viewport", text="", emboss=False)
            column.label(text=phrase("{} points, {}", points, took), icon="BLANK1")
        self.layout.operator_menu_enum("adaptive_terrain.scatter_add", "kind", icon="ADD")


class ScatterPanel:
    """Of a scatter that is selected."""

    bl_idname = "ADAPTIVE_TERRAIN_PT_scatter"
    bl_label = "Adaptive Scatter"

    @classmethod
    def poll(cls, context):
        """Return whether the active object is a scatter."""
        obj = context.object
        return obj is not None and is_scatter(obj)

    def draw(self, context):
        """Draw the figures and the settings of the selected scatter."""
        obj, terrain = context.object, context.object.parent
        if terrain is None or not session.is_terrain(terrain):
            draw_message(self.layout, ORPHAN, "ERROR")
            return
        settings, record = obj.adaptive_scatter, session.record_of(terrain)
        self.layout.use_property_split, self.layout.use_property_decorate = True, False
        column = self.layout.column()
        column.prop(settings, "collection")
        if settings.collection is None:
            column.operator_menu_enum("adaptive_terrain.starter_add", "kind", icon="ADD")
        box = column.box().column(align=True)
        draw_figures(box, scatter_lines(settings, record.scatters.get(obj.session_uid), record.status))
        if not draw_failure(box, terrain):
            notice = sight_notice(context, terrain)[0]
            has_view = notice not in NO_VIEW
            text = phrase("On {}", terrain.name) if has_view else phrase(notice)
            box.label(text=text, icon="CHECKMARK" if has_view else "ERROR")
        for line in size_lines(settings, terrain):
            column.label(text=line, icon="BLANK1")
        for name in ("spacing", "full_until", "size", "variation", "align", "roots", "margin_deg", "margin_m"):
            column.prop(settings, name, **LABELS.get(name, {}))
        row = column.row()
        row.active = settings.roots != MESH  # such points are never culled: hidden triangles may be too coarse
        row.prop(settings, "cull_hidden")
        column.prop(settings, "seed")
        column.separator()
        draw_switched(column, settings, "use_sea", "sea_level")
        column.prop_search(settings, "layer", terrain.adaptive_terrain, "layers")
        draw_rules(column, settings.where)


def summary(scatter: ScatterRecord | None) -> tuple[str, str]:
    """Return the number of points and the time of a scatter's last update as texts, "-" before it."""
    if scatter is None or scatter.points is None:
        return "-", "-"
    return f"{len(scatter.points):,}", time_text(sum(scatter.ms.values()))


def size_lines(settings, terrain) -> list[str]:
    """Return two lines: sizes of the collection's objects, and the number of points on all the land without rules."""
    width, height = (0.0, 0.0) if settings.collection is None else size_of(settings.collection)
    sizes = length_text(width), length_text(height)
    objects = phrase("Up to {} wide, {} high", *sizes) if width else phrase("No objects: cones")
    count = count_on_land(terrain, settings.spacing)
    return [objects, "-" if count is None else phrase("{} on all the land", f"{count:,}")]


def scatter_lines(settings, scatter: ScatterRecord | None, status) -> list[tuple[str, str]]:
    """Return four (name, value) rows about a scatter: points, tested candidates, time, distance to the mesh.

    status: Status of its terrain's last update, whose bound is that distance for points on the ground.
    """
    points, took = summary(scatter)
    tested, off = "-", "-"
    if points != "-" and scatter.points.tested:
        tested = f"{scatter.points.tested:,}"
        px, metres = status.bounds.bound_px, status.bounds.bound_m
        bound = (px, "px") if px is not None else (metres or 0.0, "m")
        off = phrase("0 (on the mesh)") if settings.roots == MESH else f"≤ {bound_text(*bound)}"
        if settings.id_data.matrix_local != IDENTITY:
            off = phrase("moved: clear its transforms")
    return [("Points", points), ("Looked at", tested), ("Update", took), ("Off the mesh", off)]


PANELS = (ScattersPanel, ScatterPanel)
