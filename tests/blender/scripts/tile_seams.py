# SPDX-License-Identifier: GPL-3.0-or-later
"""Render maps of several tiles from above, in EEVEE: how much lines between tiles differ from what is beside them.

The colours are one decal's, which get brighter evenly from west to east: FOLDER.
"""

import json
import sys

import bpy
import numpy as np

folder = sys.argv[sys.argv.index("--") + 1]
tiling = next(module for name, module in sys.modules.items() if name.endswith("cbt_terrain.maps.tiling"))
tiling.SINGLE_CELLS, tiling.TILE_CELLS = 64, 100
scene = bpy.context.scene
terrain = next(item for item in scene.objects if item.adaptive_terrain.enabled)
terrain.adaptive_terrain.render.error_px = 4.0
corners = np.array(terrain.bound_box)
side = float(np.ptp(corners, 0)[:2].max())
image = bpy.data.images.new("Ramp", 64, 64, float_buffer=True)
ramp = np.ones((64, 64, 4), np.float32)
ramp[..., :3] = np.linspace(0.2, 0.8, 64, dtype=np.float32)[None, :, None]
image.pixels.foreach_set(ramp.ravel())
stain = bpy.data.objects.new("Ramp", None)
stain.empty_display_type, stain.data, stain.empty_display_size = "IMAGE", image, 1.2 * side
stain.parent = terrain
scene.collection.objects.link(stain)
bpy.context.view_layer.objects.active = terrain
maps = terrain.adaptive_terrain.maps
maps.folder, maps.chosen, maps.frames = folder, {"color"}, "WHOLE"
assert bpy.ops.adaptive_terrain.bake_maps() == {"FINISHED"}
assert bpy.ops.adaptive_terrain.terrain_material() == {"FINISHED"}
tree = terrain.material_slots[0].material.node_tree
group = next(node for node in tree.nodes if node.type == "GROUP")
group.inputs["Variation"].default_value = 0.0
emission = tree.nodes.new("ShaderNodeEmission")
output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL" and node.is_active_output)
tree.links.new(group.outputs["Color"], emission.inputs["Color"])
tree.links.new(emission.outputs[0], output.inputs["Surface"])
camera = scene.camera
camera.animation_data_clear()
camera.data.type, camera.data.ortho_scale = "ORTHO", 0.7 * side
camera.data.clip_end = 10 * side
camera.location, camera.rotation_euler = (0.0, 0.0, corners[:, 2].max() + 1000.0), (0.0, 0.0, 0.0)
scene.render.resolution_x = scene.render.resolution_y = 400
scene.eevee.taa_render_samples = 16
scene.view_settings.view_transform = "Raw"
scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "PNG", "16"
found = {}
for engine in ("BLENDER_EEVEE_NEXT",):
    scene.render.engine, scene.render.filepath = engine, f"{folder}/{engine.lower()}.png"
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    picture.colorspace_settings.name = "Non-Color"
    red = np.array(picture.pixels[:]).reshape(400, 400, 4)[..., 0]
    off = np.abs(red[8:-8, 8:-8] - 0.5 * (red[8:-8, :-16] + red[8:-8, 16:]))
    found[engine] = {"most": float(off.max()), "line": float(off.mean(axis=0).max()), "range": float(np.ptp(red))}
tiles = len(json.loads(next(iter(__import__("pathlib").Path(folder).glob("*/maps.json"))).read_text())["maps"]["color"]["tiles"])
print("RESULT " + json.dumps({"tiles": tiles, "engines": found}))
