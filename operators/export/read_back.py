# SPDX-License-Identifier: GPL-3.0-or-later
"""Counts of the triangles in mesh files, as cheap as each format allows. They check what exporters wrote."""

import json
import os
import struct
from pathlib import Path

from ...cbt_terrain.run.named_file import open_regular
from .formats import format_of

PLY_BYTES = {"char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4, "double": 8}
GLB_HEAD = 20  # magic, version, length of the file; length and kind of the first chunk
STL_HEAD, STL_TRIANGLE = 84, 50
BLOCK = 1 << 22
USDA_END = b"}\n\n"


def count_triangles(path: Path) -> int:
    """Count the triangles in a file that one of Blender's exporters wrote. Raises ValueError if it is not whole."""
    try:
        with open_regular(path, links=True) as file:
            return format_of(path).call("count", file)
    except (struct.error, KeyError, IndexError, TypeError) as error:  # from a damaged head
        raise ValueError(f"its head cannot be read back: {error!r}") from None


def _size_of(file) -> int:
    """Return the size of an open file in bytes."""
    return os.fstat(file.fileno()).st_size


def _check_size(file, expected: int) -> None:
    """Raise ValueError if an open file has another size in bytes than its header says."""
    if (size := _size_of(file)) != expected:
        raise ValueError(f"it has {size:,} bytes where its own head says {expected:,}")


def count_in_ply(file) -> int:
    """Return the number of triangles by a binary .ply's header; all faces are triangles if the file's size fits it.

    Raises ValueError otherwise. A triangle has a byte for the number of its corners and three integers of four bytes.
    """
    vertex_bytes, counts, element = 0, {}, ""
    for line in iter(lambda: file.readline(256).split(), [b"end_header"]):
        if not line:
            raise ValueError("its head has no end")
        if line[0] == b"element":
            element, counts[line[1].decode()] = line[1].decode(), int(line[2])
        elif line[0] == b"property" and element == "vertex":
            vertex_bytes += PLY_BYTES[line[1].decode()]
    _check_size(file, file.tell() + counts["vertex"] * vertex_bytes + counts.get("face", 0) * (1 + 3 * 4))
    return counts.get("face", 0)


def count_in_obj(file) -> int:
    """Count the lines of faces in an .obj: every exported face is a triangle. A file that was cut is not noticed."""
    count, last = 0, b"\n"
    while block := file.read(BLOCK):
        block = last + block
        count += block.count(b"\nf ")
        last = block[-2:]  # shorter than the pattern, so that no face is counted twice
    return count


def count_in_stl(file) -> int:
    """Return the number of triangles by a binary .stl's header. Raises ValueError if the file's size disagrees."""
    [count] = struct.unpack("<I", file.read(STL_HEAD)[-4:])
    _check_size(file, STL_HEAD + count * STL_TRIANGLE)
    return count


def count_in_glb(file) -> int:
    """Count triangles by the JSON header of a .glb: those of a mesh once for every node that shows it.

    Raises ValueError if the file's size disagrees with its header.
    """
    magic, _version, length, json_length, _kind = struct.unpack("<4s4I", file.read(GLB_HEAD))
    if magic != b"glTF":
        raise ValueError("it does not begin with glTF")
    _check_size(file, length)
    scene = json.loads(file.read(json_length))
    meshes = [scene["meshes"][node["mesh"]] for node in scene.get("nodes", []) if "mesh" in node]
    accessors = [scene["accessors"][part["indices"]] for mesh in meshes for part in mesh["primitives"]]
    return sum(accessor["count"] for accessor in accessors) // 3


def count_in_usda(file) -> int:
    """Count triangles by the lists of face sizes in a .usda, which must all be 3.

    Raises ValueError if one is not, or if the file's end is missing.
    """
    count = 0
    for line in file:
        name, _, value = line.partition(b"=")
        if name.strip() == b"int[] faceVertexCounts":
            count += value.count(b"3")
            if set(value) - set(b"[3, ]\n"):
                raise ValueError("it has faces that are no triangles")
    file.seek(max(_size_of(file) - len(USDA_END), 0))
    if file.read() != USDA_END:
        raise ValueError("its last block has no end")
    return count
