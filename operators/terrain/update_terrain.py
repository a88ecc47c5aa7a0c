# SPDX-License-Identifier: GPL-3.0-or-later
"""Update the mesh now, freeze its triangles, and make renders safe."""

from types import ModuleType

import bpy

from ..importing import shared_origin
from ..kernel_operator import KernelOperator
from ..session import session
from ..session.polls import TerrainObjectOperator, cancelled_by_errors
from .request import VIEWPORT, gather
from .request_kernels import kernels_for


class UpdatingOperator(KernelOperator, TerrainObjectOperator):
    """Base of operators that update the active terrain for the viewport."""

    def kernels(self, context) -> list[ModuleType]:
        """Return the kernel modules that an update in viewport quality needs, to compile them before."""
        return kernels_for(gather(context.object, context.evaluated_depsgraph_get(), VIEWPORT))


class UpdateTerrain(UpdatingOperator, bpy.types.Operator):
    """Compute the mesh for the camera now"""

    bl_idname = "adaptive_terrain.update"
    bl_label = "Update"
    bl_options = {"REGISTER", "UNDO"}

    @cancelled_by_errors
    def execute(self, context):
        """Update the active terrain for the viewport, and report its triangles."""
        shared_origin.follow_replaced_store(context.object)
        session.update_object(context.object)
        self.report({"INFO"}, f"{len(context.object.data.polygons):,} triangles")
        return {"FINISHED"}


class FreezeDetail(UpdatingOperator, bpy.types.Operator):
    """Keep the present triangles, whatever the camera sees, in renders too. Press it again to let the mesh follow the
    camera"""

    bl_idname = "adaptive_terrain.freeze"
    bl_label = "Freeze Detail"
    bl_options = {"REGISTER", "UNDO"}

    @cancelled_by_errors
    def execute(self, context):
        """Store the present triangles in the terrain's settings, or release them if it is frozen."""
        settings = context.object.adaptive_terrain
        settings.frozen = "" if settings.frozen else session.freeze(context.object)
        self.report({"INFO"}, "The mesh keeps its triangles" if settings.frozen else "The mesh follows its camera")
        return {"FINISHED"}


class LockInterface(bpy.types.Operator):
    """Lock Blender's interface during renders, so that no viewport draws a mesh that is being rebuilt, which can
    crash"""

    bl_idname = "adaptive_terrain.lock_interface"
    bl_label = "Lock Interface"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        """Switch on Lock Interface in the scene's render settings."""
        context.scene.render.use_lock_interface = True
        return {"FINISHED"}
