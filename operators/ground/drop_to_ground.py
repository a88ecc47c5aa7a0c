# SPDX-License-Identifier: GPL-3.0-or-later
"""Drop to Ground: objects, or the points of curves, straight down or up to the terrain."""

import math
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from ...cbt_terrain.errors import TerrainError
from ..properties.keep_properties import ON
from . import keep_ground, world_ground
from . import vertical_moves as moves
from .bounds import corners_of
from .chosen import active_terrain, grounds, has_ground, movers, selected
from .drop_points import drop_points

ORIGIN, BOUNDS = "ORIGIN", "BOUNDS"
HELD = "does not get to the ground: a constraint holds it"


@dataclass(frozen=True)
class Laid:
    """Where an object is to lie: `height` of its origin in the world, and of the `ground` below that; its `turn`."""

    height: float
    ground: float
    turn: Quaternion


class DropToGround(bpy.types.Operator):
    """Move the selected objects along the world's Z axis to the ground; of a curve, each of its points. A mesh on an
    armature takes that along. The active terrain counts if it is selected, else the highest ground at the place"""

    bl_idname = "adaptive_terrain.drop_to_ground"
    bl_label = "Drop to Ground"
    bl_options = {"REGISTER", "UNDO"}

    anchor: bpy.props.EnumProperty(
        name="Lay Down",
        items=[(BOUNDS, "Lowest Point", "The lowest corner of the object's bounding box, over the box's middle"),
               (ORIGIN, "Origin", "The object's origin")],
    )  # fmt: skip
    offset: bpy.props.FloatProperty(name="Offset", description="Metres from the ground up", unit="LENGTH")
    align: bpy.props.BoolProperty(
        name="Align to Normal", description="Turn the object's Z axis to the ground's normal there"
    )
    keep: bpy.props.BoolProperty(
        name="Keep Every Frame",
        description="Stay on the ground in every frame, wherever animation, parents and constraints lead; the delta "
        "transforms are used for it",
    )

    @classmethod
    def poll(cls, context):
        if not has_ground(cls, context):
            return False
        cls.poll_message_set("Select what is to be dropped: objects that are no terrains")
        return bool(selected(context))

    def execute(self, context):
        depsgraph, objects, kept, left = context.evaluated_depsgraph_get(), [], [], {}
        try:
            if not math.isfinite(self.offset):
                raise TerrainError(f"The offset from the ground is {self.offset}; expected a number of metres.")
            ground = grounds(context, depsgraph)
            for obj in movers(selected(context)):
                refused = self._refusal(obj)
                if refused:
                    left[obj] = refused
                    continue
                if obj.adaptive_terrain_keep.keep:
                    keep_ground.let_go(obj)
                    kept.append(obj)
                objects.append(obj)
            depsgraph.update()
            for obj in objects:
                if refused := self._dropped(obj, ground, depsgraph, active_terrain(context)):
                    left[obj] = refused
                    obj.adaptive_terrain_keep.keep = obj in kept
            depsgraph.update()
            left |= self._held([obj for obj in objects if obj not in left], ground, depsgraph)
            if self.keep or kept:
                keep_ground.settle_now(context.scene, depsgraph)
        except TerrainError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        for obj, reason in left.items():
            self.report({"WARNING"}, f"{obj.name!r} {reason}.")
        done = [obj for obj in objects if obj not in left]
        self.report({"INFO"}, f"On the ground: {len(done)} of {len(done) + len(left)}")
        return {"FINISHED"} if done else {"CANCELLED"}

    def _refusal(self, obj) -> str:
        """Why an object stays where it is, as the end of a sentence that begins with its name, or ""."""
        if self.keep or obj.type == "CURVE":
            return keep_ground.refusal(obj, self.align) if self.keep else moves.untouchable(obj)
        channels = ("location", "rotation") if self.align else ("location",)
        if moves.is_animated(obj, *channels):
            return "is animated, and the next frame would bring it back; use Keep Every Frame"
        return moves.untouchable(obj) or moves.lock(obj, self.align)

    def _dropped(self, obj, ground, depsgraph, terrain) -> str:
        """As `_drop`; one object that cannot be moved stops no other."""
        try:
            return self._drop(obj, ground, depsgraph, terrain)
        except TerrainError as error:
            return f"stays: {str(error).rstrip('.')}"

    def _drop(self, obj, ground, depsgraph, terrain) -> str:
        """Move an object, or have it kept; returns as `_refusal`. Raises TerrainError for one that is flat."""
        evaluated = obj.evaluated_get(depsgraph)
        if not evaluated.is_evaluated:
            return "is hidden; show it first"
        if not np.isfinite(np.array(evaluated.matrix_world)).all():
            return "has a place, a rotation or a scale that is no number; correct it"
        if obj.type == "CURVE" and not self.keep:
            return drop_points(obj, evaluated.matrix_world, ground, self.offset)
        corners = corners_of(obj, depsgraph) if self.anchor == BOUNDS else None
        laid = laid_down(evaluated, corners, ground, self.align)
        if laid is None:
            return "has no ground above or below it"
        if self.keep:
            settings = obj.adaptive_terrain_keep
            settings.terrain, settings.align, settings.how, settings.keep = terrain, self.align, ON, True
            settings.offset = laid.height - laid.ground + self.offset
            return ""
        frame = moves.frame_of(evaluated)
        if self.align:
            location, rotation, scale = obj.matrix_basis.decompose()
            obj.matrix_basis = Matrix.LocRotScale(location, moves.own_turn(frame, laid.turn) @ rotation, scale)
        rise = laid.height + self.offset - evaluated.matrix_world.translation.z
        obj.location = obj.location + moves.own_rise(frame, rise)
        return ""

    def _held(self, objects, ground, depsgraph) -> dict:
        """Those that constraints keep from where they were moved to."""
        held = {}
        for obj in objects if not self.keep else ():
            if obj.type != "CURVE" and obj.constraints:
                evaluated = obj.evaluated_get(depsgraph)
                corners = corners_of(obj, depsgraph) if self.anchor == BOUNDS else None
                laid = laid_down(evaluated, corners, ground, False)
                z = evaluated.matrix_world.translation.z
                if laid is None or abs(laid.height + self.offset - z) > 1e-3 + moves.rounding(evaluated, z):
                    held[obj] = HELD
        return held


def laid_down(evaluated, corners, ground, align: bool) -> Laid | None:
    """How an evaluated object has to lie: with the lowest of its `corners`, float64 [n, 3] of the world, on the ground
    below their middle; without any with its origin. None without ground there."""
    origin, turn = np.array(evaluated.matrix_world.translation, np.float64), Quaternion()
    place = origin if corners is None else _middle(corners)
    under = world_ground.below(ground, place[None])
    if align and np.isfinite(under.heights[0]):
        turn = moves.turn_to(evaluated, world_ground.normals(ground, place[None], under)[0])
        if corners is not None:
            corners = np.array([turn @ Vector(corner) for corner in corners - origin]) + origin
            place = _middle(corners)
    heights = world_ground.below(ground, np.array([place, origin])).heights.tolist()
    if not np.isfinite(heights[0]):
        return None
    height = heights[0] if corners is None else origin[2] + heights[0] - corners[:, 2].min()
    return Laid(float(height), heights[1], turn)


def _middle(corners: np.ndarray) -> np.ndarray:
    return (corners.min(axis=0) + corners.max(axis=0)) / 2


register, unregister = bpy.utils.register_classes_factory((DropToGround,))
