# SPDX-License-Identifier: GPL-3.0-or-later
"""Import a height map twice, look at it far from the middle, and move the world there: SAVE_TO FILE."""

import json
import sys

import bpy
import numpy as np

save_to, file = sys.argv[sys.argv.index("--") + 1 :]
bpy.ops.wm.read_homefile(use_empty=True)
bpy.ops.wm.save_as_mainfile(filepath=save_to)
scene, terrains = bpy.context.scene, []
camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
scene.collection.objects.link(camera)
scene.camera, scene.frame_start, scene.frame_end = camera, 1, 3
for frame, x in ((1, 8200.0), (3, 8300.0)):
    camera.location = (x, -6200.0, 3000.0)
    camera.keyframe_insert("location", frame=frame)
for _ in range(2):
    assert bpy.ops.mesh.adaptive_terrain_from_file(filepath=file) == {"FINISHED"}
    terrains.append(bpy.context.object)
ground = next(module for name, module in sys.modules.items() if name.endswith("operators.ground.world_ground"))


def height(x: float, y: float) -> float:
    """Return the height of the ground at a point of the world."""
    bpy.context.view_layer.update()
    found = ground.grounds_of(scene, bpy.context.evaluated_depsgraph_get())
    return float(ground.find_below(found, np.array([[x, y, 0.0]])).heights[0])


apart = [a - b for a, b in zip(terrains[0].location[:2], terrains[1].location[:2], strict=True)]
before = height(8250.0, -6100.0)
assert bpy.ops.adaptive_terrain.move_world() == {"FINISHED"}
scene.frame_set(1)
places = [camera.matrix_world.translation.copy()]
scene.frame_set(3)
places.append(camera.matrix_world.translation.copy())
result = {
    "apart": apart,
    "anchors": [list(terrain.adaptive_terrain.anchor) for terrain in terrains],
    "locations": [list(terrain.location[:2]) for terrain in terrains],
    "camera": [places[0].x, places[0].y, places[1].x],
    "moved_m": abs(height(8250.0 - 8192.0, 6144.0 - 6100.0) - before),
}
print("RESULT " + json.dumps(result))
