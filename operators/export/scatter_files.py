# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of a scatter as a CSV file: one line a point, in the world, for any program that reads tables."""

import numpy as np
from mathutils import Matrix

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.run.partial_files import written_beside
from ...cbt_terrain.scatter.points import ScatterPoints
from ...cbt_terrain.view.linear import determinant, product

COLUMNS = "id,x,y,z,scale,rotation_w,rotation_x,rotation_y,rotation_z,normal_x,normal_y,normal_z,variant\n"
ROW = "%d" + ",%.9g" * 11 + ",%d\n"  # nine digits are all of a float32
ROWS = 1 << 16  # at a time
SAME = 1e-5  # float32 matrices are no better


def write_points_csv(path, points: ScatterPoints, placement: np.ndarray) -> None:
    """Write the points of a scatter as CSV in the world: metres, z up, a quaternion, and the scale of an instance.

    points: their sizes are those of the world. placement: matrix from the points' space to the world, float64 [4, 4].
    Raises TerrainError if it mirrors or does not scale all axes alike, and OSError.
    """
    linear = placement[:3, :3]
    scale = np.cbrt(determinant(linear))
    turn = linear / scale if scale > 0 else np.zeros((3, 3))
    if not np.abs(product(turn, turn.T) - np.eye(3)).max() < SAME:  # no rotation
        raise TerrainError(
            f"{path} cannot be written: the scatter, or its terrain, is mirrored or not scaled alike along all axes, "
            "which a rotation and a scale cannot express",
            fix="apply its scale",
        )
    positions = product(points.positions, linear.T) + placement[:3, 3]
    normals, rotation = (
        product(points.normals, turn.T),
        _multiply_quaternions(tuple(Matrix(turn).to_quaternion()), points.rotation),
    )
    with written_beside(path) as partial, partial.open("w", encoding="ascii", newline="") as file:
        file.write(COLUMNS)
        for first in range(0, len(points), ROWS):
            block = slice(first, first + ROWS)
            floats = np.column_stack([array[block] for array in (positions, points.size, rotation, normals)])
            rows = zip(points.id[block].tolist(), floats.tolist(), points.variant[block].tolist(), strict=True)
            file.writelines(ROW % (number, *values, variant) for number, values, variant in rows)


def _multiply_quaternions(by: tuple[float, float, float, float], rotation: np.ndarray) -> np.ndarray:
    """Return quaternions (w, x, y, z), float64 [n, 4], that turn by `rotation` first and then by `by`."""
    a, b, c, d = by
    w, x, y, z = rotation.astype(np.float64).T
    turned = a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y
    return np.column_stack([*turned, a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w])
