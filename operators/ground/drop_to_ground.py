# SPDX-License-Identifier: GPL-3.0-or-later
"""Drop to Ground: objects, or the points of curves, straight down or up to the terrain."""

import math
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from ...cbt_terrain.errors import TerrainError
from ..session.polls import cancelled_by_errors
from . import keep_ground, world_ground
from . import vertical_moves as moves
from .chosen import GroundOperator, active_terrain, chosen_grounds, objects_to_move, selected_objects
from .properties import ON

ORIGIN, BOUNDS = "ORIGIN", "BOUNDS"
NOTHING = np.zeros((0, 3))
GEOMETRY = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "GPENCIL", "GREASEPENCIL"}


@dataclass(frozen=True)
class RestPose:
    """The pose of an object on the ground, in metres of the world."""

    height: float  # of the object's origin
    ground: float  # height of the ground above or below the origin, NaN without any
    turn: Quaternion  # rotation in the world that takes the object there


class DropToGround(GroundOperator, bpy.types.Operator):
    """Move the selected objects straight up or down onto the ground; of a curve, each control point. The active terrain
    counts if it is selected, otherwise the highest ground there"""

    bl_idname = "adaptive_terrain.drop_to_ground"
    bl_label = "Drop to Ground"
    bl_options = {"REGISTER", "UNDO"}

    anchor: bpy.props.EnumProperty(
        name="Lay Down", description="Part of the object that touches the ground",
        items=[(BOUNDS, "Lowest Point", "Put the bottom of the object's bounding box on the ground"),
               (ORIGIN, "Origin", "Put the object's origin on the ground")],
    )  # fmt: skip
    offset: bpy.props.FloatProperty(
        name="Offset",
        description="Height above the ground, in metres; below 0 the object is sunk into it",
        unit="LENGTH",
    )
    align: bpy.props.BoolProperty(
        name="Align to Normal", description="Tilt the object with the slope: its Z axis follows the ground's normal"
    )
    keep: bpy.props.BoolProperty(
        name="Keep Every Frame",
        description="Hold the object on the ground in every frame, whatever its animation, parents and constraints do. "
        "It uses the delta transforms",
    )

    @classmethod
    def poll(cls, context):
        """Return whether there is ground and an object to drop; otherwise set the reason that Blender shows."""
        if not super().poll(context):
            return False
        cls.poll_message_set("Select what is to be dropped: objects that are no terrains")
        return bool(selected_objects(context))

    @cancelled_by_errors
    def execute(self, context):
        """Drop the selected objects, and report those that cannot be moved with the reason."""
        # keeping: objects that are kept on the ground already. left: why others were not moved, by object.
        depsgraph, objects, keeping, left = context.evaluated_depsgraph_get(), [], [], {}
        if not math.isfinite(self.offset):
            raise TerrainError(f"The offset from the ground is {self.offset}", expected="a number of metres")
        ground = chosen_grounds(context, depsgraph)
        for obj in objects_to_move(selected_objects(context)):
            try:
                self._check_movable(obj)
            except TerrainError as error:
                left[obj] = error
                continue
            if obj.adaptive_terrain_keep.keep:
                keep_ground.let_go(obj)  # the drop starts where its channels put it; kept again if that fails
                keeping.append(obj)
            objects.append(obj)
        depsgraph.update()
        for obj in objects:
            try:
                self._drop(obj, ground, depsgraph, active_terrain(context))
            except TerrainError as error:
                left[obj] = error
                obj.adaptive_terrain_keep.keep = obj in keeping
        depsgraph.update()
        # Objects that a constraint has kept from reaching the ground.
        left |= self._find_held([obj for obj in objects if obj not in left], ground, depsgraph)
        if self.keep or keeping:
            keep_ground.settle_now(context.scene, depsgraph)  # places all kept objects at the present frame
        for error in left.values():
            self.report({"WARNING"}, str(error))
        done = [obj for obj in objects if obj not in left]
        self.report({"INFO"}, f"On the ground: {len(done)} of {len(done) + len(left)}")
        return {"FINISHED"} if done else {"CANCELLED"}

    def _check_movable(self, obj) -> None:
        """Raise TerrainError for an object that must not move: locked, animated or linked.

        With *Keep Every Frame* it must be keepable instead.
        """
        if self.keep:
            keep_ground.check_keepable(obj, self.align)
            return
        if obj.type != "CURVE":  # the points of a curve move, not the object
            channels = ("location", "rotation") if self.align else ("location",)
            if moves.is_animated(obj, *channels):
                what = f"The object {obj.name!r} is animated, and the next frame would bring it back"
                raise TerrainError(what, fix="use Keep Every Frame")
            moves.check_unlocked(obj, self.align)
        moves.check_local(obj)

    def _drop(self, obj, ground, depsgraph, terrain) -> None:
        """Move an object to the ground, or start keeping it there. Raises TerrainError if it cannot be moved.

        ground: list of WorldGround. terrain: the only terrain to keep it on, None for any.
        """
        evaluated, name = obj.evaluated_get(depsgraph), f"The object {obj.name!r}"
        if not evaluated.is_evaluated:
            raise TerrainError(f"{name} is hidden", fix="show it first")
        if not np.isfinite(np.array(evaluated.matrix_world)).all():
            raise TerrainError(f"{name} has a location, a rotation or a scale that is no number", fix="correct it")
        if obj.type == "CURVE" and not self.keep:
            drop_points(obj, evaluated.matrix_world, ground, self.offset)
            return
        corners = corners_of(obj, depsgraph) if self.anchor == BOUNDS else None
        # In the world: `height` of the origin on the ground, `ground` at the origin, and the rotation `turn` to there.
        pose = rest_pose(evaluated, corners, ground, self.align)
        if pose is None:
            raise TerrainError(f"{name} has no ground above or below it", fix="move it over the terrain")
        if self.keep:
            if not math.isfinite(pose.ground):
                what = f"{name} has no ground below its origin, from which Keep Every Frame measures"
                raise TerrainError(what, fix="move its origin over the terrain")
            settings = obj.adaptive_terrain_keep
            settings.terrain, settings.align, settings.how, settings.keep = terrain, self.align, ON, True
            settings.offset = pose.height - pose.ground + self.offset  # of the origin from the ground below it
            return
        frame = moves.channels_to_world(evaluated)  # 3 x 3 matrix from the location channels to the world
        if self.align:
            location, rotation, scale = obj.matrix_basis.decompose()
            obj.matrix_basis = Matrix.LocRotScale(location, moves.channel_turn(frame, pose.turn) @ rotation, scale)
        rise = pose.height + self.offset - evaluated.matrix_world.translation.z
        obj.location = obj.location + moves.channel_rise(frame, rise)

    def _find_held(self, objects, ground, depsgraph) -> dict:
        """Return the objects that a constraint has kept from reaching the ground, each with an error.

        {} with Keep Every Frame, which notes such objects itself.
        """
        held = {}
        for obj in objects if not self.keep else ():
            if obj.type != "CURVE" and obj.constraints:
                evaluated = obj.evaluated_get(depsgraph)
                corners = corners_of(obj, depsgraph) if self.anchor == BOUNDS else None
                pose = rest_pose(evaluated, corners, ground, align=False)
                z = evaluated.matrix_world.translation.z
                tolerance = 1e-3 + moves.rounding(evaluated, z)  # metres
                if pose is None or abs(pose.height + self.offset - z) > tolerance:
                    what = f"The object {obj.name!r} does not reach the ground, because a constraint holds it"
                    held[obj] = TerrainError(what, fix="mute the constraint")
        return held


def drop_points(obj, world: Matrix, ground, offset: float) -> None:
    """Move each control point of a curve object, with its handles, to the ground along the world's Z axis.

    Points without ground stay. Raises TerrainError if none can be moved.

    Args:
        world: the object's matrix to the world.
        ground: list of WorldGround.
        offset: metres above the ground.
    """
    curve, name = obj.data, f"The object {obj.name!r}"
    if moves.is_linked(curve):
        raise TerrainError(f"{name} has a curve that is linked from a library", fix="make it local")
    if curve.users > 1:
        raise TerrainError(f"{name} shares its curve with others", fix="make it a single user")
    if curve.shape_keys is not None:
        raise TerrainError(f"{name} has shape keys, which hold the points", fix="remove them")
    if curve.dimensions == "2D":
        raise TerrainError(f"{name} is a flat curve", fix="set its Shape to 3D")
    points = [point for spline in curve.splines for point in (*spline.bezier_points, *spline.points)]
    if not points:
        raise TerrainError(f"{name} has a curve without points", fix="add some")
    if world.determinant() == 0.0:
        raise TerrainError(f"{name} has a scale of 0", fix="give it another")
    positions = np.array([world @ point.co.to_3d() for point in points], np.float64)
    heights = world_ground.find_below(ground, positions).heights
    if not np.isfinite(heights).any():
        raise TerrainError(f"{name} has no ground above or below its points", fix="move it over the terrain")
    up = world.to_3x3().inverted() @ Vector((0.0, 0.0, 1.0))  # a metre up in the world, in the curve's space
    for point, position, height in zip(points, positions, heights.tolist(), strict=True):
        if np.isfinite(height):
            _move_point(point, up * (height + offset - position[2]))
    curve.update_tag()


def _move_point(point, by: Vector) -> None:
    """Move a control point and its handles by a vector of the curve's space."""
    if hasattr(point, "handle_left"):
        handles = point.handle_left + by, point.handle_right + by
        point.co, point.handle_left, point.handle_right = point.co + by, *handles
    else:
        point.co = (*(point.co.to_3d() + by), point.co.w)


def rest_pose(evaluated, corners, ground, align: bool) -> RestPose | None:
    """Return the pose that puts an evaluated object on the ground, None without ground.

    Its lowest corner gets the height of the ground below the corners' middle.

    Args:
        corners: float64 [n, 3], metres of the world; None to put the origin on the ground.
        ground: list of WorldGround.
        align: turn the object's Z axis to the ground's normal.
    """
    origin, turn = np.array(evaluated.matrix_world.translation, np.float64), Quaternion()
    position = origin if corners is None else _middle(corners)
    below = world_ground.find_below(ground, position[None])
    if align and np.isfinite(below.heights[0]):
        turn = moves.turn_to(evaluated, world_ground.normals_at(ground, position[None], below)[0])
        if corners is not None:  # turned about the origin
            corners = np.array([turn @ Vector(corner) for corner in corners - origin], np.float64) + origin
            position = _middle(corners)
    heights = world_ground.find_below(ground, np.array([position, origin])).heights.tolist()
    if not np.isfinite(heights[0]):
        return None
    height = heights[0] if corners is None else origin[2] + heights[0] - corners[:, 2].min()
    return RestPose(float(height), heights[1], turn)  # heights[1]: of the ground below the origin


def _middle(corners: np.ndarray) -> np.ndarray:
    """Return the middle of the box around corners, float64 [3]."""
    return (corners.min(axis=0) + corners.max(axis=0)) / 2


def corners_of(obj, depsgraph) -> np.ndarray:
    """Return the corners of the boxes around an object, its rendered children and instanced collections.

    Returns:
        float64 [n, 3], metres of the world; the object's origin if there is no geometry.
    """
    shown = [obj, *(child for child in obj.children_recursive if not child.hide_render)]
    found = [_object_corners(item.evaluated_get(depsgraph)) for item in shown]
    corners = np.concatenate(found)
    if not len(corners):
        return np.array([obj.evaluated_get(depsgraph).matrix_world.translation], np.float64)
    return corners


def _object_corners(evaluated) -> np.ndarray:
    """Return the corners of the box of one evaluated object, and of its instanced collection, float64 [n, 3]."""
    found = [NOTHING]
    if evaluated.type in GEOMETRY:
        found.append(_box_corners(evaluated, evaluated.matrix_world))
    collection = evaluated.instance_collection if evaluated.instance_type == "COLLECTION" else None
    if collection is not None:
        to_world = evaluated.matrix_world @ Matrix.Translation(-collection.instance_offset)
        for item in collection.all_objects:
            if item.type in GEOMETRY:
                found.append(_box_corners(item, to_world @ item.matrix_world))
    return np.concatenate(found)


def _box_corners(obj, matrix: Matrix) -> np.ndarray:
    """Return the corners of an object's bounding box, transformed by `matrix`, float64 [8, 3]."""
    return np.array([matrix @ Vector(corner) for corner in obj.bound_box], np.float64)
