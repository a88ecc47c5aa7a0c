# SPDX-License-Identifier: GPL-3.0-or-later
"""What a Blender object shows, as arrays and numbers to compare."""

import numpy as np
from adaptive_terrain.cbt_terrain.mesh.attributes import Attribute
from adaptive_terrain.cbt_terrain.mesh.surface import Surface
from invariants import assert_invariants

# Name, width and type of the values of an attribute, by its data type.
VALUES = {
    "FLOAT": ("value", 1, np.float32),
    "INT": ("value", 1, np.int32),
    "FLOAT2": ("vector", 2, np.float32),
    "FLOAT_VECTOR": ("vector", 3, np.float32),
    "QUATERNION": ("value", 4, np.float32),
    "FLOAT_COLOR": ("color", 4, np.float32),
}


def read(collection, name: str, width: int = 1, dtype=np.float32) -> np.ndarray:
    """Return a property of all elements of a collection, [n] or [n, width]."""
    array = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, array)
    return array.reshape(-1, width) if width > 1 else array


def values_of(mesh, name: str) -> np.ndarray:
    """Return the values of a mesh's attribute, [n] or [n, width]."""
    attribute = mesh.attributes[name]
    return read(attribute.data, *VALUES[attribute.data_type])


def positions(obj) -> np.ndarray:
    """Return the vertices of an object's mesh, float32 [V, 3]."""
    return read(obj.data.vertices, "co", 3)


def corner_normals(mesh) -> np.ndarray:
    """Return the normals of a mesh's corners, float32 [C, 3]."""
    return read(mesh.corner_normals, "vector", 3)


def surface_of(mesh) -> Surface:
    """Return the arrays of a Blender mesh of triangles as Blender has them."""
    corner_verts = read(mesh.loops, "vertex_index", 1, np.int32)
    uv = np.zeros((len(mesh.vertices), 2), np.float32)
    uv[corner_verts] = read(mesh.uv_layers.active.uv, "vector", 2)
    normals = np.zeros((len(mesh.vertices), 3), np.float32)
    normals[corner_verts] = corner_normals(mesh)
    return Surface(
        read(mesh.vertices, "co", 3),
        corner_verts,
        read(mesh.loops, "edge_index", 1, np.int32),
        read(mesh.edges, "vertices", 2, np.int32),
        {
            "normals": Attribute(normals, "POINT"),
            "uv": Attribute(uv, "POINT"),
            "terrain_level": Attribute(values_of(mesh, "terrain_level"), "FACE"),
        },
    )


def assert_blender_invariants(obj, meshlet: int = 0) -> None:
    """Assert I1 .. I6 for the mesh that a Blender object holds, read back from Blender, and Blender's own check."""
    from adaptive_terrain.operators.session import session

    assert obj.data.validate(verbose=True) is False
    assert_invariants(surface_of(obj.data), session.record_of(obj).terrain.field.lattice, meshlet)


def digest(obj) -> tuple[int, bytes]:
    """Return the digest of a terrain's faces and coordinates; check the invariants of a mesh."""
    if len(obj.data.polygons):
        assert_blender_invariants(obj)
    return digest_alone(obj)


def digest_alone(obj) -> tuple[int, bytes]:
    """Return the `digest` of an object that may be no terrain of this file or may have been cut by a clean-up."""
    return len(obj.data.polygons), positions(obj).tobytes()
