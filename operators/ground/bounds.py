# SPDX-License-Identifier: GPL-3.0-or-later
"""Bounding-box corners of an object with its children and its instanced collections."""

import numpy as np
from mathutils import Matrix, Vector

NOTHING = np.zeros((0, 3))
GEOMETRY = {"MESH", "CURVE", "SURFACE", "META", "FONT", "CURVES", "POINTCLOUD", "VOLUME", "GPENCIL", "GREASEPENCIL"}


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
