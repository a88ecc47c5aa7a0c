# SPDX-License-Identifier: GPL-3.0-or-later
"""Import height maps through the operator, add an animated camera, and save: SAVE_TO FILE ..."""

import json
import math
import sys
import time

import bpy

save_to, *files = sys.argv[sys.argv.index("--") + 1 :]
bpy.ops.wm.read_homefile(use_empty=True)
scene = bpy.context.scene
result = {"version": bpy.app.version_string, "python": sys.version.split()[0], "terrains": {}}
for file in files:
    mesh = bpy.data.meshes.new("Terrain")
    terrain = bpy.data.objects.new("Terrain", mesh)
    scene.collection.objects.link(terrain)
    bpy.context.view_layer.objects.active = terrain
    settings = terrain.adaptive_terrain
    settings.enabled, settings.source, settings.source_path = True, "FILE", file
    if file.endswith(".exr"):  # an EXR knows no size
        settings.use_extent, settings.extent = True, (30000.0, 25000.0)
    if scene.camera is None:
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(camera)
        scene.camera = camera
        camera.data.clip_end = 1e6
        camera.rotation_euler = (math.radians(65), 0, 0)
        for frame, y in ((1, -9000.0), (3, -7000.0)):
            camera.location = (0, y, 3000)
            camera.keyframe_insert("location", frame=frame)
    start = time.perf_counter()
    assert bpy.ops.adaptive_terrain.import_source() == {"FINISHED"}
    vertices = [v.co.z for v in mesh.vertices]
    session, panel = (
        next(module for name, module in sys.modules.items() if name.endswith(f"adaptive_terrain.operators.{part}"))
        for part in ("session.session", "accuracy.panel")
    )
    result["terrains"][file] = {
        "import_s": time.perf_counter() - start,
        "triangles": len(mesh.polygons),
        "heights": [min(vertices), max(vertices)],
        "validate": mesh.validate(verbose=True),
        "panel": panel.statistics_lines(session.record_of(terrain).status),
        "store": bpy.path.abspath(settings.store),
    }
    if len(files) > 1:
        terrain.location.x += 40000.0
scene.frame_start, scene.frame_end = 1, 3
bpy.ops.wm.save_as_mainfile(filepath=save_to)
print("RESULT " + json.dumps(result))
