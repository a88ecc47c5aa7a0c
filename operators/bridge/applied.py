# SPDX-License-Identifier: GPL-3.0-or-later
"""Apply and Set Origin change an object's transform and its mesh, so that it stays in the world. These find that out
and take it back, for a mesh that is computed in the object's space.
"""

from dataclasses import dataclass

import numpy as np
from mathutils import Matrix

from .evaluated import transform_points

POINTS = 8  # vertices that are compared
STATES = 32  # that are remembered
TOLERANCE = 1e-5  # of the size of the mesh: Blender transforms vertices in float32


@dataclass
class Placed:
    """Some positions of a written mesh, float64 [n, 3], and the basis matrix of its object."""

    points: np.ndarray
    basis: Matrix


def remember(written: dict[int, Placed], obj) -> None:
    """Add the present state of an object to the states with its last written meshes, by number of vertices.

    Undo and Redo bring earlier ones back.
    """
    count = len(obj.data.vertices)
    written.pop(count, None)
    written[count] = Placed(_points_of(obj.data), obj.matrix_basis.copy())
    if len(written) > STATES:
        del written[next(iter(written))]


def is_as_placed(obj, before: Placed) -> bool:
    """Return whether the mesh of an object is the written one; the state then gets the object's present transform."""
    if not np.array_equal(_points_of(obj.data), before.points):
        return False
    before.basis = obj.matrix_basis.copy()
    return True


def take_back(obj, before: Placed) -> bool:
    """Restore an object's transform if it was applied to the mesh, or moved to another origin; return whether it was.

    The mesh gets its vertices back but for rounding. Children stay in the world. before: the state with the written
    mesh, of as many vertices.
    """
    mesh = obj.data
    if not len(mesh.vertices):
        return False
    # What was applied: it leads from the written points to those of the mesh, and back to the earlier transform.
    change = obj.matrix_basis.inverted_safe() @ before.basis
    points, expected = _points_of(mesh), transform_points(change, before.points)
    tolerance = TOLERANCE * float(np.ptp(expected, axis=0).max())
    if change.determinant() == 0.0 or not np.allclose(points, expected, rtol=0.0, atol=tolerance):
        return False
    if np.allclose(points, before.points, rtol=0.0, atol=tolerance):  # nothing but the rounding of an earlier return
        return False
    obj.matrix_basis = before.basis
    mesh.transform(change.inverted())
    before.points = _points_of(mesh)  # until the next update writes them exactly
    for child in obj.children:
        _keep_in_world(child, change)
    return True


def _keep_in_world(child, change: Matrix) -> None:
    """Keep a child's place in the world while the basis of its parent is multiplied by `change`.

    A child that was made in the space of its parent gets the identity again, without rounding.
    """
    child.matrix_parent_inverse = change.inverted() @ child.matrix_parent_inverse
    offset = np.array(child.matrix_parent_inverse @ child.matrix_basis) - np.eye(4)
    if np.abs(offset).max() < 1e-4:
        child.matrix_parent_inverse, child.matrix_basis = Matrix(), Matrix()


def _points_of(mesh) -> np.ndarray:
    """Return the positions of some vertices, evenly spaced by number, float64 [n, 3]."""
    count = len(mesh.vertices)
    numbers = sorted({number * (count - 1) // max(POINTS - 1, 1) for number in range(POINTS)}) if count else []
    return np.array([mesh.vertices[number].co for number in numbers], np.float64).reshape(-1, 3)
