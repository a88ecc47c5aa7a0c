# SPDX-License-Identifier: GPL-3.0-or-later
"""Corners of what stands on the ground: an object with all that is parented to it and all that it instances."""

import numpy as np
from mathutils import Matrix, Vector

NOTHING = np.zeros((0, 3))
GEOMETRY = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "GPENCIL", "GREASEPENCIL"}


def corners_of(obj, depsgraph) -> np.ndarray:
    """float64 [n, 3], metres of the world: of the boxes around an object's geometry, that of its children which renders
    show and of collections that they instance; its origin where there is none."""
    shown = [obj, *(child for child in obj.children_recursive if not child.hide_render)]
    found = [_own_corners(item.evaluated_get(depsgraph)) for item in shown]
    corners = np.concatenate(found)
    if not len(corners):
        return np.array([obj.evaluated_get(depsgraph).matrix_world.translation], np.float64)
    return corners


def _own_corners(evaluated) -> np.ndarray:
    found = [NOTHING]
    if evaluated.type in GEOMETRY:
        found.append(_of_box(evaluated, evaluated.matrix_world))
    collection = evaluated.instance_collection if evaluated.instance_type == "COLLECTION" else None
    if collection is not None:
        place = evaluated.matrix_world @ Matrix.Translation(-collection.instance_offset)
        for item in collection.all_objects:
            if item.type in GEOMETRY:
                found.append(_of_box(item, place @ item.matrix_world))
    return np.concatenate(found)


def _of_box(obj, matrix: Matrix) -> np.ndarray:
    return np.array([matrix @ Vector(corner) for corner in obj.bound_box], np.float64)
