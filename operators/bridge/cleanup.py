# SPDX-License-Identifier: GPL-3.0-or-later
"""The clean-up of a terrain's mesh: cut away everything below a height or outside of another object."""

from dataclasses import dataclass

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.mesh.surface import Surface
from ...cbt_terrain.run import launch
from .evaluated import transform_points


@dataclass(frozen=True)
class Cleanup:
    """The parts of a mesh to cut away.

    Attributes:
        below: remove ground below this height (metres, the terrain's space), None for none.
        boundary: remove ground outside of these triangles in plan (float64 [n, 3, 2], the terrain's space), None for
            none.
    """

    below: float | None = None
    boundary: np.ndarray | None = None

    @property
    def active(self) -> bool:
        """Return whether anything is cut away."""
        return self.below is not None or self.boundary is not None

    def key(self) -> tuple:
        """Return a key that is equal for equal clean-ups."""
        return self.below, None if self.boundary is None else self.boundary.tobytes()


def clean_up(surface: Surface, cleanup: Cleanup) -> Surface:
    """Return a surface without the parts that the clean-up cuts away, in new arrays; the surface itself if it cuts
    nothing.

    Each `cut` keeps the part of the mesh where a function of position, its "side", is positive.
    """
    from ...cbt_terrain.mesh.cut import above_line, cut
    from ...cbt_terrain.mesh.outline import inside

    threads = launch.default_threads()
    if cleanup.below is not None:
        surface, _ = cut(surface, [above_line(axis=2, at=cleanup.below)], threads=threads)
    if cleanup.boundary is not None:
        # A side for each line of a convex outline with few lines, else one for the whole boundary.
        for side in inside(cleanup.boundary, surface):
            surface, _ = cut(surface, [side], threads=threads)
    return surface


def plan_triangles(obj, matrix, terrain_from_world, what: str) -> np.ndarray:
    """Return the triangles of an evaluated mesh object in plan, float64 [n, 3, 2] in the terrain's space.

    Args:
        matrix: from the object's space to the world.
        terrain_from_world: matrix from the world to the terrain's space.
        what: name of the object's role for errors.

    Raises:
        TerrainError: the object is no mesh or has coordinates that are not finite.
    """
    if obj.type != "MESH":
        raise TerrainError(f"The {what} {obj.name!r} is of type {obj.type}", expected="a mesh object")
    mesh = obj.data
    mesh.calc_loop_triangles()
    vertices = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", vertices)
    indices = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", indices)
    placed = transform_points(terrain_from_world, transform_points(matrix, vertices.reshape(-1, 3)))
    triangles = placed[indices].reshape(-1, 3, 3)[:, :, :2]
    if not np.isfinite(triangles).all():
        raise TerrainError(
            f"The {what} {obj.name!r} has a vertex or a matrix that is not finite", fix="check its mesh and parents"
        )
    return triangles
