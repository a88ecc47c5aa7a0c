# SPDX-License-Identifier: GPL-3.0-or-later
"""What a user may have cut away from a finished mesh, on a bmesh."""

from dataclasses import dataclass

import bmesh
import numpy as np
from mathutils import Vector
from mathutils.bvhtree import BVHTree


@dataclass(frozen=True)
class Cleanup:
    """`below`: faces wholly below this height go (metres, the terrain's space), None for none. `boundary`: faces whose
    middle has none of these triangles above or below it go: float64 [n, 3, 2], x and y in the terrain's space, None for
    no boundary. `remove_loose`: vertices and edges without a face go."""

    below: float | None = None
    boundary: np.ndarray | None = None
    remove_loose: bool = True

    @property
    def active(self) -> bool:
        return self.below is not None or self.boundary is not None

    def key(self) -> tuple:
        boundary = None if self.boundary is None else self.boundary.tobytes()
        return self.below, boundary, self.remove_loose


def clean_up(built, cleanup: Cleanup) -> None:
    """Delete from the bmesh `built` what `cleanup` names."""
    doomed = set()
    if cleanup.below is not None:
        doomed.update(face for face in built.faces if max(v.co.z for v in face.verts) < cleanup.below)
    if cleanup.boundary is not None:
        inside = _inside_test(cleanup.boundary)
        doomed.update(face for face in built.faces if not inside(face.calc_center_median()))
    # Vertices and edges stay with FACES_ONLY; they go only where the user wants loose ones gone.
    bmesh.ops.delete(built, geom=list(doomed), context="FACES_ONLY")
    if cleanup.remove_loose:
        bmesh.ops.delete(built, geom=[edge for edge in built.edges if not edge.link_faces], context="EDGES")
        bmesh.ops.delete(built, geom=[vert for vert in built.verts if not vert.link_faces], context="VERTS")


def _inside_test(boundary: np.ndarray):
    corners = [(x, y, 0.0) for x, y in boundary.reshape(-1, 2)]
    tree = BVHTree.FromPolygons(corners, [(i, i + 1, i + 2) for i in range(0, len(corners), 3)])
    down = Vector((0.0, 0.0, -1.0))
    return lambda point: tree.ray_cast(Vector((point.x, point.y, 1.0)), down)[0] is not None


def boundary_triangles(boundary, terrain_from_world) -> np.ndarray:
    """float64 [n, 3, 2]: the triangles of the evaluated mesh object `boundary` in plan, in the terrain's space."""
    mesh = boundary.data
    mesh.calc_loop_triangles()
    vertices = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", vertices)
    indices = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", indices)
    matrix = np.array(terrain_from_world, np.float64) @ np.array(boundary.matrix_world, np.float64)
    placed = vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
    return placed[indices].reshape(-1, 3, 3)[:, :, :2]
