# SPDX-License-Identifier: GPL-3.0-or-later
"""Add Collider: a coarse static mesh of a terrain for physics, with a separate bound."""

import bpy

from ...cbt_terrain.run import warmup
from ...cbt_terrain.view.linear import lengths
from ..bridge.writer import new_child, write_mesh
from ..session import session
from ..session.polls import TerrainObjectOperator, cancelled_by_errors
from ..text.numbers import length_text
from ..text.shown_bounds import limit_text
from . import world_ground
from .chosen import GroundOperator

MARK = "adaptive_terrain_collider"  # custom property of a collider: its bound in metres


class AddCollider(GroundOperator, TerrainObjectOperator, bpy.types.Operator):
    """Add a coarse mesh for physics that stays within Collider Error of the ground and is not rendered. Press it again
    after the terrain has changed"""

    bl_idname = "adaptive_terrain.add_collider"
    bl_label = "Add Collider"
    bl_options = {"REGISTER", "UNDO"}

    modules = ()

    rigid_body: bpy.props.BoolProperty(
        name="Rigid Body", description="Make it a passive rigid body, and add a rigid body world if the scene has none"
    )

    @cancelled_by_errors
    def execute(self, context):
        """Create or update the collider of the active terrain, and report its triangles and bound."""
        terrain = context.object
        update, bound = _bake_collider(terrain, context.evaluated_depsgraph_get())
        collider = collider_of(terrain) or _add_collider(terrain)
        write_mesh(collider.data, update.surface, smooth=False)
        collider[MARK] = bound  # marks it as a collider, and the panel shows the number
        if self.rigid_body or context.scene.rigidbody_world is not None:
            _make_passive(context, collider)
        message = f"{collider.name}: {update.triangles:,} triangles, error at most {length_text(bound)}"
        if update.limited:
            self.report({"WARNING"}, f"{message}, more than Collider Error: held back by {limit_text(update.limited)}")
        else:
            self.report({"INFO"}, message)
        return {"FINISHED"}


def collider_of(terrain):
    """Return the collider of a terrain, or None."""
    return next((child for child in terrain.children if child.type == "MESH" and child.get(MARK) is not None), None)


def _bake_collider(terrain, depsgraph):
    """Bake the mesh of a collider; return the engine's Update and its bound in metres of the world.

    The mesh is in the terrain's space. Raises TerrainError if the ground cannot be computed.
    """
    from ...cbt_terrain.fit.fit import bake

    ground = world_ground.ground_of(terrain, depsgraph)
    metres = float(lengths(ground.placement[:3, :3])[2])  # of the world per metre of height
    warmup.wait()  # for kernels that are being compiled
    with session.engine_lock:
        update = bake(ground.field, terrain.adaptive_terrain.collider_error_m / metres, **ground.scale_and_offset)
    return update, update.bound_m * metres


def _add_collider(terrain):
    """Create the object of a collider, which is hidden in renders."""
    collider = new_child(terrain, f"{terrain.name} Collider")
    collider.hide_render, collider.display_type = True, "WIRE"
    return collider


def _make_passive(context, collider) -> None:
    """Make a collider a passive rigid body whose shape is its mesh; a scene without a rigid body world gets one."""
    context.view_layer.update()
    if collider.rigid_body is None:
        with context.temp_override(object=collider, active_object=collider, selected_objects=[collider]):
            bpy.ops.rigidbody.object_add(type="PASSIVE")
    collider.rigid_body.type, collider.rigid_body.collision_shape = "PASSIVE", "MESH"
    collider.rigid_body.mesh_source = "BASE"
