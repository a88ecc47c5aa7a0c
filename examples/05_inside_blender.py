# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain in a scene: `.venv/bin/python examples/05_inside_blender.py [FOLDER]`, which needs `bpy`."""

# The script prints the triangles for the camera, of the frozen terrain after the camera moved away (the same), and of
# the terrain set free again (fewer, since it is far). Any Blender with the extension can open the saved file. Inside
# Blender the lines from `bpy.ops.mesh.adaptive_terrain_add()` on work unchanged.

import sys
from pathlib import Path

import adaptive_terrain
import bpy

if not hasattr(bpy.types.Object, "adaptive_terrain"):
    adaptive_terrain.register()

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "example").resolve()
folder.mkdir(parents=True, exist_ok=True)
bpy.ops.wm.read_homefile(use_factory_startup=True)  # a camera, a light and a cube
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "island.blend"))  # stores go beside the file

bpy.ops.mesh.adaptive_terrain_add()  # adds the built-in island as the active object
terrain = bpy.context.object
camera = bpy.context.scene.camera


def show(what: str) -> None:
    bpy.ops.adaptive_terrain.update()
    print(f"{what}: {len(terrain.data.polygons):,} triangles")


show("for the camera")
bpy.ops.adaptive_terrain.freeze()
camera.location *= 4.0
show("frozen, the camera far away")
bpy.ops.adaptive_terrain.freeze()
show("set free")
print(f"attributes: {', '.join(sorted(terrain.data.attributes.keys()))}")
bpy.ops.wm.save_mainfile()
