# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake colours, with a decal, and normals of the open file's terrain, and render it with them: FOLDER."""

import json
import sys
import time

import bpy
import numpy as np

folder = sys.argv[sys.argv.index("--") + 1] + "/maps"
scene = bpy.context.scene
terrain = next(item for item in scene.objects if item.adaptive_terrain.enabled)
terrain.adaptive_terrain.render.error_px = 8.0
image = bpy.data.images.new("Stain", 8, 8)
image.pixels.foreach_set(np.tile(np.float32([1, 0, 0, 1]), 64))
stain = bpy.data.objects.new("Stain", None)
stain.empty_display_type, stain.data, stain.empty_display_size = "IMAGE", image, 6000.0
stain.parent, stain.rotation_euler = terrain, (0.0, 0.0, 0.6)
light = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
light.data.energy, light.rotation_euler = 3.0, (0.9, 0.3, 0.0)
light.data.use_shadow = False  # whose shaders, compiled for a processor, take more time than the picture
for obj in (stain, light):
    scene.collection.objects.link(obj)
bpy.context.view_layer.objects.active = terrain
maps = terrain.adaptive_terrain.maps
maps.folder, maps.chosen = folder, {"color", "detail_normal"}
scene.render.resolution_x, scene.render.resolution_y = 192, 108
scene.cycles.samples, scene.cycles.use_denoising = 4, False  # Debian's build has no denoiser
scene.eevee.taa_render_samples = 1
scene.view_settings.view_transform = "Standard"
start = time.perf_counter()
assert bpy.ops.adaptive_terrain.bake_maps() == {"FINISHED"}
result = {"bake_s": time.perf_counter() - start, "red": {}}
assert bpy.ops.adaptive_terrain.terrain_material() == {"FINISHED"}
for engine in ("CYCLES", "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"):
    scene.render.engine, scene.render.filepath = engine, f"{folder}/{engine.lower()}.png"
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    pixels = np.array(picture.pixels[:]).reshape(-1, 4)
    red = (pixels[:, 0] > 0.25) & (pixels[:, 0] > 3 * pixels[:, 1])
    result["red"][engine] = [float(red.mean()), float(pixels[red, 0].std()) if red.any() else 0.0]
print("RESULT " + json.dumps(result))
