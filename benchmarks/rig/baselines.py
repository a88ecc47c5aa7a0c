# SPDX-License-Identifier: GPL-3.0-or-later
"""What the program is measured against: a serial C bintree, and the plain way of making a Blender mesh.

`roam_rebuild.c` rebuilds the whole refinement of the unit square from its two roots, on one thread. `plain_ingest`
hands Blender the same arrays and lets it find the edges.
"""

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
    """The C program, built with the system's compiler; it stays loaded and rebuilds whenever it is asked to."""

    def __init__(self, program: Path):
        self.program = program
        self._running: dict[int, subprocess.Popen] = {}

    def timer(self, leaves: int) -> Callable[[], float]:
        """A function that rebuilds about that many leaves once and returns the milliseconds."""
        if leaves not in self._running:
            command = [str(self.program), "--depth", str(DEPTH), "--leaves", str(leaves), "--runs", "1", "--serve"]
            process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            json.loads(process.stdout.readline())  # it has found its camera
            self._running[leaves] = process
        process = self._running[leaves]

        def rebuild() -> float:
            try:
                process.stdin.write("\n")
                process.stdin.flush()
                return float(process.stdout.readline())
            except (OSError, ValueError) as reason:
                raise TerrainError(
                    f"The process of {ROAM} has ended with code {process.wait()}; run it again."
                ) from reason

        return rebuild

    def close(self) -> None:
        while self._running:
            _, process = self._running.popitem()
            with suppress(OSError):  # it may have ended before
                process.stdin.close()
            process.stdout.close()
            process.wait()


def build_roam_rebuild(folder: Path, note: Callable[[str], None]) -> RoamRebuild | None:
    """The program, built into `folder`; None, and a note why, where it cannot be built."""
    compiler = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if compiler is None:
        note(f"There is no C compiler here: the baseline {ROAM} is left out.")
        return None
    program = folder / ROAM
    command = [compiler, "-O3", "-march=native", str(SOURCE), "-o", str(program), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True)
    if built.returncode != 0:
        said = (built.stderr.strip().splitlines() or ["no message"])[-1]
        note(f"{compiler} cannot build {SOURCE.name} ({said}): the baseline {ROAM} is left out.")
        return None
    return RoamRebuild(program)


def plain_ingest(obj, surface) -> float:
    """Write the mesh of a Blender object the plain way and have it evaluated; returns milliseconds.

    The same arrays as our writer's but the edges, which Blender finds: positions, corners, offsets, texture
    coordinates, levels and normals. They go in as attributes, which is twice as fast as by `vertices`
    and `loops`.
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
    """How many faces the object has once the dependency graph has seen what changed."""
    depsgraph = context.evaluated_depsgraph_get()  # brings the graph up to date
    return len(obj.evaluated_get(depsgraph).data.polygons)
