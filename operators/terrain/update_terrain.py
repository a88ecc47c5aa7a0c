# SPDX-License-Identifier: GPL-3.0-or-later
"""Update the mesh now, and make renders safe."""

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run import warmup
from ..session import session
from ..session.polls import TerrainObjectOperator, cancelled_by_errors
from .request import VIEWPORT, gather
from .request_kernels import kernels_for

WAIT_S = 0.1


class UpdatingOperator(TerrainObjectOperator):
    """Base of operators that update the active terrain: a click waits for kernels without blocking the window."""

    def invoke(self, context, event):
        if self._has_kernels(context):
            return self.execute(context)
        self.timer = context.window_manager.event_timer_add(WAIT_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Execute the operator once the kernels are ready; the timer calls this until then."""
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        if can_run := self.poll(context):
            if not self._has_kernels(context):
                return {"PASS_THROUGH"}
        self.cancel(context)
        return self.execute(context) if can_run else {"CANCELLED"}

    def cancel(self, context):
        """Remove the timer."""
        context.window_manager.event_timer_remove(self.timer)

    def _has_kernels(self, context) -> bool:
        """Return whether the kernels of the update are loaded; if not, start to prepare them."""
        if warmup.preparing():
            return False
        try:
            return warmup.ask(kernels_for(gather(context.object, context.evaluated_depsgraph_get(), VIEWPORT)))
        except TerrainError:
            return True  # the operator reports it


class UpdateTerrain(UpdatingOperator, bpy.types.Operator):
    """Compute the mesh for the camera now"""

    bl_idname = "adaptive_terrain.update"
    bl_label = "Update"
    bl_options = {"REGISTER", "UNDO"}

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
