# SPDX-License-Identifier: GPL-3.0-or-later
"""Freeze Detail: the mesh keeps its triangles while the camera moves."""

import bpy

from ..session import session
from ..session.polls import cancelled_by_errors
from .update_terrain import UpdatingOperator


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
