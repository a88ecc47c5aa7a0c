# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel *Ground*: objects on the terrain, and measurements. It is shown for any object."""

import numpy as np

from ..bridge.evaluated import anchor_of
from ..bridge.scene_origin import coordinates_text
from ..importing.imported import imported_of
from ..session import session
from ..text.numbers import length_text
from ..text.translations import phrase
from ..ui.panel_parts import draw_message
from . import add_collider, keep_ground
from .pick_ground import OBJECT
from .properties import ON


class GroundPanel:
    """Operators on the ground, the settings of an object that is kept on it, and a terrain's collider."""

    bl_idname = "ADAPTIVE_TERRAIN_PT_on_ground"
    bl_label = "Ground"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_main"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context):
        """Show the panel if the scene has a terrain, whatever object is active."""
        return any(obj.adaptive_terrain.enabled for obj in context.scene.objects)

    def draw(self, context):
        """Draw the operators of the ground, and the settings of a kept object or of a terrain's collider."""
        layout, obj = self.layout, context.object
        column = layout.column(align=True)
        column.operator("adaptive_terrain.drop_to_ground", icon="TRIA_DOWN_BAR")
        column.operator("adaptive_terrain.keep_above_ground", icon="TRIA_UP_BAR")
        if obj is not None and obj.adaptive_terrain_keep.keep:
            self._draw_keeping(layout.box(), obj)
        row = layout.row(align=True)
        row.operator("adaptive_terrain.pick_ground", icon="EYEDROPPER")
        row.operator("adaptive_terrain.pick_ground", text="", icon="OBJECT_ORIGIN").moves = OBJECT  # not the 3D cursor
        column = layout.column(align=True)
        column.operator("adaptive_terrain.place_at_coordinates", icon="EMPTY_AXIS")
        column.operator("adaptive_terrain.profile", icon="IPO_EASE_IN_OUT")
        column.operator("adaptive_terrain.viewshed", icon="HIDE_OFF")
        column.operator("adaptive_terrain.move_world", icon="WORLD")
        text = _cursor_text(context)
        if text:
            layout.label(text=phrase("3D Cursor: {}", text), icon="CURSOR")
        if obj is not None and session.is_terrain(obj):
            self._draw_collider(layout, obj)

    def _draw_keeping(self, box, obj):
        """Draw how the active object is kept on or above the ground."""
        settings = obj.adaptive_terrain_keep
        box.row().prop(settings, "how", expand=True)
        box.use_property_split, box.use_property_decorate = True, False
        if settings.how == ON:
            box.prop(settings, "offset")
            box.prop(settings, "align")
        else:
            box.prop(settings, "clearance")
        box.prop(settings, "terrain")
        box.operator("adaptive_terrain.let_go", icon="UNLINKED")
        if text := keep_ground.note_of(obj):
            draw_message(box, text, "ERROR")

    def _draw_collider(self, layout, terrain):
        """Draw the error of a terrain's collider, its button and its size."""
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(terrain.adaptive_terrain, "collider_error_m")
        collider = add_collider.collider_of(terrain)
        text = "Add Collider" if collider is None else "Update Collider"
        column.operator("adaptive_terrain.add_collider", text=text, icon="PHYSICS")
        if collider is not None:
            bound = length_text(collider[add_collider.MARK])
            column.label(text=phrase("{} triangles, ≤ {} off", f"{len(collider.data.polygons):,}", bound))


def _cursor_text(context) -> str:
    """Return the coordinates of the 3D cursor in the system of the shown terrain; "" if they are unknown."""
    terrain = session.shown_terrain(context)
    imported = None if terrain is None else imported_of(terrain.adaptive_terrain)
    if imported is None or terrain.matrix_world.determinant() == 0.0:
        return ""
    position = terrain.matrix_world.inverted() @ context.scene.cursor.location
    # anchor_of: the object's origin, in metres from the raster's middle, where `place` has its origin
    return coordinates_text(imported.place, imported.crs, np.array(position[:2]) + anchor_of(terrain))
