# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake a static mesh: one vertical error everywhere, no camera."""

from dataclasses import replace
from types import ModuleType

import bpy

from ...cbt_terrain.attributes.plan import plan
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.mesh.surface import Surface
from ...cbt_terrain.run import launch, warmup
from ...cbt_terrain.run.warmup import modules_of
from ...cbt_terrain.view.criterion import Criterion
from ..attributes.request import gather_effects
from ..bridge.cleanup import clean_up
from ..bridge.scene_paths import absolute_path, store_path
from ..bridge.writer import write_mesh
from ..kernel_operator import KernelOperator
from ..land.request import land_of
from ..land.shape_land import check_is_shaped
from ..scene.haze import without_haze
from ..session import session
from ..session.polls import TerrainObjectOperator, cancelled_by_errors
from ..terrain.request import RENDER, Request, gather
from ..terrain.request_kernels import kernels_for
from ..text.gap_note import gap_note
from ..text.shown_bounds import bound_text, limit_text


def bake_object(obj, depsgraph, error_m: float, fitted: bool = False):
    """Add an ordinary object at the place of the terrain `obj`, whose mesh is at most `error_m` metres off in height.

    It has the terrain's materials, as copies without haze if they have haze, its modifiers, and the attributes that
    renders and viewports read. Return it and the engine's Update. A limit of triangles may make the error larger.
    Raises TerrainError.

    Args:
        fitted: move vertices off the surface to save triangles; each leaf is then one triangle. Otherwise the
            meshlet level of the render settings applies.
    """
    from ...cbt_terrain.fit.fit import bake as bake_mesh
    from ...cbt_terrain.fit.fit import check_interpolation

    request = _request_of(obj, depsgraph, error_m)
    if fitted:
        check_interpolation(request.interpolation)  # only bilinear ground can be fitted
    warmup.wait()  # for kernels that are being compiled
    with session.engine_lock:
        heights = session.field_of(request)
        update = bake_mesh(
            heights,
            error_m,
            fitted=fitted,
            max_triangles=request.criterion.max_triangles,
            meshlet=request.criterion.meshlet,
            vertical_scale=request.vertical_scale,
            vertical_offset=request.vertical_offset,
        )
        surface = clean_up(_with_attributes(update.surface, heights, request), request.cleanup)
        mesh = bpy.data.meshes.new(f"{obj.name} baked")
        write_mesh(mesh, surface, smooth=request.smooth)
    return _add_object(obj, mesh), update


def _request_of(obj, depsgraph, error_m: float) -> Request:
    """Return the request of a baked mesh: its error, the shaped land, and attributes that renders or viewports read.

    Raises TerrainError for a terrain that cannot be refined.
    """
    evaluated, detail = obj.evaluated_get(depsgraph), obj.adaptive_terrain.render
    criterion = Criterion(
        error_px=0.0,
        error_m=error_m,
        meshlet=detail.meshlet,
        max_triangles=detail.max_triangles if detail.limit_triangles else None,
    )
    request = gather(obj, depsgraph, criterion=criterion)
    # `request` has the attributes that viewports read; these are those that renders read.
    rendered = gather_effects(obj, evaluated, request.placement, depsgraph, RENDER, names=None)
    effects = replace(request.effects, requests=request.effects.requests + rendered.requests)
    # The request's land is that of the viewport: a preview, or none if the terrain is hidden. Wait for the shaped land.
    land = land_of(obj, evaluated, depsgraph, waits=True)
    store = absolute_path(evaluated.adaptive_terrain.store)
    return replace(request, effects=effects, land=land, store=store)


def _with_attributes(surface: Surface, heights: HeightField, request: Request) -> Surface:
    """Return a baked surface with a request's attributes, at the finest samples' scale because it has no camera.

    Those from which geometry is made have the scale `geometry_metres` of the request (metres between samples).
    """
    from ...cbt_terrain.attributes.evaluate import EffectRequest, evaluate
    from ...cbt_terrain.history.frame_history import FrameHistory

    effects = EffectRequest(
        plan(request.effects.requests),
        surface,
        placement=request.placement,
        vertical_scale=request.vertical_scale,
        vertical_offset=request.vertical_offset,
        geometry_metres=request.effects.geometry_metres,
    )
    return surface.with_attributes(evaluate(heights, effects, FrameHistory(), launch.default_threads()).attributes)


def _add_object(obj, mesh):
    """Return a copy of a terrain's object in the same collections that is an ordinary object with another mesh.

    Modifiers, material slots, visibility to rays, parent and animation are the terrain's. Materials lose their haze.
    """
    materials = [*obj.data.materials, *(slot.material for slot in obj.material_slots)]  # slots may have the object's
    plain = {material: without_haze(material) for material in set(materials)}
    for material in obj.data.materials:
        mesh.materials.append(plain[material])
    for name in ("active_color_index", "render_color_index"):  # counted anew: another mesh has other attributes
        shown = getattr(obj.data.color_attributes, name)
        if 0 <= shown < len(obj.data.color_attributes):
            index = mesh.color_attributes.find(obj.data.color_attributes[shown].name)
            if index >= 0:
                setattr(mesh.color_attributes, name, index)
    baked = obj.copy()
    baked.property_unset("adaptive_terrain")
    baked.name, baked.data = mesh.name, mesh
    baked.hide_viewport = baked.hide_render = False
    for slot in baked.material_slots:
        if slot.link == "OBJECT":
            slot.material = plain[slot.material]
    for collection in obj.users_collection:
        collection.objects.link(baked)
    return baked


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
    """Make an ordinary mesh object with the same accuracy everywhere, whatever the camera sees, and with all that the
    material shows. It hides the terrain, which is in the same place. Edit it by hand or take it to other programs"""

    bl_idname = "adaptive_terrain.bake"
    bl_label = "Bake Static Mesh"
    bl_options = {"REGISTER", "UNDO"}

    def kernels(self, context) -> list[ModuleType]:
        """Return the modules of the terrain's surface and attributes, and of the fit if the mesh is to be fitted."""
        from ...kernels import fitting

        settings = context.object.adaptive_terrain
        found = kernels_for(_request_of(context.object, context.evaluated_depsgraph_get(), settings.bake_error_m))
        return found + modules_of(fitting) if settings.bake_fit else found

    def invoke(self, context, event):
        """Refuse land that is not shaped yet, which has its own button; otherwise bake once the kernels are ready."""
        try:
            check_is_shaped(context.object, context.evaluated_depsgraph_get())
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return KernelOperator.invoke(self, context, event)

    @cancelled_by_errors
    def execute(self, context):
        """Bake the active terrain with the error of its settings, show the mesh instead of it, and report triangles
        and bound.
        """
        obj = context.object
        settings = obj.adaptive_terrain
        depsgraph = context.evaluated_depsgraph_get()
        baked, update = bake_object(obj, depsgraph, settings.bake_error_m, fitted=settings.bake_fit)
        _show_instead(baked, obj, context.view_layer)
        message = f"{baked.name}, in the place of {obj.name}, which is hidden now: {len(baked.data.polygons):,} "
        message += f"triangles, at most {bound_text(update.bound_m, 'm')} off"
        if update.limited:
            self.report({"WARNING"}, f"{message}: held back by {limit_text(update.limited)}")
        else:
            self.report({"INFO"}, message + gap_note(session.open_field(store_path(obj))))
        return {"FINISHED"}
