# SPDX-License-Identifier: GPL-3.0-or-later
"""Visibility of a terrain: its box in the world against the view of a camera or a viewport."""

import math

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.view.linear import inverse
from ...cbt_terrain.view.view import ORTHOGRAPHIC, PANORAMIC, PERSPECTIVE, View
from ..bridge import camera as cameras
from ..bridge.evaluated import placement_of
from ..bridge.scene_paths import no_heights
from ..land import shaped_land
from .properties import CHOSEN_CAMERA

NEAR_TO_FAR = 1e-5  # ratio of a clip range, as in Blender's viewport, for the precision of the depth buffer
FAR_OUT = 2.0**17  # metres; from here on neighbouring float32 are 1.6 cm apart
SMALL = 0.1  # fraction of a frame that a terrain must span to count as shown


def box_of(obj, depsgraph=None) -> np.ndarray:
    """Return the corners of the terrain's box in the world, float64 [8, 3].

    They bound all heights of the raster, not of a mesh. depsgraph: whose evaluated transform and settings count, None
    for the original's. Raises TerrainError without a store, for a matrix that flattens the terrain and for one that is
    not finite.
    """
    terrain = obj if depsgraph is None else obj.evaluated_get(depsgraph)
    settings = terrain.adaptive_terrain
    if not settings.store:
        raise no_heights(obj)
    field = shaped_land.field_of(obj)
    west, south, east, north = field.lattice.rectangle()
    heights = [h * settings.vertical_scale + settings.vertical_offset for h in (field.min_height, field.max_height)]
    corners = np.array([(i, j, h) for i in (west, east) for j in (south, north) for h in heights])
    matrix = placement_of(terrain)
    box = (matrix[:3, :3] @ corners.T).T + matrix[:3, 3]
    if not np.isfinite(box).all():
        raise TerrainError(
            f"The terrain {obj.name!r} has a location that is not finite", fix="check its transform and scale"
        )
    return box


def diagonal(box: np.ndarray) -> float:
    """Return the diagonal of a box [8, 3] in metres."""
    return float(np.linalg.norm(np.ptp(box, axis=0)))


def depths(box: np.ndarray, view: View) -> np.ndarray:
    """Return the depths of the corners, float64 [8] metres along the view, or distances for a panorama."""
    seen = _in_camera(box, view)
    return np.linalg.norm(seen, axis=1) if view.kind == PANORAMIC else -seen[:, 2]


def is_cut_off(box: np.ndarray, view: View) -> bool:
    """Return whether the clip range cuts off the far end of the box, or begins behind all of it.

    A range whose start is not before its end, as of a View without clipping, cuts off nothing.
    """
    start, end = view.clip
    far = depths(box, view).max()
    return start < end and (far > end or 0.0 < far < start)


def is_in_sight(box: np.ndarray, view: View) -> bool:
    """Return False only if the whole box is outside the frame; `is_cut_off` tests the clip range.

    box: its corners in the world, float64 [8, 3]. The frame is -w <= x, y <= w in homogeneous coordinates.
    """
    if view.kind == PANORAMIC:
        return True
    x, y, w = _in_frame(box, view)
    outside = [x > w, x < -w, y > w, y < -w] + ([w <= 0] if view.kind == PERSPECTIVE else [])
    return not any(side.all() for side in outside)


def shows_all(box: np.ndarray, view: View) -> bool:
    """Return whether the frame shows the whole box, with at least SMALL of its width or height, and no clipping.

    False for panoramas, whose frames are not tested.
    """
    if view.kind == PANORAMIC or is_cut_off(box, view):
        return False
    x, y, w = _in_frame(box, view)
    if (w <= 0).any() or (depths(box, view) < view.clip[0]).any():
        return False
    x, y = x / w, y / w
    # The frame is -1 .. 1, so its width and height are 2.
    return max(abs(x).max(), abs(y).max()) <= 1.0 and max(np.ptp(x), np.ptp(y)) >= 2.0 * SMALL


def _in_camera(box: np.ndarray, view: View) -> np.ndarray:
    """Transform the corners of a box [8, 3] from the world to the view's camera, which looks along -z."""
    matrix = view.world_to_camera
    return (matrix[:3, :3] @ box.T).T + matrix[:3, 3]


def _in_frame(box: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return homogeneous x, y and w of a box's corners, [8] each; in the frame x and y are -w .. w."""
    points = np.c_[_in_camera(box, view), np.ones(len(box))]
    x, y, _, w = view.projection @ points.T
    return x, y, np.ones(len(box)) if view.kind == ORTHOGRAPHIC else w


def is_below_ground(obj, point: np.ndarray) -> bool:
    """Return whether a point of the world, float64 [3], is below the nearest sample of the terrain.

    False beyond the raster, in holes and for a transform that cannot be inverted.
    """
    settings = obj.adaptive_terrain
    field = shaped_land.field_of(obj)
    matrix = np.array(obj.matrix_world, np.float64)
    try:
        local = inverse(matrix) @ [*point, 1.0]  # in the terrain's space
    except np.linalg.LinAlgError:
        return False
    (west, south, east, north), lattice = field.lattice.rectangle(), field.lattice
    if not (west <= local[0] <= east and south <= local[1] <= north):
        return False
    column, row = round((local[0] - west) / lattice.step_x), round((local[1] - south) / lattice.step_y)
    height = float(field.heights(row, column)) * settings.vertical_scale + settings.vertical_offset
    return math.isfinite(height) and local[2] < height


def is_far_out(point) -> bool:
    """Return whether float32 rounds coordinates of a point of the world, in metres, to a centimetre or more."""
    return max(abs(point[0]), abs(point[1])) >= FAR_OUT


def camera_of(obj, scene):
    """Return the camera for which a render refines the terrain: the chosen one or the scene's; None without one.

    None also if the chosen object is not a camera.
    """
    settings = obj.adaptive_terrain
    camera = settings.camera if settings.camera_source == CHOSEN_CAMERA else cameras.active_camera(scene)
    return camera if camera is not None and camera.type == "CAMERA" else None


def view_of_camera(scene, camera) -> View:
    """Return the current view of a camera. Raises TerrainError for an invalid camera."""
    return cameras.view_from_camera(scene, camera, camera.matrix_world, cameras.render_resolution(scene))


def clip_that_shows(box: np.ndarray, furthest: float, clip: tuple[float, float]) -> tuple[float, float]:
    """Return a clip range (metres) that includes a box whose furthest corner is `furthest` away.

    The end of `clip` stays if it is far enough. Otherwise it becomes a round number, at least twice as far as needed,
    and the start grows with it for the precision of the depth buffer. The start is then limited to a hundredth of the
    needed distance: `furthest`, or the box's diagonal if that is longer.
    """
    start, end = clip
    needed = max(furthest, diagonal(box))
    if end < needed:
        end = round_up(2.0 * needed)
        start = max(start, NEAR_TO_FAR * end)
    return min(start, needed / 100.0), end


def round_up(value: float) -> float:
    """Round a positive number up to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * (1 - 1e-9))
