# SPDX-License-Identifier: GPL-3.0-or-later
"""Binary glTF 2.0 of one triangle mesh, written without Blender."""

import json
import struct

import numpy as np

MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
FLOAT, UNSIGNED_INT = 5126, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}


def y_up(vectors: np.ndarray) -> np.ndarray:
    """Turn vectors [n, 3] from z up to y up, the axes of glTF."""
    return np.column_stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]]).astype(np.float32)


def glb_of(positions: np.ndarray, normals: np.ndarray, uv: np.ndarray, triangles: np.ndarray, extras: dict) -> bytes:
    """Return the bytes of a .glb file. The mesh has at least one triangle.

    Args:
        positions: float32 [n, 3] metres, z up.
        normals: float32 [n, 3], z up, of any length.
        uv: float32 [n, 2], from west to east and from south to north.
        triangles: int [t, 3], counter-clockwise from outside.
        extras: entries for JSON, of the file's asset and of its mesh.
    """
    points = y_up(positions)
    directions = y_up(normals)
    directions /= np.maximum(np.sqrt((directions.astype(np.float64) ** 2).sum(1, keepdims=True)), 1e-30)
    texture = np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]).astype(np.float32)
    arrays = [points, directions.astype(np.float32), texture, triangles.reshape(-1).astype(np.uint32)]
    views: list[dict] = []
    accessors: list[dict] = []
    binary = b""
    for array in arrays:
        is_index = array.dtype == np.uint32
        target = ELEMENT_ARRAY_BUFFER if is_index else ARRAY_BUFFER
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes, "target": target})
        kind = TYPES[1 if array.ndim == 1 else array.shape[1]]
        component = UNSIGNED_INT if is_index else FLOAT
        accessors.append({"bufferView": len(accessors), "componentType": component, "count": len(array), "type": kind})
        binary += array.tobytes()  # numbers of 4 bytes, so the next array is aligned
    accessors[0] |= {"min": points.min(0).tolist(), "max": points.max(0).tolist()}
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3, "material": 0}
    content = {
        "asset": {"version": "2.0", "generator": "Adaptive Terrain", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive], "extras": extras}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0}}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), JSON_CHUNK) + text + struct.pack("<II", len(binary), BINARY_CHUNK) + binary
    return struct.pack("<III", MAGIC, 2, 12 + len(chunks)) + chunks
