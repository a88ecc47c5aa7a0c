# SPDX-License-Identifier: GPL-3.0-or-later
"""The choice of the views for which a terrain is refined in a window: those of a camera or of the viewports."""

import bpy

from ..bridge import camera as cameras
from ..importing.imported import imported_of
from ..scene.defaults import is_default_camera
from .properties import SCENE_CAMERA, VIEWPORT_VIEW


def follows_viewport(obj, scene) -> bool:
    """Return whether viewports refine a terrain for their own views.

    They do if its settings choose it. In a window they also do if the settings choose the scene's camera and that
    camera is not placed. Without a window the scene's camera always counts, and a missing one is an error.
    """
    source = obj.adaptive_terrain.camera_source
    if source == SCENE_CAMERA and not bpy.app.background:
        return not is_placed(cameras.active_camera(scene), obj)
    return source == VIEWPORT_VIEW


def is_placed(camera, obj) -> bool:
    """Return whether a user may have placed a camera for a picture of a terrain.

    False for None, for the unchanged camera of Blender's start-up file, and for a camera below the terrain.
    """
    return camera is not None and not is_default_camera(camera) and not _is_below(camera, obj)


def _is_below(camera, obj) -> bool:
    """Return whether a camera is inside the terrain's outline and below all heights of its raster.

    False without a readable store.
    """
    settings = obj.adaptive_terrain
    imported = imported_of(settings)
    if imported is None:
        return False
    local = obj.matrix_world.inverted_safe() @ camera.matrix_world.translation
    bottom = min(height * settings.vertical_scale + settings.vertical_offset for height in imported.heights_m)
    # Along x and y; a place in the object's space is place + anchor metres from the raster's middle.
    sides = zip(local, settings.anchor, imported.extent_m, strict=False)
    return local.z < bottom and all(abs(place + anchor) <= extent / 2 for place, anchor, extent in sides)
