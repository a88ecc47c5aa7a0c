# SPDX-License-Identifier: GPL-3.0-or-later
"""A reader of glb files and 3D Tiles, independent of this package."""

import json
import math
import struct
from types import SimpleNamespace
from urllib.parse import unquote

import numpy as np


def read_glb(path):
    """Return positions and normals (z up), uv, triangles and the JSON of a .glb; assert that the file is sound."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    content = json.loads(data[20 : 20 + size])
    binary_size, binary_kind = struct.unpack_from("<I4s", data, 20 + size)
    binary = data[28 + size :]
    assert kind == b"JSON" and binary_kind == b"BIN\0" and len(binary) == binary_size and size % 4 == 0
    assert content["buffers"][0]["byteLength"] == binary_size and content["asset"]["version"] == "2.0"

    def array(number):
        accessor = content["accessors"][number]
        view = content["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}[accessor["type"]]
        dtype = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        assert view["byteOffset"] % 4 == 0 and view["byteLength"] == 4 * width * accessor["count"]
        found = np.frombuffer(binary, dtype, width * accessor["count"], view["byteOffset"]).reshape(-1, width)
        if "min" in accessor:
            assert (found.min(0) == accessor["min"]).all() and (found.max(0) == accessor["max"]).all()
        return found

    [primitive] = content["meshes"][0]["primitives"]
    position, normal, uv = (array(primitive["attributes"][n]) for n in ("POSITION", "NORMAL", "TEXCOORD_0"))
    triangles = array(primitive["indices"]).reshape(-1, 3).astype(int)
    assert "min" in content["accessors"][primitive["attributes"]["POSITION"]] and triangles.max() < len(position)
    assert np.allclose((normal.astype(float) ** 2).sum(1), 1, atol=1e-5) and np.isfinite(position).all()
    position, normal = (np.stack([v[:, 0], -v[:, 2], v[:, 1]], -1) for v in (position, normal))
    return SimpleNamespace(positions=position, normals=normal, uv=uv, triangles=triangles, json=content)


def read_tileset(path):
    """Return the JSON and a list of tiles (level, json, mesh); assert the rules of 3D Tiles 1.1 that concern us."""
    tileset = json.loads(path.read_text(encoding="utf-8"))
    assert tileset["asset"]["version"] == "1.1" and tileset["root"]["refine"] == "REPLACE"
    assert set(tileset) == {"asset", "geometricError", "root"}
    assert tileset["geometricError"] >= tileset["root"]["geometricError"]
    found, waiting = [], [(0, tileset["root"])]
    while waiting:
        level, tile = waiting.pop()
        allowed = {"boundingVolume", "geometricError", "content", "children"}
        assert set(tile) <= allowed | ({"transform", "refine"} if level == 0 else set())
        assert math.isfinite(tile["geometricError"]) and tile["geometricError"] >= 0
        mesh = None
        if "content" in tile:
            mesh = read_glb(path.with_name(unquote(tile["content"]["uri"])))
            assert inside(mesh.positions, tile["content"]["boundingVolume"])
            assert inside(mesh.positions, tile["boundingVolume"])
        for child in tile.get("children", ()):
            assert child["geometricError"] <= tile["geometricError"]
            assert inside(corners(child["boundingVolume"]), tile["boundingVolume"])
            waiting.append((level + 1, child))
        assert mesh is not None or tile["children"]
        found.append((level, tile, mesh))
    return tileset, found


def corners(volume):
    box = np.array(volume["box"], float).reshape(4, 3)
    signs = np.stack(np.meshgrid(*[[-1, 1]] * 3), -1).reshape(-1, 3)
    return box[0] + signs @ box[1:]


def inside(points, volume):
    box = np.array(volume["box"], float).reshape(4, 3)
    assert len(volume["box"]) == 12 and abs(np.linalg.det(box[1:])) > 0
    return (abs((points.astype(float) - box[0]) @ np.linalg.inv(box[1:])) <= 1 + 1e-12).all()


def surface_of(mesh):
    """Return the triangles of a tile without its skirt."""
    return mesh.triangles[: mesh.json["asset"]["extras"]["num_surface_triangles"]]
