# SPDX-License-Identifier: GPL-3.0-or-later
"""Render frames 1 - 3 of the open file with motion blur in Cycles: OUTPUT_PREFIX."""

import json
import sys
import time

import bpy

[prefix] = sys.argv[sys.argv.index("--") + 1 :]
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.cycles.samples, scene.cycles.device = 4, "CPU"
scene.cycles.use_denoising = False  # Debian's build has no denoiser
scene.render.resolution_x, scene.render.resolution_y = 160, 120
scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
scene.render.filepath = prefix
light = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
light.data.energy, light.rotation_euler = 2.0, (1.0, 0.3, 0.0)
scene.collection.objects.link(light)
terrain = next(item for item in scene.objects if item.adaptive_terrain.enabled)
terrain.adaptive_terrain.viewport.error_px = 20.0

calls = []  # what each frame change saw, after the extension's own handler
rendered = []


def on_frame_change(scene, depsgraph):
    shape = len(terrain.data.polygons), sum(v.co.x for v in terrain.data.vertices[:100])
    calls.append([scene.frame_current, scene.frame_subframe, depsgraph.mode, *shape])


def on_render_pre(scene, _unused):
    calls.append([scene.frame_current, scene.frame_subframe, "PRE", 0, 0])


def on_render_post(scene, _unused):
    rendered.append([scene.frame_current, len(terrain.data.polygons)])


bpy.app.handlers.frame_change_post.append(on_frame_change)
bpy.app.handlers.render_pre.append(on_render_pre)
bpy.app.handlers.render_post.append(on_render_post)
scene.frame_set(1)
calls.clear()
viewport_triangles = len(terrain.data.polygons)
start = time.perf_counter()
bpy.ops.render.render(animation=True)
result = {
    "render_s": time.perf_counter() - start,
    "calls": calls,
    "rendered": rendered,
    "viewport_triangles": viewport_triangles,
    "after": len(terrain.data.polygons),
}
print("RESULT " + json.dumps(result))
