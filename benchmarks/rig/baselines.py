# SPDX-License-Identifier: GPL-3.0-or-later
"""Baselines: a serial bintree in C (`roam_rebuild`), and the plain way to make a Blender mesh (`plain_ingest`)."""

import json
import shutil
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np

from ...cbt_terrain.errors import TerrainError
from .measure import stopwatch
from .scenes import DEPTH

SOURCE = Path(__file__).with_name("roam_rebuild.c")
ROAM, PLAIN = "roam_rebuild", "plain_ingest"


class RoamRebuild:
    """Running processes of the compiled C program, one for each number of leaves."""

    def __init__(self, program: Path):
        self.program = program
        self._running: dict[int, subprocess.Popen] = {}

    def timer(self, leaves: int) -> Callable[[], float]:
        """Return a function that rebuilds about `leaves` leaves once and returns the milliseconds."""
        if leaves not in self._running:
            command = [str(self.program), "--depth", str(DEPTH), "--leaves", str(leaves), "--runs", "1", "--serve"]
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            json.loads(process.stdout.readline())  # printed once the camera is found
            self._running[leaves] = process
        process = self._running[leaves]

        def rebuild() -> float:
            try:
                process.stdin.write("\n")
                process.stdin.flush()
                return float(process.stdout.readline())
            except (OSError, ValueError) as reason:
                raise TerrainError(
                    f"The process of {ROAM} ended with code {process.wait()}", fix="run it again"
                ) from reason

        return rebuild

    def close(self) -> None:
        """End all processes."""
        while self._running:
            _, process = self._running.popitem()
            with suppress(OSError):  # a process that has already ended
                process.stdin.close()
            process.stdout.close()
            process.wait()


def build_roam_rebuild(folder: Path, note: Callable[[str], None]) -> RoamRebuild | None:
    """Compile the C program into `folder`; return None and note the reason if that fails."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        note(f"There is no C compiler here: the baseline {ROAM} is left out.")
        return None
    program = folder / ROAM
    command = [compiler, "-O3", "-march=native", str(SOURCE), "-o", str(program), "-lm"]
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode != 0:
        message = (result.stderr.strip().splitlines() or ["no message"])[-1]
        note(f"{compiler} cannot build {SOURCE.name} ({message}): the baseline {ROAM} is left out.")
        return None
    return RoamRebuild(program)


def plain_ingest(obj, surface) -> float:
    """Write the mesh of a Blender object the plain way, evaluate it and return the milliseconds.

    The arrays are those of our writer without the edges, which Blender computes: positions, corners, offsets, texture
    coordinates, levels and normals. They are written as attributes, which is twice as fast as through `vertices` and
    `loops`.
    """
    import bpy

    mesh, triangles = obj.data, len(surface.triangles)
    with stopwatch() as elapsed:
        mesh.clear_geometry()
        mesh.vertices.add(len(surface.positions))
        mesh.loops.add(3 * triangles)
        mesh.polygons.add(triangles)
        mesh.attributes["position"].data.foreach_set("vector", surface.positions.ravel())
        mesh.attributes[".corner_vert"].data.foreach_set("value", surface.corner_verts)
        mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * triangles, 3, dtype=np.int32))
        mesh.update(calc_edges=True)
        uv = mesh.uv_layers.new(name="UVMap", do_init=False)
        uv.uv.foreach_set("vector", np.take(surface.uv, surface.corner_verts, axis=0).ravel())
        level = mesh.attributes.new("terrain_level", "INT", "FACE")
        level.data.foreach_set("value", surface.level)
        normal = mesh.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT")
        normal.data.foreach_set("vector", surface.normals.ravel())
        evaluated_triangles(bpy.context, obj)
    return elapsed[0]


def evaluated_triangles(context, obj) -> int:
    """Update the dependency graph and return the number of faces of the evaluated object."""
    depsgraph = context.evaluated_depsgraph_get()  # updates it
    return len(obj.evaluated_get(depsgraph).data.polygons)
