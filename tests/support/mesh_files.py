# SPDX-License-Identifier: GPL-3.0-or-later
"""Readers of exported meshes that share nothing with what writes them: struct, json and numpy alone.

Each returns the vertices as float64 [V, 3] with z up, in the space of the file, and the triangles as int64 [T, 3].
"""

import ast
import json
import re
import struct

import numpy as np

PLY_TYPES = {"float": "<f4", "uchar": "u1", "uint": "<u4", "int": "<i4"}
GLTF_TYPES = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}


def read_mesh(path) -> tuple[np.ndarray, np.ndarray]:
    readers = {".ply": read_ply, ".obj": read_obj, ".stl": read_stl, ".glb": read_glb, ".npz": read_npz}
    return (readers | {".usda": read_usda})[path.suffix](path)


def read_usda(path):
    """Read the one mesh of a USD text file, in the world."""
    text = path.read_text()
    [points] = re.findall(r"point3f\[\] points = (\[.*\])", text)
    [corners] = re.findall(r"int\[\] faceVertexIndices = (\[.*\])", text)
    points = np.array(ast.literal_eval(points), np.float64).reshape(-1, 3)
    for place in reversed(re.findall(r"matrix4d xformOp:transform = (\(.*\))", text)):  # parents come first
        matrix = np.array(ast.literal_eval(place), np.float64)
        points = points @ matrix[:3, :3] + matrix[3, :3]
    return points, np.array(ast.literal_eval(corners), np.int64).reshape(-1, 3)


def read_ply(path):
    vertices, triangles = _read_ply(path)
    return np.stack([vertices[name] for name in "xyz"], 1).astype(np.float64), triangles


def read_ply_fields(path):
    """Return all vertex fields of the file as a structured array [V]."""
    return _read_ply(path)[0]


def _read_ply(path):
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = [line.split() for line in head.decode().splitlines()]
    assert ["format", "binary_little_endian", "1.0"] in lines
    counts = {line[1]: int(line[2]) for line in lines if line[0] == "element"}
    fields = [(line[2], PLY_TYPES[line[1]]) for line in lines if line[0] == "property" and line[1] != "list"]
    vertices = np.frombuffer(body, np.dtype(fields), counts["vertex"])
    face = np.dtype([("corners", "u1"), ("vertices", "<u4", 3)])
    faces = np.frombuffer(body, face, counts["face"], offset=vertices.nbytes)
    assert (faces["corners"] == 3).all() and vertices.nbytes + faces.nbytes == len(body)
    return vertices, faces["vertices"].astype(np.int64)


def read_obj(path):
    lines = [line.split() for line in path.read_text().splitlines()]
    vertices = np.array([line[1:] for line in lines if line[:1] == ["v"]], np.float64).reshape(-1, 3)
    faces = [[int(corner.split("/")[0]) - 1 for corner in line[1:]] for line in lines if line[:1] == ["f"]]
    return z_up(vertices), np.array(faces, np.int64).reshape(-1, 3)


def read_stl(path):
    data = path.read_bytes()
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    [count] = struct.unpack("<I", data[80:84])
    assert len(data) == 84 + count * record.itemsize
    corners = np.frombuffer(data, record, count, offset=84)["corners"].reshape(-1, 3)
    return corners.astype(np.float64), np.arange(3 * count).reshape(-1, 3)


def read_glb(path):
    data = path.read_bytes()
    assert data[:4] == b"glTF" and struct.unpack("<I", data[8:12]) == (len(data),)
    [length] = struct.unpack("<I", data[12:16])
    scene, binary = json.loads(data[20 : 20 + length]), data[20 + length + 8 :]

    def accessor(index, width):
        found = scene["accessors"][index]
        view = scene["bufferViews"][found["bufferView"]]
        assert "byteStride" not in view
        start = view.get("byteOffset", 0) + found.get("byteOffset", 0)
        return np.frombuffer(binary, GLTF_TYPES[found["componentType"]], found["count"] * width, start)

    vertices, triangles = [np.empty((0, 3))], [np.empty((0, 3), np.int64)]
    for place, node in nodes(scene, scene["scenes"][0].get("nodes", []), np.eye(4)):
        for primitive in scene["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []:
            assert primitive.get("mode", 4) == 4
            points = accessor(primitive["attributes"]["POSITION"], 3).reshape(-1, 3).astype(np.float64)
            triangles.append(
                accessor(primitive["indices"], 1).reshape(-1, 3).astype(np.int64) + sum(map(len, vertices))
            )
            vertices.append(points @ place[:3, :3].T + place[:3, 3])
    return z_up(np.concatenate(vertices)), np.concatenate(triangles)


def nodes(scene, indices, above):
    """Yield each node with its matrix to the file's space."""
    for node in (scene["nodes"][index] for index in indices):
        x, y, z, w = node.get("rotation", (0, 0, 0, 1))
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        place = np.eye(4)
        place[:3, :3], place[:3, 3] = turn * node.get("scale", (1, 1, 1)), node.get("translation", (0, 0, 0))
        if "matrix" in node:
            place = np.reshape(node["matrix"], (4, 4)).T
        yield above @ place, node
        yield from nodes(scene, node.get("children", []), above @ place)


def read_npz(path):
    with np.load(path) as data:
        return data["positions"].astype(np.float64), data["triangles"].astype(np.int64)


def z_up(vertices):
    """Convert points of a file whose y is up."""
    return np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], 1)


def read_glb_attributes(path):
    """Return the vertex attributes of the only part of the only mesh, float32 [n] or [n, width], by glTF's names."""
    raw = path.read_bytes()
    [head] = struct.unpack_from("<I", raw, 12)
    scene, binary = json.loads(raw[20 : 20 + head]), raw[28 + head :]
    [[part]] = [mesh["primitives"] for mesh in scene["meshes"]]
    found = {}
    for name, number in part["attributes"].items():
        accessor = scene["accessors"][number]
        view = scene["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        if accessor["componentType"] != 5126:  # float32
            continue
        first = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        values = np.frombuffer(binary, np.float32, accessor["count"] * width, first)
        found[name] = values.reshape(-1, width) if width > 1 else values
    return found
