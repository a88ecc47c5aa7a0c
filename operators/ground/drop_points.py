# SPDX-License-Identifier: GPL-3.0-or-later
"""Drop each point of a curve to the ground along the world's Z axis."""

import numpy as np
from mathutils import Matrix, Vector

from ...cbt_terrain.errors import TerrainError
from . import world_ground
from .vertical_moves import is_linked


def drop_points(obj, world: Matrix, ground, offset: float) -> None:
    """Move each control point of a curve object, with its handles, to the ground along the world's Z axis.

    Points without ground stay. Raises TerrainError if none can be moved.

    Args:
        world: the object's matrix to the world.
        ground: list of WorldGround.
        offset: metres above the ground.
    """
    curve, name = obj.data, f"The object {obj.name!r}"
    if is_linked(curve):
        raise TerrainError(f"{name} has a curve that is linked from a library", fix="make it local")
    if curve.users > 1:
        raise TerrainError(f"{name} shares its curve with others", fix="make it a single user")
    if curve.shape_keys is not None:
        raise TerrainError(f"{name} has shape keys, which hold the points", fix="remove them")
    if curve.dimensions == "2D":
        raise TerrainError(f"{name} is a flat curve", fix="set its Shape to 3D")
    points = [point for spline in curve.splines for point in (*spline.bezier_points, *spline.points)]
    if not points:
        raise TerrainError(f"{name} has a curve without points", fix="add some")
    if world.determinant() == 0.0:
        raise TerrainError(f"{name} has a scale of 0", fix="give it another")
    positions = np.array([world @ point.co.to_3d() for point in points])
    heights = world_ground.find_below(ground, positions).heights
    if not np.isfinite(heights).any():
        raise TerrainError(f"{name} has no ground above or below its points", fix="move it over the terrain")
    up = world.to_3x3().inverted() @ Vector((0.0, 0.0, 1.0))  # a metre up in the world, in the curve's space
    for point, position, height in zip(points, positions, heights.tolist(), strict=True):
        if np.isfinite(height):
            _move_point(point, up * (height + offset - position[2]))
    curve.update_tag()


def _move_point(point, by: Vector) -> None:
    """Move a control point and its handles by a vector of the curve's space."""
    if hasattr(point, "handle_left"):
        handles = point.handle_left + by, point.handle_right + by
        point.co, point.handle_left, point.handle_right = point.co + by, *handles
    else:
        point.co = (*(point.co.to_3d() + by), point.co.w)
