# SPDX-License-Identifier: GPL-3.0-or-later
"""Move World Here: bring a shot to the world's origin, where float32 holds coordinates to a fraction of a millimetre.

All objects move together, so pictures stay the same. Each terrain also gets an anchor: the origin of its object, and of
the float32 positions of its mesh, is then near the world's origin. No other operator changes an anchor, and it does not
depend on the frame.
"""

import bpy
import numpy as np
from mathutils import Vector

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.heightfield import anchored
from ...cbt_terrain.field.lattice import ANCHOR_STEP, NEAR
from ...cbt_terrain.view.linear import inverse
from ..bridge import camera as cameras
from ..bridge.evaluated import anchor_of, raster_placement_of
from ..bridge.scene_origin import claim_origin, is_claimed, origin_of, set_origin
from ..ground.shifting import curves_of, keep_children, shift_location
from ..land import shaped_land
from ..session import live, session
from ..session.pauses import handlers_paused
from ..session.polls import ObjectModeOperator, cancelled_by_errors
from ..session.shot import frames_of

MAX_FRAMES = 24  # of a shot that are looked at
FOLLOWED = 0.5  # fraction of a move that shows that constraints have moved an object already


class MoveWorld(ObjectModeOperator, bpy.types.Operator):
    """Move all objects so that the camera's path, or without a camera the 3D cursor, is at the world's origin.
    Coordinates are precise there; far away they are rounded to centimetres and more"""

    bl_idname = "adaptive_terrain.move_world"
    bl_label = "Move World Here"
    bl_options = {"REGISTER", "UNDO"}

    @cancelled_by_errors
    def execute(self, context):
        """Move the scene, set the anchors of its terrains, and report the distance."""
        scene = context.scene
        terrains = [obj for obj in session.terrains_of(scene) if obj.adaptive_terrain.store]
        middle = middle_of_path(scene)
        # Metres of the world; a multiple of the step of anchors, and nothing for a path that is near already.
        by = -np.round(middle / ANCHOR_STEP) * ANCHOR_STEP if np.abs(middle).max() > NEAR else np.zeros(2)
        driven_names = move_world(context, by)
        for obj in terrains:
            set_anchor(obj, *nearest_anchor(obj))
        context.view_layer.update()
        for obj in terrains:
            live.show_soon(obj)
        for name in driven_names:
            self.report(
                {"WARNING"}, f"{name}: a driver or a track of its location was not moved, but its delta location"
            )
        east, north = (f"{value / 1000:+,.0f} km" for value in by)
        self.report({"INFO"}, f"The scene moved by {east} east and {north} north")
        return {"FINISHED"}


def middle_of_path(scene) -> np.ndarray:
    """Return x and y, float64 [2], of the middle of the box around the camera's path; of the 3D cursor without one.

    The path is the camera's places in up to MAX_FRAMES frames of the render range; the scene then returns to its frame.
    Raises TerrainError for a location that is not finite.
    """
    camera = cameras.active_camera(scene)
    if camera is None:
        return np.array(scene.cursor.location[:2], np.float64)
    frames, now, places = frames_of(scene), (scene.frame_current, scene.frame_subframe), []
    with handlers_paused():
        for frame in sorted(set(np.linspace(frames[0], frames[-1], MAX_FRAMES).round().astype(int).tolist())):
            scene.frame_set(frame)
            evaluated = camera.evaluated_get(bpy.context.evaluated_depsgraph_get())
            places.append(evaluated.matrix_world.translation[:2])
        scene.frame_set(now[0], subframe=now[1])
    places = np.array(places, np.float64)
    if not np.isfinite(places).all():
        raise TerrainError(f"The camera {camera.name!r} has a location that is not finite", fix="check its transform")
    return (places.min(axis=0) + places.max(axis=0)) / 2


def move_world(context, by: np.ndarray) -> list[str]:
    """Move all objects, the 3D cursor, viewports and the scene's origin by (x, y) metres of the world, float64 [2].

    Objects with a parent or a moved constraint target follow by themselves; linked ones stay. The scene loses its
    latitude and longitude. Return the names of objects whose location is driven: their delta location moves instead.
    """
    scene, step, driven_names = context.scene, Vector((*by, 0.0)), []
    if not by.any():
        return driven_names
    without_parent = [obj for obj in scene.objects if obj.parent is None and obj.library is None]
    shifted: set[int] = set()  # pointers of animation curves that are shifted already: objects may share an action
    # Objects with constraints come last: their targets may have moved them already.
    for obj in sorted(without_parent, key=lambda obj: len(obj.constraints) > 0):
        if obj.constraints:
            before = obj.matrix_world.translation.copy()
            context.view_layer.update()
            if (obj.matrix_world.translation - before).dot(step) > FOLLOWED * step.dot(step):
                continue  # a constraint's target has taken it along
        if not shift_location(obj, step, shifted):
            driven_names.append(obj.name)
    context.view_layer.update()
    scene.cursor.location += step
    for _window, area, _region, region_3d in cameras.viewports(context.window_manager):
        region_3d.view_location += step
        area.tag_redraw()
    origin = origin_of(scene)
    if origin is not None:
        moves = zip((origin.x, origin.y), by, origin.metres, strict=True)  # metres: in a unit of x and of y
        x, y = (coordinate - float(move) / metres for coordinate, move, metres in moves)
        was_claimed = is_claimed(scene)  # the origin is this extension's, and no other has changed it since
        set_origin(scene, origin._replace(x=x, y=y), latitude_longitude=None)
        if was_claimed:
            claim_origin(scene)
    return driven_names


def nearest_anchor(obj) -> tuple[float, float]:
    """Return the anchor of a terrain that is nearest to the world's origin, metres from the raster's middle."""
    x, y = inverse(raster_placement_of(obj))[:2, 3].tolist()
    return session.open_field(shaped_land.store_of(obj)).lattice.anchor_near(x, y)


def set_anchor(obj, x: float, y: float) -> None:
    """Make (x, y), metres from the raster's middle, the origin of a terrain's object; nothing moves in the world.

    Raises TerrainError for an animated rotation or scale: the object's path would be another. Also for an anchor
    outside of the raster, and for a raster whose position in its coordinate system is unknown.
    """
    by = np.array([x, y]) - anchor_of(obj)
    if not by.any():
        return
    anchored(session.open_field(shaped_land.store_of(obj)), x, y)  # only for its TerrainError
    if curves_of(obj.animation_data, "rotation_euler", "rotation_quaternion", "rotation_axis_angle", "scale"):
        raise TerrainError(
            f"The terrain {obj.name!r} has an animated rotation or scale, so its origin cannot be moved",
            fix="animate a parent of it instead",
        )
    basis = np.array(obj.matrix_basis, np.float64)[:3, :2]
    shift_location(obj, Vector((basis @ by).tolist()), shifted=set())  # no curves were shifted before
    obj.adaptive_terrain.anchor = (x, y)
    keep_children(obj, by)
