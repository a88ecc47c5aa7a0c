# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring a terrain into view: move viewports and extend clip ranges.

Viewports move without turning; one in camera view stays there. Cameras never move: their clip range grows, and the
panel warns if they do not see the terrain.
"""

import bpy
import numpy as np

from ...cbt_terrain.errors import TerrainError
from ..bridge import camera as cameras
from ..session import session
from ..session.polls import cancelled_by_errors
from ..text.numbers import length_text
from . import sight

MARGIN = 1.08  # factor of a viewport's distance: the terrain does not touch the border
VIEWPORT_SENSOR_MM = 72.0  # twice that of a camera: with the same lens a viewport sees twice as much
NEAREST_CAMERA_START = 1.0  # metres: the largest clip start, so that near objects stay visible


def frame_terrain(obj, depsgraph, viewports: list[tuple], always: bool) -> list[str]:
    """Move `viewports` to show the terrain, and extend their clip ranges and that of its camera to it.

    Return texts about the camera and about viewports that stay, each once; [] if there is nothing to tell. Raises
    TerrainError if the terrain has no store or no finite box.

    Args:
        viewports: (window, area, region, region_3d) each.
        always: also move a viewport that already shows the whole terrain.
    """
    box = sight.box_of(obj, depsgraph)
    texts = widen_camera(obj, depsgraph, box)
    for _window, area, region, region_3d in viewports:
        space = area.spaces.active
        if space.local_view is not None and not obj.local_view_get(space):
            texts.append("a viewport in local view stays as it is")
            continue
        if region_3d.view_perspective == "CAMERA":
            texts.append("a viewport in camera view stays there")
        elif always or not sight.shows_all(box, cameras.view_from_region(space, region, region_3d)):
            _move_view(space, region, region_3d, box, _visible_part(area, region, space))
        towards = region_3d.view_rotation.to_matrix().col[2]
        eye = np.array(region_3d.view_location + towards * region_3d.view_distance)
        furthest = float(np.linalg.norm(box - eye, axis=1).max())
        space.clip_start, space.clip_end = sight.clip_that_shows(box, furthest, (space.clip_start, space.clip_end))
        area.tag_redraw()
    return list(dict.fromkeys(texts))


def shown_viewports(window_manager, scene) -> list[tuple]:
    """Return (window, area, region, region_3d) of each viewport that shows the scene; none in the background."""
    if bpy.app.background:
        return []
    return [viewport for viewport in cameras.viewports(window_manager) if viewport[0].scene == scene]


def box_or_none(obj) -> np.ndarray | None:
    """Return the corners of a terrain's box in the world, float64 [8, 3]; None without a store or a finite box."""
    try:
        return sight.box_of(obj)
    except TerrainError:
        return None


def with_all_of(box: np.ndarray | None, viewports: list[tuple]) -> list[tuple]:
    """Return those of some viewports that show a whole box [8, 3]; [] for None.

    viewports: (window, area, region, region_3d) each.
    """
    return [] if box is None else [found for found in viewports if sight.shows_all(box, _view_of(*found))]


def _view_of(_window, area, region, region_3d):
    """Return the View of a viewport."""
    return cameras.view_from_region(area.spaces.active, region, region_3d)


def widen_camera(obj, depsgraph, box: np.ndarray) -> list[str]:
    """Extend the clip range of a terrain's camera to a box [8, 3] in the world.

    Return a text about the change, or about a linked camera that cannot be changed; [] if nothing has to change. The
    start grows to NEAREST_CAMERA_START at most.
    """
    camera = sight.camera_of(obj, depsgraph.scene)
    if camera is None:
        return []
    camera, data = camera.original, camera.original.data
    eye = np.array(camera.evaluated_get(depsgraph).matrix_world.translation)
    furthest = float(np.linalg.norm(box - eye, axis=1).max())
    before = data.clip_start, data.clip_end
    # At least the diagonal, so that all of the box is still seen after the camera has moved about it.
    if not np.isfinite(furthest) or before[1] >= max(furthest, sight.diagonal(box)):
        return []
    if data.library is not None:
        return [f"the camera {camera.name!r} is linked: raise its Clip End in its own file"]
    start, end = sight.clip_that_shows(box, furthest, before)
    data.clip_start, data.clip_end = max(before[0], min(start, NEAREST_CAMERA_START)), end
    return [f"the camera {camera.name!r} now sees from {length_text(data.clip_start)} to {length_text(end)}"]


def _visible_part(area, region, space) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top of the part of a region that sidebar, toolbar and headers leave visible.

    They are coordinates of the region, -1 .. 1: all of it if less than a quarter of a side is left.
    """
    left, right, bottom, top = region.x, region.x + region.width, region.y, region.y + region.height
    if not space.region_quadviews and bpy.context.preferences.system.use_region_overlap:
        for other in area.regions:
            if other.type == "WINDOW" or min(other.width, other.height) <= 1:
                continue
            if other.width > region.width / 2:  # a header above or below
                if other.y > region.y + region.height / 2:
                    top = min(top, other.y)
                else:
                    bottom = max(bottom, other.y + other.height)
            elif other.height > region.height / 2:  # the sidebar or the toolbar
                if other.x > region.x + region.width / 2:
                    right = min(right, other.x)
                else:
                    left = max(left, other.x + other.width)
    if right - left < region.width / 4 or top - bottom < region.height / 4:  # too little is left to frame in
        return -1.0, 1.0, -1.0, 1.0
    width, height = region.width / 2, region.height / 2
    return (
        (left - region.x) / width - 1,
        (right - region.x) / width - 1,
        (bottom - region.y) / height - 1,
        (top - region.y) / height - 1,
    )


def _move_view(space, region, region_3d, box: np.ndarray, visible: tuple[float, float, float, float]) -> None:
    """Move a viewport along its direction until a box fills the visible part of its region, with MARGIN.

    box: float64 [8, 3], corners in the world. visible: left, right, bottom and top of that part, -1 .. 1 in the region.
    """
    axes = np.array(region_3d.view_rotation.to_matrix(), np.float64)  # columns: right, up, towards the eye
    middle = (box.min(axis=0) + box.max(axis=0)) / 2
    across, up, towards = ((box - middle) @ axes).T
    larger = max(region.width, region.height)
    # Tangents of half of the field of view, horizontal and vertical: of the region, and of its visible part.
    tangents = np.array([region.width, region.height]) / larger * VIEWPORT_SENSOR_MM / 2 / space.lens
    left, right, bottom, top = visible
    wide, high = tangents * ((right - left) / 2, (top - bottom) / 2)
    # In perspective a corner is `distance - towards` before the eye, and in the frame if it is at least across / wide.
    towards = towards if region_3d.is_perspective else 0.0
    distance = float((np.maximum(abs(across) / wide, abs(up) / high) + towards).max()) * MARGIN
    if not distance > 0.0:
        return
    offset = tangents * ((left + right) / 2, (bottom + top) / 2) * distance  # metres: middle of the visible part
    region_3d.view_location = middle - axes[:, 0] * offset[0] - axes[:, 1] * offset[1]
    region_3d.view_distance = distance


class FrameTerrain(bpy.types.Operator):
    """Move this viewport back until it shows the whole terrain, and let viewport and camera see as far as it reaches.
    The camera stays in its place"""

    bl_idname = "adaptive_terrain.frame"
    bl_label = "Frame Terrain"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        """Return whether the active object is a terrain of this file, which `is_terrain` tells, with a store."""
        obj = context.object
        return obj is not None and session.is_terrain(obj) and bool(obj.adaptive_terrain.store)

    @cancelled_by_errors
    def execute(self, context):
        """Frame the active terrain in the viewport that was clicked, or in all viewports if a script calls."""
        viewports = shown_viewports(context.window_manager, context.scene)
        if context.area is not None and context.area.type == "VIEW_3D":
            viewports = [viewport for viewport in viewports if viewport[1] == context.area]
        # always: also viewports that already show the whole terrain
        texts = frame_terrain(context.object, context.evaluated_depsgraph_get(), viewports, always=True)
        if texts:
            self.report({"INFO"}, to_sentence(texts))
        return {"FINISHED"}


def to_sentence(texts: list[str]) -> str:
    """Join the texts of `frame_terrain` to one sentence."""
    sentence = "; ".join(texts)
    return f"{sentence[0].upper()}{sentence[1:]}."
