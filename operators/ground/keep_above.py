# SPDX-License-Identifier: GPL-3.0-or-later
"""Keep Above Ground keeps a camera or object at a clearance over the terrain; Let Go ends it."""

import math

import bpy

from ...cbt_terrain.errors import TerrainError
from ..bridge import camera as cameras
from ..session.polls import cancelled_by_errors
from . import keep_ground
from . import vertical_moves as moves
from .chosen import GroundOperator, active_terrain, objects_to_move, selected_objects
from .properties import ABOVE


class KeepAboveGround(GroundOperator, bpy.types.Operator):
    """Keep the selected objects, or the scene's camera, at least Clearance above the ground in every frame. It uses the
    delta transforms"""

    bl_idname = "adaptive_terrain.keep_above_ground"
    bl_label = "Keep Above Ground"
    bl_options = {"REGISTER", "UNDO"}

    clearance: bpy.props.FloatProperty(
        name="Clearance",
        description="Smallest distance from the object's origin straight down to the ground, in metres",
        default=2.0, min=0.0, unit="LENGTH",
    )  # fmt: skip

    @classmethod
    def poll(cls, context):
        """Return whether there is ground and an object to keep above it; otherwise set the reason to show."""
        if not super().poll(context):
            return False
        cls.poll_message_set("Select an object that is no terrain, or give the scene a camera")
        return bool(_chosen_objects(context))

    @cancelled_by_errors
    def execute(self, context):
        """Keep the selected objects, or the scene's camera, above the ground from now on."""
        if not math.isfinite(self.clearance):
            raise TerrainError(f"The clearance is {self.clearance}", expected="a number of metres")
        objects = objects_to_move(_chosen_objects(context))
        refused = []
        for obj in objects:
            try:
                keep_ground.check_keepable(obj)
            except TerrainError as error:
                refused.append(error)
                continue
            settings = obj.adaptive_terrain_keep
            settings.how, settings.clearance, settings.keep = ABOVE, self.clearance, True
            settings.terrain, settings.align = active_terrain(context), False
        for note in keep_ground.settle_now(context.scene, context.evaluated_depsgraph_get()):
            self.report({"WARNING"}, note)
        for error in refused:
            self.report({"WARNING"}, str(error))
        count = len(objects) - len(refused)
        self.report({"INFO"}, f"Kept above ground: {count} of {len(objects)}")
        return {"FINISHED"} if count else {"CANCELLED"}


def _chosen_objects(context) -> list:
    """Return the selected objects that are no terrains, else the active camera of the scene."""
    camera = cameras.active_camera(context.scene)
    return selected_objects(context) or [camera] * (camera is not None)


class LetGo(bpy.types.Operator):
    """Stop keeping the selected objects on or above the ground. They return to where their location, animation, parents
    and constraints put them"""

    bl_idname = "adaptive_terrain.let_go"
    bl_label = "Let Go"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        """Return whether a selected or the active object is kept on or above the ground; if not, set the reason."""
        cls.poll_message_set("Select an object that is kept on the ground or above it")
        return any(_can_let_go(obj) for obj in _selected_or_active(context))

    def execute(self, context):
        """Stop keeping the selected objects on or above the ground."""
        objects = [obj for obj in _selected_or_active(context) if _can_let_go(obj)]
        for obj in objects:
            keep_ground.let_go(obj)
        self.report({"INFO"}, f"Let go: {', '.join(obj.name for obj in objects)}")
        return {"FINISHED"}


def _selected_or_active(context) -> list:
    """Return the selected objects that are no terrains, and the active object, each once."""
    return list({*selected_objects(context), *filter(None, [context.object])})


def _can_let_go(obj) -> bool:
    """Return whether an object is kept on or above the ground and may be written."""
    return obj.adaptive_terrain_keep.keep and not moves.is_linked(obj)
