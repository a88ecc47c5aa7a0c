# SPDX-License-Identifier: GPL-3.0-or-later
"""Update the mesh now, and make renders safe."""

import bpy

from ...cbt_terrain.run import warmup
from ..session import session
from ..session.polls import TerrainObjectOperator, cancelled_by_errors

WAIT_S = 0.1


class UpdateTerrain(TerrainObjectOperator, bpy.types.Operator):
    """Compute the mesh for the camera now"""

    bl_idname = "adaptive_terrain.update"
    bl_label = "Update"
    bl_options = {"REGISTER", "UNDO"}

    def invoke(self, context, event):
        """Wait for kernels without blocking the window, if the click comes during the first start."""
        if not warmup.preparing():
            return self.execute(context)
        self.timer = context.window_manager.event_timer_add(WAIT_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Update the terrain once the kernels are ready; the timer calls this until then."""
        if event.type != "TIMER" or warmup.preparing():
            return {"PASS_THROUGH"}
        self.cancel(context)
        return self.execute(context) if self.poll(context) else {"CANCELLED"}

    def cancel(self, context):
        """Remove the timer."""
        context.window_manager.event_timer_remove(self.timer)

    @cancelled_by_errors
    def execute(self, context):
        """Update the active terrain for the viewport, and report its triangles."""
        session.update_object(context.object)
        self.report({"INFO"}, f"{len(context.object.data.polygons):,} triangles")
        return {"FINISHED"}


class LockInterface(bpy.types.Operator):
    """Lock Blender's interface during renders, so that no viewport draws a mesh that is being rebuilt, which can
    crash"""

    bl_idname = "adaptive_terrain.lock_interface"
    bl_label = "Lock Interface"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        context.scene.render.use_lock_interface = True
        return {"FINISHED"}
