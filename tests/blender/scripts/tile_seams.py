# SPDX-License-Identifier: GPL-3.0-or-later
"""Render colours of several tiles from above in EEVEE, with the terrain's material and without mips: FOLDER.

The report has the largest and the median mean difference of a line of pixels.
"""

import importlib
import json
import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

SIZE = 400

folder = sys.argv[sys.argv.index("--") + 1] + "/seams"
tiling = importlib.import_module("bl_ext.user_default.adaptive_terrain.cbt_terrain.attributes.tiling")
tiling.SINGLE_CELLS, tiling.TILE_CELLS = 64, 200
scene = bpy.context.scene
terrain = next(item for item in scene.objects if item.adaptive_terrain.enabled)
terrain.adaptive_terrain.render.error_px = 4.0
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
bounds = np.array([terrain.matrix_world @ Vector(corner) for corner in terrain.bound_box])
side = float(np.ptp(bounds, 0)[:2].min())
camera.data.angle, camera.data.clip_end = 0.7, 10 * side
camera.location, camera.rotation_euler = (*bounds.mean(0)[:2], bounds[:, 2].max() + side), (0.0, 0.0, 0.0)
scene.render.resolution_x = scene.render.resolution_y = SIZE
scene.eevee.taa_render_samples = 1
scene.view_settings.view_transform = "Raw"
scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "PNG", "16"
scene.render.engine = "BLENDER_EEVEE" if bpy.app.version >= (5, 0) else "BLENDER_EEVEE_NEXT"


def picture(name: str) -> np.ndarray:
    scene.render.filepath = f"{folder}/{name}.png"
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    image.colorspace_settings.name = "Non-Color"
    return np.array(image.pixels[:]).reshape(SIZE, SIZE, 4)[..., :3]


shown = picture("shown")
for node in group.node_tree.nodes:
    if node.type == "TEX_IMAGE":
        node.interpolation = "Cubic"
off = np.abs(shown - picture("cubic")).mean(axis=2)
lines = np.concatenate([off.mean(axis=0), off.mean(axis=1)])
index = json.loads(next(Path(folder).glob("*/maps.json")).read_text())
tiles = len(index["maps"]["color"]["tiles"])
result = {"tiles": tiles, "most": float(lines.max()), "median": float(np.median(lines)), "range": float(np.ptp(shown))}
print("RESULT " + json.dumps(result))
