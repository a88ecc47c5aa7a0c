# SPDX-License-Identifier: GPL-3.0-or-later
"""The place of a camera: where a viewport looks from, or the view across a terrain with the best composition.

A viewport that looks through the camera of Set Up Scene stays where it is if Undo takes that camera away.
"""

import math
from typing import TYPE_CHECKING

import bpy
import numpy as np
from bpy.app.handlers import persistent
from mathutils import Matrix, Vector

from ...cbt_terrain.field.heightfield import HeightField
from ...cbt_terrain.importing.covered import covered_points
from ..importing.imported import imported_of
from ..land import shaped_land
from ..terrain import frame_terrain, sight
from . import daylight
from .built import CAMERA, find_built

if TYPE_CHECKING:
    from ...cbt_terrain.query.largest_part import PartSamples

SAMPLES = 129  # a side, of the heights that decide the view across
# Eyes that are compared for the view across: number a side, the fraction of the sides over which they are spread, and
# the number of directions at each.
EYES, SPREAD, VIEWS = 15, 0.9, 24
# Rays of a view: their angles from its middle, those in the middle half of the frame, and the distances of their
# samples as fractions of the shorter side.
RAYS, INNER, DISTANCES = np.radians(np.linspace(-30.0, 30.0, 13)), slice(3, 10), np.geomspace(0.015, 1.2, 40)
NEAR = 0.03  # fraction of the shorter side: an eye is above the ground within this distance
# Fractions of the shorter side and of the relief by which a low eye is above the ground, and the factor of a high eye.
ABOVE_SIDE, ABOVE_RELIEF, HIGHER = 0.012, 0.08, 2.0
PITCH = math.radians(-5.0)
BOTTOM = math.tan(PITCH - math.radians(19.0))  # of the frame: rise over distance
# Kinds of ground: up to the water level; above this fraction of the relief; else gentle, or steep like scree.
KINDS, HIGH, GENTLE = 4, 0.65, math.tan(math.radians(24.0))
DEPTHS = 0.09, 0.35  # fractions of the shorter side: ends of foreground and middle ground
# Rise over distance of the best summit, of the highest one with sky above it, and a step in the skyline between two
# rays that is the terrain's corner rather than a slope.
SUMMIT, HIGHEST, STEP = 0.12, 0.2, 0.1
FOREGROUND = 0.45  # part of the ground in the frame from which on the foreground is too much
# Points that faults of a view cost: for each unit of rise over distance, or for the whole ground in the frame.
CUT, LEAN, BEYOND, STEEP, DARK, TOO_NEAR = 30.0, 5.0, 35.0, 30.0, 1.5, 4.0
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


def view_across(obj, depsgraph) -> tuple[Matrix, float, bool]:
    """Return the matrix to the world of a camera over a terrain in the view with the best composition.

    It is over the largest part of the ground, if holes or wide gaps divide it. Also return half the length of that
    part, metres in the world: the distance of the point about which a viewport turns; and whether the ground is the
    shaped land, if there is a stack. Raises TerrainError without a store.
    """
    field, is_final = shaped_land.finished_field_of(obj, depsgraph)
    settings, imported = obj.adaptive_terrain, imported_of(obj.adaptive_terrain)
    part, water_level = _ground_of(field, covered_points(imported.covered) if imported is not None else None)
    scale, offset = settings.vertical_scale, settings.vertical_offset
    part = part._replace(heights=part.heights * scale + offset)
    eye, azimuth = _best_view(part, water_level * scale + offset)
    ahead = Vector((math.sin(azimuth), math.cos(azimuth), math.tan(PITCH)))
    to_world = obj.matrix_world
    turn = (to_world.to_3x3() @ -ahead).to_track_quat("Z", "Y").to_matrix().to_4x4()
    west, south, east, north = field.lattice.rectangle()
    fraction = math.hypot(np.ptp(part.x), np.ptp(part.y)) / math.hypot(east - west, north - south)
    distance = 0.5 * sight.diagonal(sight.box_of(obj)) * fraction
    return Matrix.Translation(to_world @ Vector(eye)) @ turn, distance, is_final


def _ground_of(field: HeightField, covered: np.ndarray | None) -> tuple["PartSamples", float]:
    """Return samples of a terrain's largest part in its own space, and the level of water.

    Ground up to this level counts as water that a view should show: the sea, or inland the lowest part (INLAND). Metres
    of the height map, without vertical scale and offset. Holes have the lowest height; a sea is flat at 0.
    covered: points where a file of a mosaic is, as in `sample_largest_part`.
    """
    from ...cbt_terrain.query.largest_part import sample_largest_part

    part = sample_largest_part(field, SAMPLES, covered)
    is_ground = part.is_ground & np.isfinite(part.heights)
    known = part.heights[is_ground]
    is_coast = (known <= 0.0).mean() >= MIN_SEA
    water_level = 0.0 if is_coast else float(np.quantile(known, INLAND))
    heights = np.where(is_ground, part.heights, known.min())
    heights = np.maximum(heights, water_level) if is_coast else heights
    return part._replace(heights=heights, is_ground=is_ground), water_level


def _best_view(part: "PartSamples", water_level: float) -> tuple[tuple, float]:
    """Return the eye and the azimuth, clockwise from +Y in radians, of the view with the best composition.

    part: has the lowest height where there is no ground. water_level: height up to which ground counts as water. The
    eyes are compared along one azimuth after the other; arrays are [eyes, rays, samples of a ray].
    """
    x, y, z, is_ground = part
    bottom, relief = float(z.min()), float(np.ptp(z)) or 1.0
    # The side of ground without gaps: a narrow valley across a large rectangle is seen from near.
    side = min(np.ptp(x), np.ptp(y)) * math.sqrt(is_ground.mean())
    north, east = np.gradient(z, y, x)  # rise of the ground over distance
    kinds = (z <= water_level) & is_ground, z > bottom + HIGH * relief, np.hypot(east, north) < GENTLE
    kind = np.select(kinds, range(KINDS - 1), KINDS - 1)

    eye_x, eye_y = _eyes(part, NEAR * side)
    ground = np.max(_nine_around(part, z, eye_x, eye_y, NEAR * side), axis=0)
    above = ABOVE_SIDE * side + ABOVE_RELIEF * relief
    eye_x, eye_y = np.tile(eye_x, 2), np.tile(eye_y, 2)
    eye_z = np.concatenate([ground + above, ground + HIGHER * above])
    best, found = -math.inf, None
    for azimuth in np.arange(VIEWS) * (math.tau / VIEWS):
        angles, away = azimuth + RAYS, side * DISTANCES
        at_x = eye_x[:, None, None] + np.sin(angles)[:, None] * away
        at_y = eye_y[:, None, None] + np.cos(angles)[:, None] * away
        inside = (x[0] <= at_x) & (at_x <= x[-1]) & (y[0] <= at_y) & (at_y <= y[-1])
        row, column = _nearest(at_y, y), _nearest(at_x, x)
        inside = np.logical_and.accumulate(inside & is_ground[row, column], axis=-1)  # up to the first gap
        rise = np.where(inside, (z[row, column] - eye_z[:, None, None]) / away, -np.inf)
        # Light of the sun of Set Up Scene on the ground, as a fraction of that on level ground.
        sun = azimuth + daylight.TURN
        light = 1.0 - (east * math.sin(sun) + north * math.cos(sun)) / math.tan(daylight.ELEVATION)
        score = _score(rise, kind[row, column], np.clip(light, 0.0, 2.0)[row, column])
        if score.max() > best:
            best, number = float(score.max()), int(score.argmax())
            found = (float(eye_x[number]), float(eye_y[number]), float(eye_z[number])), float(azimuth)
    return found


def _score(rise: np.ndarray, kind: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Return the score of the view from each eye: its variety and contrast of light less its faults.

    Variety is the entropy of the ground in the frame by kind and depth (foreground, middle ground, background): it is
    large if many of these 12 parts are seen and none prevails.

    Args:
        rise: height above the eye over distance of the samples of each ray, float64 [eyes, rays, samples]. -inf behind
            the terrain's border.
        kind: of ground, int [eyes, rays, samples], 0 .. KINDS - 1.
        light: on the ground, float64 [eyes, rays, samples], 1 on level ground.
    """
    horizon = np.maximum.accumulate(np.maximum(rise, BOTTOM), axis=-1)  # highest rise up to each sample
    shown = np.diff(horizon, axis=-1, prepend=BOTTOM)  # height in the frame that each sample fills
    frame = shown.sum(axis=(1, 2)).clip(1e-9)
    depth = np.searchsorted(DEPTHS, DISTANCES)
    view = np.arange(len(rise))[:, None, None]
    bins = ((len(DEPTHS) + 1) * view + depth) * KINDS + kind
    num_bins = len(rise) * (len(DEPTHS) + 1) * KINDS
    parts = np.bincount(bins.ravel(), shown.ravel(), num_bins).reshape(len(rise), -1) / frame[:, None]
    variety = -(parts * np.log(parts.clip(1e-9))).sum(axis=1)

    skyline = horizon[..., -1]
    summit = skyline[:, INNER].max(axis=1)
    score = variety - ((summit - SUMMIT) / SUMMIT) ** 2  # the summit is in the upper third
    score -= CUT * (skyline.max(axis=1) - np.minimum(summit, HIGHEST))  # nothing higher is at the frame's edges
    score -= LEAN * abs(skyline @ RAYS) / (RAYS @ RAYS)  # it is not all on one side
    score -= BEYOND * np.maximum(-skyline, 0.0).mean(axis=1)  # below the eye's level the terrain's border is seen
    score -= STEEP * np.maximum(abs(np.diff(skyline, axis=1)).max(axis=1) - STEP, 0.0)  # its corner before the sky
    score -= TOO_NEAR * np.maximum(parts[:, :KINDS].sum(axis=1) - FOREGROUND, 0.0)
    score -= DARK * (shown * np.maximum(1.0 - light, 0.0)).sum(axis=(1, 2)) / frame
    mean = (shown * light).sum(axis=(1, 2)) / frame
    return score + np.sqrt((shown * (light - mean[:, None, None]) ** 2).sum(axis=(1, 2)) / frame)  # light shows forms


def _eyes(part: "PartSamples", near: float) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y of the eyes that are compared, metres in the terrain's space.

    They are a grid over a terrain without gaps. Otherwise they are samples of ground with ground around them as far as
    `near`, metres, or where there is none, any samples of ground.
    """
    x, y, _, is_ground = part
    if is_ground.all():
        spread = np.linspace(-SPREAD / 2, SPREAD / 2, EYES)
        along = ((axis[0] + axis[-1]) / 2 + spread * np.ptp(axis) for axis in (x, y))
        return tuple(grid.ravel() for grid in np.meshgrid(*along))
    rows, columns = np.nonzero(is_ground)
    is_inner = np.all(_nine_around(part, is_ground, x[columns], y[rows], near), axis=0)
    inner = np.flatnonzero(is_inner) if is_inner.any() else np.arange(len(rows))
    inner = inner[np.unique(np.linspace(0, len(inner) - 1, EYES * EYES).round().astype(int))]
    return x[columns[inner]], y[rows[inner]]


def _nine_around(
    part: "PartSamples", values: np.ndarray, eye_x: np.ndarray, eye_y: np.ndarray, near: float
) -> list[np.ndarray]:
    """Return the values, of an array [m, n] over the part, of nine samples around each eye, `near` metres apart."""
    offsets = [(i, j) for i in (-near, 0.0, near) for j in (-near, 0.0, near)]
    return [values[_nearest(eye_y + j, part.y), _nearest(eye_x + i, part.x)] for i, j in offsets]


def _nearest(coordinates: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the numbers of the samples of `axis`, x or y of a part, nearest to some coordinates."""
    inside = np.clip(coordinates, axis[0], axis[-1])
    return np.rint((inside - axis[0]) / (axis[-1] - axis[0]) * (len(axis) - 1)).astype(int)


def clip_range(obj, eye: Vector) -> tuple[float, float]:
    """Return a clip range in metres that shows the whole terrain from an eye and keeps the depth buffer precise.

    It begins at NEAREST_CAMERA_START at the latest, so that near objects are not cut off.
    """
    box = sight.box_of(obj)
    furthest = float(np.linalg.norm(box - np.array(eye), axis=1).max())
    start, end = sight.clip_that_shows(box, furthest, FACTORY_CLIP)
    return min(start, frame_terrain.NEAREST_CAMERA_START), end


HANDLERS = {"undo_pre": on_undo_pre, "undo_post": on_undo_post}
