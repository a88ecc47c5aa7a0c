# SPDX-License-Identifier: GPL-3.0-or-later
"""How many triangles a mesh file holds, as cheaply as its format allows: what an exporter wrote is counted again."""

import json
import os
import struct
from pathlib import Path

from ...cbt_terrain.run.named_file import open_regular

PLY_BYTES = {"char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4, "double": 8}
GLB_HEAD = 20  # magic, version, length of the file; length and kind of the first chunk
STL_HEAD, STL_TRIANGLE = 84, 50
BLOCK = 1 << 22


def count_triangles(path: Path) -> int:
    """Triangles in the .ply, .obj, .stl or .glb at `path`; raises ValueError where it is not whole."""
    count = {".ply": _in_ply, ".obj": _in_obj, ".stl": _in_stl, ".glb": _in_glb}[path.suffix.lower()]
    try:
        with open_regular(path, links=True) as file:
            return count(file, os.fstat(file.fileno()).st_size)
    except (struct.error, KeyError, IndexError, TypeError) as error:  # what a damaged head makes of the reading
        raise ValueError(f"its head cannot be read back: {error!r}") from None


def _need_size(size: int, expected: int) -> None:
    if size != expected:
        raise ValueError(f"it has {size:,} bytes where its own head says {expected:,}")


def _in_ply(file, size: int) -> int:
    """The header's count; all faces are triangles if the size agrees."""
    stride, counts, element = 0, {}, ""
    for line in iter(lambda: file.readline(256).split(), [b"end_header"]):
        if not line:
            raise ValueError("its head has no end")
        if line[0] == b"element":
            element, counts[line[1].decode()] = line[1].decode(), int(line[2])
        elif line[0] == b"property" and element == "vertex":
            stride += PLY_BYTES[line[1].decode()]
    _need_size(size, file.tell() + counts["vertex"] * stride + counts.get("face", 0) * (1 + 3 * 4))
    return counts.get("face", 0)


def _in_obj(file, size: int) -> int:
    """Lines of faces, each of which is a triangle in what is exported here."""
    count, last = 0, b"\n"
    while block := file.read(BLOCK):
        block = last + block
        count += block.count(b"\nf ")
        last = block[-2:]  # shorter than what is counted, so that nothing is counted twice
    return count


def _in_stl(file, size: int) -> int:
    [count] = struct.unpack("<I", file.read(STL_HEAD)[-4:])
    _need_size(size, STL_HEAD + count * STL_TRIANGLE)
    return count


def _in_glb(file, size: int) -> int:
    """Indices of every mesh, once for each node that shows it, by the JSON at the head."""
    magic, _version, length, json_length, _kind = struct.unpack("<4s4I", file.read(GLB_HEAD))
    if magic != b"glTF":
        raise ValueError("it does not begin with glTF")
    _need_size(size, length)
    scene = json.loads(file.read(json_length))
    meshes = [scene["meshes"][node["mesh"]] for node in scene.get("nodes", []) if "mesh" in node]
    accessors = [scene["accessors"][part["indices"]] for mesh in meshes for part in mesh["primitives"]]
    return sum(accessor["count"] for accessor in accessors) // 3
