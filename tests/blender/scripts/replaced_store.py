# SPDX-License-Identifier: GPL-3.0-or-later
"""Import west.tif in a window, and both.tif into its store by a second program, and write a report: FOLDER."""

import subprocess

import bpy
from window_steps import folder, module, run, take_steps, terrain, until

result = {}
jobs, live = module("operators.jobs"), module("operators.session.live")


def edges() -> list[float]:
    """Return the coordinates of the western and eastern edge of the mesh, and its lowest and highest height."""
    points = [terrain().matrix_world @ vertex.co for vertex in terrain().data.vertices]
    east, heights = ([point[axis] for point in points] for axis in (0, 2))
    west = bpy.context.scene["crs x"]
    return [min(east) + west, max(east) + west, min(heights), max(heights)]


def is_shown() -> bool:
    return not jobs.running and not live.is_behind()


def steps():
    yield 2.0
    run(bpy.ops.mesh.adaptive_terrain_from_file, "INVOKE_DEFAULT", filepath=str(folder / "west.tif"))
    yield from until(lambda: terrain() is not None and len(terrain().data.polygons) > 0 and is_shown())
    run(bpy.ops.adaptive_terrain.set_up_scene, "INVOKE_DEFAULT")  # a still camera, which no draw asks to follow
    yield 2.0
    yield from until(is_shown)
    result["before"] = edges()
    store = bpy.path.abspath(terrain().adaptive_terrain.store)
    given = "--command", "adaptive_terrain", "import", str(folder / "both.tif"), "--store", store
    second = subprocess.Popen([bpy.app.binary_path, *given])
    yield from until(lambda: second.poll() is not None)
    result["second"] = second.returncode
    terrain().adaptive_terrain.viewport.error_px = 0.5
    yield 1.0
    yield from until(is_shown)
    result["after"] = edges()
    result["moved"] = terrain().location.x


take_steps(steps(), result)
