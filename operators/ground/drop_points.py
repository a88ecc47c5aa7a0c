# SPDX-License-Identifier: GPL-3.0-or-later
"""Drop each point of a curve to the ground along the world's Z axis."""

import numpy as np
from mathutils import Matrix, Vector

from . import world_ground


def drop_points(obj, world: Matrix, ground, offset: float) -> str:
    """Move the control points, with their handles, of the curve object `obj` with the matrix `world`.

    Points without ground stay. Returns "", or the end of a sentence that explains why nothing moves.
    """
    curve = obj.data
    if curve.library is not None or curve.override_library is not None:
        return "has a curve that is linked from a library; make it local"
    if curve.users > 1:
        return "shares its curve with others; make it a single user"
    if curve.shape_keys is not None:
        return "has shape keys, which hold the points; remove them"
    if curve.dimensions == "2D":
        return "is a flat curve; set its Shape to 3D"
    points = [point for spline in curve.splines for point in (*spline.bezier_points, *spline.points)]
    if not points:
        return "has no points"
    if world.determinant() == 0.0:
        return "has a scale of 0; give it another"
    places = np.array([world @ point.co.to_3d() for point in points])
    heights = world_ground.below(ground, places).heights
    if not np.isfinite(heights).any():
        return "has no ground above or below its points"
    up = world.to_3x3().inverted() @ Vector((0.0, 0.0, 1.0))
    for point, place, height in zip(points, places, heights.tolist(), strict=True):
        if np.isfinite(height):
            _shift(point, up * (height + offset - place[2]))
    curve.update_tag()
    return ""


def _shift(point, by: Vector) -> None:
    if hasattr(point, "handle_left"):
        handles = point.handle_left + by, point.handle_right + by
        point.co, point.handle_left, point.handle_right = point.co + by, *handles
    else:
        point.co = (*(point.co.to_3d() + by), point.co.w)
