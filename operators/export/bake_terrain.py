# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake a static mesh: one vertical error everywhere, no camera."""

from types import ModuleType

import bpy

from ...cbt_terrain.fit.fit import bake as bake_mesh
from ...cbt_terrain.fit.fit import check_interpolation
from ...cbt_terrain.run import warmup
from ...cbt_terrain.run.warmup import modules_of
from ...cbt_terrain.view.criterion import Criterion
from ...kernels import fitting
from ..bridge.cleanup import clean_up
from ..bridge.writer import write_mesh
from ..kernel_operator import KernelOperator
from ..session import session
from ..session.polls import TerrainObjectOperator, cancelled_by_errors
from ..terrain.overrides import Overrides
from ..terrain.request import gather
from ..terrain.request_kernels import kernels_for
from ..text.shown_bounds import bound_text, limit_text


def bake_object(obj, depsgraph, error_m: float, fitted: bool = False):
    """Add an ordinary object at the place of the terrain `obj`, whose mesh is at most `error_m` metres off in height.

    Return it and the engine's Update. A limit of triangles may make the error larger. Raises TerrainError.

    Args:
        fitted: move vertices off the surface to save triangles; each leaf is then one triangle. Otherwise the
            meshlet level of the render settings applies.
    """
    detail = obj.adaptive_terrain.render
    criterion = Criterion(
        error_px=0.0,
        error_m=error_m,
        meshlet=detail.meshlet,
        max_triangles=detail.max_triangles if detail.limit_triangles else None,
    )
    request = gather(obj, depsgraph, criterion=criterion)
    if fitted:
        check_interpolation(request.interpolation)
    warmup.wait()
    with session.engine_lock:
        update = bake_mesh(
            session.field_of(request),
            error_m,
            fitted=fitted,
            max_triangles=criterion.max_triangles,
            meshlet=criterion.meshlet,
            vertical_scale=request.vertical_scale,
            vertical_offset=request.vertical_offset,
        )
        mesh = bpy.data.meshes.new(f"{obj.name} baked")
        write_mesh(mesh, clean_up(update.surface, request.cleanup), smooth=request.smooth)
    for material in obj.data.materials:
        mesh.materials.append(material)
    baked = bpy.data.objects.new(mesh.name, mesh)
    baked.matrix_world = obj.matrix_world
    for collection in obj.users_collection:
        collection.objects.link(baked)
    return baked, update


def _show_instead(baked, obj, view_layer) -> None:
    """Hide a terrain in viewports and renders, and make its baked mesh the only selected and the active object.

    Both surfaces at one place would flicker.
    """
    obj.hide_set(True, view_layer=view_layer)
    obj.hide_render = True
    for other in view_layer.objects.selected:
        other.select_set(False, view_layer=view_layer)
    if baked.name in view_layer.objects:  # not if the terrain's collection is excluded
        baked.select_set(True, view_layer=view_layer)
        view_layer.objects.active = baked


class BakeTerrain(KernelOperator, TerrainObjectOperator, bpy.types.Operator):
    """Make an ordinary mesh object with the same accuracy everywhere, whatever the camera sees, and hide the terrain,
    which is in the same place. Use it to edit the terrain by hand or for other programs"""

    bl_idname = "adaptive_terrain.bake"
    bl_label = "Bake Static Mesh"
    bl_options = {"REGISTER", "UNDO"}

    def kernels(self, context) -> list[ModuleType]:
        """Return the modules of the terrain's surface, and of the fit if the mesh is to be fitted."""
        obj, depsgraph = context.object, context.evaluated_depsgraph_get()
        found = kernels_for(gather(obj, depsgraph, overrides=Overrides(effects=())))
        return found + modules_of(fitting) if obj.adaptive_terrain.bake_fit else found

    @cancelled_by_errors
    def execute(self, context):
        """Bake the active terrain with the error of its settings, show the mesh instead of it, and report triangles
        and bound.
        """
        obj = context.object
        settings = obj.adaptive_terrain
        baked, update = bake_object(obj, context.evaluated_depsgraph_get(), settings.bake_error_m, settings.bake_fit)
        _show_instead(baked, obj, context.view_layer)
        message = f"{baked.name}, in the place of {obj.name}, which is hidden now: {len(baked.data.polygons):,} "
        message += f"triangles, at most {bound_text(update.bound_m, 'm')} off"
        if update.limited:
            self.report({"WARNING"}, f"{message}: held back by {limit_text(update.limited)}")
        else:
            self.report({"INFO"}, message)
        return {"FINISHED"}
