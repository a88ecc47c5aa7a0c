# SPDX-License-Identifier: GPL-3.0-or-later
"""Pick: move the 3D cursor or the active object to the ground under the mouse."""

import math

import bpy
from bpy_extras import view3d_utils

from ...cbt_terrain.errors import TerrainError
from ..bridge import camera as cameras
from ..session.polls import cancelled_by_errors
from ..text.numbers import plain
from . import vertical_moves as moves
from . import world_ground
from .chosen import GroundOperator, chosen_grounds

CURSOR, OBJECT = "CURSOR", "OBJECT"
DOWN = 0.0, 0.0, -1.0


class PickGround(GroundOperator, bpy.types.Operator):
    """Click on the terrain to put the 3D cursor on the ground, at the height map's full resolution. Esc or the right
    mouse button ends it"""

    bl_idname = "adaptive_terrain.pick_ground"
    bl_label = "Pick Ground"
    bl_options = {"REGISTER", "UNDO"}

    moves: bpy.props.EnumProperty(
        name="Move", description="Thing that moves to the ground where you click",
        items=[(CURSOR, "3D Cursor", "Put the 3D cursor where you click"),
               (OBJECT, "Active Object", "Put the origin of the active object where you click")],
    )  # fmt: skip
    origin: bpy.props.FloatVectorProperty(name="Origin", description="Start of the ray, for scripts", unit="LENGTH")
    direction: bpy.props.FloatVectorProperty(
        name="Direction", description="Direction of the ray, for scripts", default=DOWN
    )

    def invoke(self, context, event):
        """Start waiting for a click in the 3D viewport, with an eyedropper as the mouse pointer."""
        if context.area is None or context.area.type != "VIEW_3D":
            self.report({"ERROR"}, "Pick from a 3D viewport, or give the ray's origin and direction.")
            return {"CANCELLED"}
        self._has_kernels(context)  # starts to prepare them before the click
        self.has_clicked = False
        context.window_manager.modal_handler_add(self)
        context.window.cursor_modal_set("EYEDROPPER")
        context.workspace.status_text_set("Click on the terrain; Esc: cancel")
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Turn a click into a ray and move the cursor or object, once the kernels are ready; Esc or the right button
        cancels.
        """
        if self.has_clicked:
            return GroundOperator.modal(self, context, event)
        if event.type in {"ESC", "RIGHTMOUSE"}:
            self.cancel(context)
            return {"CANCELLED"}
        if event.type != "LEFTMOUSE" or event.value != "PRESS":
            return {"PASS_THROUGH"}  # lets the user turn the view
        ray = _ray_under(context, event)
        self.cancel(context)  # restores the mouse pointer and the status bar
        if ray is None:
            self.report({"ERROR"}, "The click was not in a 3D viewport.")
            return {"CANCELLED"}
        self.origin, self.direction = ray
        if self._has_kernels(context):
            return self.execute(context)
        self.has_clicked = True
        self.start_waiting(context)
        return {"RUNNING_MODAL"}

    def cancel(self, context):
        """Restore the mouse pointer and the status bar, or stop waiting after the click."""
        if self.has_clicked:
            GroundOperator.cancel(self, context)
            return
        context.window.cursor_modal_restore()
        context.workspace.status_text_set(None)

    @cancelled_by_errors
    def execute(self, context):
        """Move the 3D cursor or the active object to where the ray first hits the ground."""
        depsgraph = context.evaluated_depsgraph_get()
        found = chosen_grounds(context, depsgraph)
        hit = world_ground.first_hit(found, self.origin, self.direction)
        if hit is None:
            raise TerrainError("There is no ground under the mouse, or along the ray", fix="aim at the terrain")
        point, ground = hit[0], found[hit[1]]
        if self.moves == OBJECT:
            _move_origin(context.object, point, depsgraph)
        else:
            context.scene.cursor.location = point
        slope = math.degrees(math.acos(min(1.0, ground.normals(point[None])[0, 2])))
        position = ", ".join(f"{value:,.2f}" for value in point)
        notes = f"Ground at {position} m, slope {plain(slope)}°", ground.coordinates(point), ground.gap_note(point)
        self.report({"INFO"}, ", ".join(filter(None, notes)))
        return {"FINISHED"}


def _move_origin(obj, point, depsgraph) -> None:
    """Move an object so that its origin is at a point of the world, float64 [3]. Raises TerrainError."""
    if obj is None or obj.adaptive_terrain.enabled:
        raise TerrainError("There is no active object to move, or it is a terrain", fix="make another one active")
    moves.check_local(obj)
    moves.check_unlocked(obj)
    evaluated = obj.evaluated_get(depsgraph)
    by = [goal - now for goal, now in zip(point.tolist(), evaluated.matrix_world.translation, strict=True)]
    obj.location = obj.location + moves.channel_move(moves.channels_to_world(evaluated), by)


def _ray_under(context, event):
    """Return origin and direction of the ray under the mouse in a viewport of the window, or None."""
    for window, _, region, region_3d in cameras.viewports(context.window_manager):
        mouse = event.mouse_x - region.x, event.mouse_y - region.y
        is_inside = 0 <= mouse[0] < region.width and 0 <= mouse[1] < region.height
        if window == context.window and is_inside:
            functions = view3d_utils.region_2d_to_origin_3d, view3d_utils.region_2d_to_vector_3d
            return tuple(function(region, region_3d, mouse) for function in functions)
    return None
