# SPDX-License-Identifier: GPL-3.0-or-later
"""The place of a camera: where a viewport looks from, or the view that shows most kinds of ground.

A viewport that looks through the camera of Set Up Scene stays where it is if Undo takes that camera away.
"""

import math

import bpy
import numpy as np
from bpy.app.handlers import persistent
from mathutils import Matrix, Vector

from ..land import shaped_land
from ..terrain import frame_terrain, sight
from .built import CAMERA, find_built

SAMPLES = 129  # a side, of the heights that decide the view across
# Eyes that are compared for the view across: number a side, the fraction of the sides over which they are spread, and
# the number of directions at each.
EYES, SPREAD, VIEWS = 15, 0.84, 24
# Rays of a view: their angles from its middle, and the distances of their samples as fractions of the shorter side.
RAYS, DISTANCES = np.radians(np.linspace(-30.0, 30.0, 9)), np.geomspace(0.015, 1.0, 28)
NEAR = 0.03  # fraction of the shorter side: an eye is above the ground within this distance
ABOVE_SIDE, ABOVE_RELIEF = 0.012, 0.08  # fractions of the shorter side and of the relief by which it is above
PITCH = math.radians(-7.0)
BOTTOM = math.tan(PITCH - math.radians(19.0))  # of the frame: rise over distance
GENTLE = math.tan(math.radians(24.0))  # ground that is no scree
# Height in the frame, as rise over distance, at which a view shows enough of: water or lowest ground, gentle ground in
# the lower half of the relief, and variation of the skyline.
ENOUGH_LOW, ENOUGH_GENTLE, ENOUGH_SKYLINE = 0.05, 0.2, 0.04
SKYLINE, ENOUGH_OFF = 0.03, 0.1  # rise over distance of the best skyline, and the difference that costs one point
EDGE = 2.5  # weight of the terrain's border where it stands before the sky
# As in Add Water: land is a coast if this fraction of it is at 0 m or lower; inland, this fraction counts as water.
MIN_SEA, INLAND = 0.01, 0.05
LENS_MM, SENSOR_MM = 28.0, 36.0
FACTORY_CLIP = 0.1, 100.0  # metres, of a new camera
_has_built_camera = False  # before an Undo: the scene's camera is that of Set Up Scene


def viewport_of(context) -> tuple | None:
    """Return window, area, region and `region_3d` of the viewport where an operator runs, or of the largest one.

    None if no window shows the scene in a viewport.
    """
    found = frame_terrain.shown_viewports(context.window_manager, context.scene)
    found = [view for view in found if view[1] == context.area] or found
    return max(found, key=lambda view: view[2].width * view[2].height, default=None)


def lens_of(space) -> float:
    """Return the lens in mm of a camera that sees as much as a viewport."""
    return space.lens * SENSOR_MM / frame_terrain.VIEWPORT_SENSOR_MM


def look_from(region_3d, camera_to_world: Matrix, distance: float) -> None:
    """Move a viewport to a camera's matrix in the world; it turns about a point `distance` metres ahead."""
    region_3d.view_perspective = "PERSP"
    region_3d.view_rotation = camera_to_world.to_quaternion()
    region_3d.view_distance = distance
    region_3d.view_location = camera_to_world @ Vector((0.0, 0.0, -distance))


def look_through_camera(window, area, region, region_3d) -> None:
    """Let a viewport look through the scene's camera, and fit its frame, unless it has chosen another camera."""
    if not area.spaces.active.use_local_camera:
        region_3d.view_perspective = "CAMERA"
        with bpy.context.temp_override(window=window, area=area, region=region):
            bpy.ops.view3d.view_center_camera()


def _shows_built_camera(scene) -> bool:
    """Return whether the scene's camera is that of Set Up Scene."""
    return scene.camera is not None and scene.camera == find_built(scene, CAMERA)


@persistent
def on_undo_pre(scene, _unused=None) -> None:
    """Note whether the scene's camera is that of Set Up Scene."""
    global _has_built_camera
    _has_built_camera = _shows_built_camera(scene)


@persistent
def on_undo_post(scene, _unused=None) -> None:
    """Let viewports leave the camera's view after Undo of Set Up Scene.

    The camera before may be inside the ground, or missing.
    """
    if not _has_built_camera or _shows_built_camera(scene):
        return
    for *_, region_3d in frame_terrain.shown_viewports(bpy.context.window_manager, scene):
        if region_3d.view_perspective == "CAMERA":
            region_3d.view_perspective = "PERSP"


def view_across(obj) -> Matrix:
    """Return the matrix to the world of a camera over a terrain in the view that shows most kinds of ground.

    Raises TerrainError without a store.
    """
    settings = obj.adaptive_terrain
    x, y, z, water_level = _heights(obj)
    scale, offset = settings.vertical_scale, settings.vertical_offset
    z, water_level = z * scale + offset, water_level * scale + offset
    eye, azimuth = _best_view(x, y, z, water_level)
    ahead = Vector((math.sin(azimuth), math.cos(azimuth), math.tan(PITCH)))
    to_world = obj.matrix_world
    turn = (to_world.to_3x3() @ -ahead).to_track_quat("Z", "Y").to_matrix().to_4x4()
    return Matrix.Translation(to_world @ Vector(eye)) @ turn


def _heights(obj) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return samples of a terrain in its own space, x [n], y [m] and height [m, n], and the level of water.

    Ground up to this level counts as water that a view should show: the sea, or inland the lowest part (INLAND). Metres
    of the height map, without vertical scale and offset. Holes have the lowest height; a sea is flat at 0.
    """
    field = shaped_land.field_of(obj)
    lattice = field.lattice
    columns = np.unique(np.linspace(0, lattice.width - 1, SAMPLES).round().astype(int))
    rows = np.unique(np.linspace(0, lattice.height - 1, SAMPLES).round().astype(int))
    heights = field.heights(*np.ix_(rows, columns)).astype(np.float64)
    known = heights[np.isfinite(heights)]
    is_coast = (known <= 0.0).mean() >= MIN_SEA
    water_level = 0.0 if is_coast else float(np.quantile(known, INLAND))
    heights = np.where(np.isfinite(heights), heights, known.min())
    x = (columns - (lattice.width - 1) / 2) * lattice.step_x - lattice.anchor_x
    y = (rows - (lattice.height - 1) / 2) * lattice.step_y - lattice.anchor_y
    return x, y, np.maximum(heights, water_level) if is_coast else heights, water_level


def _best_view(x: np.ndarray, y: np.ndarray, z: np.ndarray, water_level: float) -> tuple[tuple, float]:
    """Return the eye and the azimuth, clockwise from +Y in radians, of the view that shows most kinds of ground.

    x [n], y [m]: positions of the heights z [m, n], metres. water_level: height up to which ground counts as water.
    The eyes are compared along one azimuth after the other; arrays are [eyes, rays, samples of a ray], with fewer axes
    after a mean. RAYS: angles from the azimuth; DISTANCES: of a ray's samples, in shorter sides of the terrain; BOTTOM:
    rise over distance at the frame's lower edge. A score is the sum of the seen kinds, 1 each at most, less the faults
    of the skyline and the border.
    """
    side, bottom, relief = min(np.ptp(x), np.ptp(y)), float(z.min()), float(np.ptp(z)) or 1.0
    slope = np.hypot(*np.gradient(z, y, x))
    is_gentle = (slope < GENTLE) & (z < bottom + relief / 2) & (z > water_level)

    def nearest(coordinates: np.ndarray, axis: np.ndarray) -> np.ndarray:
        """Return the numbers of the samples of `axis`, x or y, nearest to some coordinates."""
        return np.rint((coordinates - axis[0]) / (axis[-1] - axis[0]) * (len(axis) - 1)).astype(int)

    # Eyes: on a grid over the terrain, each above the highest of nine samples around it.
    spread = np.linspace(-SPREAD / 2, SPREAD / 2, EYES)
    eyes_along = ((axis[0] + axis[-1]) / 2 + spread * np.ptp(axis) for axis in (x, y))
    eye_x, eye_y = (grid.ravel() for grid in np.meshgrid(*eyes_along))
    around = [(i, j) for i in (-NEAR, 0.0, NEAR) for j in (-NEAR, 0.0, NEAR)]
    ground = np.max([z[nearest(eye_y + j * side, y), nearest(eye_x + i * side, x)] for i, j in around], axis=0)
    eye_z = ground + ABOVE_SIDE * side + ABOVE_RELIEF * relief
    best, found = -math.inf, None
    for azimuth in np.arange(VIEWS) * (math.tau / VIEWS):
        # Samples along the rays of every eye, and which ones are seen: those that rise above all nearer samples.
        angles = azimuth + RAYS
        away = side * DISTANCES
        at_x = eye_x[:, None, None] + np.sin(angles)[:, None] * away
        at_y = eye_y[:, None, None] + np.cos(angles)[:, None] * away
        inside = (x[0] <= at_x) & (at_x <= x[-1]) & (y[0] <= at_y) & (at_y <= y[-1])
        row, column = nearest(np.clip(at_y, y[0], y[-1]), y), nearest(np.clip(at_x, x[0], x[-1]), x)
        rise = np.where(inside, (z[row, column] - eye_z[:, None, None]) / away, -np.inf)
        horizon = np.maximum.accumulate(np.maximum(rise, BOTTOM), axis=-1)  # highest rise up to each sample
        shown = np.diff(horizon, axis=-1, prepend=BOTTOM)  # height in the frame that each sample fills
        # Parts of the score: the height in the frame that each kind of ground fills, in the mean of the rays.
        flat, gentle = z[row, column] <= water_level, is_gentle[row, column]
        low_seen, gentle_seen = ((shown * kind).sum(axis=-1).mean(axis=-1) for kind in (flat, gentle))
        skyline = horizon[..., -1].std(axis=-1)  # an uneven skyline counts as a kind of ground
        last = np.maximum(inside.sum(axis=-1) - 1, 0)[..., None]  # last sample of a ray on the terrain
        # The border of the terrain is seen where a ray's last sample is below the eye and not hidden.
        edge = np.take_along_axis(rise, last, axis=-1)[..., 0]
        is_edge_seen = (edge < 0.0) & (np.take_along_axis(shown, last, axis=-1)[..., 0] > 0.0)
        cut_off = (is_edge_seen * (1.0 - DISTANCES[last[..., 0]])).mean(axis=-1)  # worse the nearer the border is
        off = abs(horizon[..., -1].mean(axis=-1) - SKYLINE) / ENOUGH_OFF  # a skyline too high or low in the frame
        score = np.minimum(low_seen / ENOUGH_LOW, 1.0) + np.minimum(gentle_seen / ENOUGH_GENTLE, 1.0)
        score = score + np.minimum(skyline / ENOUGH_SKYLINE, 1.0) - off - EDGE * cut_off
        if score.max() > best:
            best, number = float(score.max()), int(score.argmax())
            found = (float(eye_x[number]), float(eye_y[number]), float(eye_z[number])), float(azimuth)
    return found


def clip_range(obj, eye: Vector) -> tuple[float, float]:
    """Return a clip range in metres that shows the whole terrain from an eye and keeps the depth buffer precise.

    It begins at NEAREST_CAMERA_START at the latest, so that near objects are not cut off.
    """
    box = sight.box_of(obj)
    furthest = float(np.linalg.norm(box - np.array(eye), axis=1).max())
    start, end = sight.clip_that_shows(box, furthest, FACTORY_CLIP)
    return min(start, frame_terrain.NEAREST_CAMERA_START), end


HANDLERS = {"undo_pre": on_undo_pre, "undo_post": on_undo_post}
