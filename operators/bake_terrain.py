# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake a static mesh: one vertical error everywhere, no camera."""

import bpy

from ..cbt_terrain.criterion import Criterion
from ..cbt_terrain.errors import TerrainError
from . import session
from .mesh_writer import write_mesh, write_mesh_bmesh
from .request import gather


def bake(obj, depsgraph, error_m: float):
    """A new, ordinary object beside the terrain `obj` whose mesh is nowhere more than `error_m` metres off in height.

    Returns it with the engine's Update. The meshlet level and the triangle limit are those of the render settings.
    """
    detail = obj.adaptive_terrain.render
    criterion = Criterion(
        error_px=0.0,
        error_m=error_m,
        meshlet=detail.meshlet,
        max_triangles=detail.max_triangles if detail.limit_triangles else None,
    )
    request = gather(obj, depsgraph, criterion=criterion)
    with session.engine_lock:
        update = session.solve(session.Record(), request)  # an engine of its own: the terrain's stays as it is
        mesh = bpy.data.meshes.new(f"{obj.name} baked")
        if request.cleanup.active:
            write_mesh_bmesh(mesh, update.surface, request.cleanup, smooth=request.smooth)
        else:
            write_mesh(mesh, update.surface, smooth=request.smooth)
    for material in obj.data.materials:
        mesh.materials.append(material)
    baked = bpy.data.objects.new(mesh.name, mesh)
    baked.matrix_world = obj.matrix_world
    for collection in obj.users_collection:
        collection.objects.link(baked)
    return baked, update


class BakeTerrain(bpy.types.Operator):
    """Make an ordinary mesh object with one vertical error everywhere, independent of any camera"""

    bl_idname = "adaptive_terrain.bake"
    bl_label = "Bake Static Mesh"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and session.is_terrain(context.object) and context.mode == "OBJECT"

    def execute(self, context):
        obj = context.object
        try:
            _baked, update = bake(obj, context.evaluated_depsgraph_get(), obj.adaptive_terrain.bake_error_m)
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{update.triangles:,} triangles, at most {update.bound_m:.3g} m off")
        return {"FINISHED"}


def register() -> None:
    bpy.utils.register_class(BakeTerrain)


def unregister() -> None:
    bpy.utils.unregister_class(BakeTerrain)
