# SPDX-License-Identifier: GPL-3.0-or-later
"""Write points of a scatter into a Blender mesh of vertices with the attributes that geometry nodes read."""

import numpy as np

from ...cbt_terrain.scatter.points import ScatterPoints
from .writer import add_attribute, check_writable

# Attribute, Blender's type, the member of its items, and its array. Blender's ids have 31 bits.
ATTRIBUTES = (
    ("normal", "FLOAT_VECTOR", "vector", lambda points: points.normals),
    ("rotation", "QUATERNION", "value", lambda points: points.rotation),
    ("size", "FLOAT", "value", lambda points: points.size),
    ("id", "INT", "value", lambda points: (points.id & 0x7FFFFFFF).astype(np.int32)),
    ("variant", "INT", "value", lambda points: points.variant),
)


def write_points(mesh, points: ScatterPoints) -> None:
    """Replace the content of a mesh by the points of a scatter, with their attributes.

    Raises TerrainError for a mesh in edit mode or with shape keys.
    """
    check_writable(mesh)
    mesh.clear_geometry()
    mesh.vertices.add(len(points))
    for name, kind, _, _ in ATTRIBUTES:  # add all before writing: Blender may move existing ones
        add_attribute(mesh, name, kind, "POINT")
    mesh.attributes["position"].data.foreach_set("vector", points.positions.ravel())
    for name, _, member, array_of in ATTRIBUTES:
        mesh.attributes[name].data.foreach_set(member, array_of(points).ravel())
    mesh.update()
