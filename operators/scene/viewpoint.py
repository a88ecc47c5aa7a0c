# SPDX-License-Identifier: GPL-3.0-or-later
"""The place of a camera: where a viewport looks from, or a view across the terrain towards its high ground."""

import math

import numpy as np
from mathutils import Matrix, Vector

from ...cbt_terrain.view.linear import length
from ..land import shaped_land
from ..session import session
from ..terrain import frame_terrain, sight

SAMPLES = 65  # a side, of the heights that decide the view across
EYE, NEAR = 0.42, 0.06  # of the shorter side: the eye's distance from the middle, the radius of the ground below it
ABOVE_SIDE, ABOVE_RELIEF = 0.02, 0.3  # parts of the shorter side and of the relief by which the eye is above that
PITCH = math.radians(-7.0)
LENS_MM, SENSOR_MM = 28.0, 36.0
FACTORY_CLIP = 0.1, 100.0  # metres, of a new camera


def viewport_of(context) -> tuple | None:
    """Return the space and the view of the viewport where an operator runs, or of the scene's largest one."""
    found = frame_terrain.shown_viewports(context.window_manager, context.scene)
    found = [view for view in found if view[1] == context.area] or found
    if not found:
        return None
    _, area, _, region_3d = max(found, key=lambda view: view[2].width * view[2].height)
    return area.spaces.active, region_3d


def lens_of(space) -> float:
    """Return the lens in mm of a camera that sees as much as a viewport."""
    return space.lens * SENSOR_MM / frame_terrain.VIEWPORT_SENSOR_MM


def look_from(region_3d, place: Matrix, distance: float) -> None:
    """Move a viewport to a camera's place; it turns about a point `distance` metres ahead."""
    region_3d.view_perspective = "PERSP"
    region_3d.view_rotation = place.to_quaternion()
    region_3d.view_distance = distance
    region_3d.view_location = place @ Vector((0.0, 0.0, -distance))


def across(obj) -> Matrix:
    """Return the place of a camera at the low side of a terrain that looks across it, towards the high side."""
    x, y, z = _heights(obj)
    side, low, high = min(np.ptp(x), np.ptp(y)), float(z.min()), float(z.max())
    rise = [float(((z - z.mean()) * axis).sum() / (axis * axis).sum()) for axis in (x, y)]
    slope = length(rise)
    uphill = np.array(rise) / slope if slope > 1e-9 else np.array([0.0, 1.0])
    eye = -EYE * side * uphill
    near = (x - eye[0]) ** 2 + (y - eye[1]) ** 2 <= (NEAR * side) ** 2
    ground = float(z[near].max()) if near.any() else high
    height = ground + ABOVE_SIDE * side + ABOVE_RELIEF * (high - low)
    ahead = Vector((*uphill, math.tan(PITCH)))
    placed = obj.matrix_world
    turn = (placed.to_3x3() @ -ahead).to_track_quat("Z", "Y").to_matrix().to_4x4()
    return Matrix.Translation(placed @ Vector((*eye, height))) @ turn


def _heights(obj) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return some samples of a terrain in its own space: x, y and height, float64 [n] metres."""
    settings = obj.adaptive_terrain
    field = session.open_field(shaped_land.store_of(obj))
    lattice = field.lattice
    columns = np.unique(np.linspace(0, lattice.width - 1, SAMPLES).round().astype(int))
    rows = np.unique(np.linspace(0, lattice.height - 1, SAMPLES).round().astype(int))
    heights = field.heights(*np.ix_(rows, columns)) * settings.vertical_scale + settings.vertical_offset
    x = (columns - (lattice.width - 1) / 2) * lattice.step_x
    y = (rows - (lattice.height - 1) / 2) * lattice.step_y
    x, y = np.meshgrid(x, y)
    known = np.isfinite(heights)
    return x[known], y[known], heights[known]


def clip_range(obj, eye: Vector) -> tuple[float, float]:
    """Return a clip range that shows the whole terrain from an eye and keeps the depth buffer precise."""
    box = sight.box_of(obj)
    furthest = float(np.linalg.norm(box - np.array(eye), axis=1).max())
    start, end = sight.clip_that_shows(box, furthest, FACTORY_CLIP)
    return min(start, frame_terrain.NEAREST_CAMERA_START), end
