# SPDX-License-Identifier: GPL-3.0-or-later
"""Points of a scatter into a Blender mesh of vertices alone, with the attributes that geometry nodes read."""

import numpy as np

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.scatter.points import Points

# Attribute, Blender's type, the member of its items, and the array for it. Blender's ids are 31 bits.
ATTRIBUTES = (
    ("normal", "FLOAT_VECTOR", "vector", lambda points: points.normals),
    ("rotation", "QUATERNION", "value", lambda points: points.rotation),
    ("size", "FLOAT", "value", lambda points: points.size),
    ("id", "INT", "value", lambda points: (points.id & 0x7FFFFFFF).astype(np.int32)),
    ("variant", "INT", "value", lambda points: points.variant),
)


def write_points(mesh, points: Points) -> None:
    """Replace all of `mesh` by points. Raises TerrainError where it cannot be written."""
    if mesh.is_editmode or mesh.shape_keys is not None:
        raise TerrainError(
            f"The mesh {mesh.name!r} of a scatter is in edit mode or has shape keys; leave that, or remove them."
        )
    mesh.clear_geometry()
    mesh.vertices.add(len(points))
    for name, kind, _, _ in ATTRIBUTES:  # all before one is written: Blender may move what it has
        if mesh.attributes.new(name, kind, "POINT").name != name:
            raise TerrainError(f"Blender has no room for an attribute of the name {name!r}: give it another name.")
    mesh.attributes["position"].data.foreach_set("vector", points.positions.ravel())
    for name, _, member, array in ATTRIBUTES:
        mesh.attributes[name].data.foreach_set(member, array(points).ravel())
    mesh.update()
