# SPDX-License-Identifier: GPL-3.0-or-later
"""Previews of assets, rendered by Cycles: Blender itself draws none without a window."""

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

SIDE, SAMPLES = 128, 8  # pixels; rays for each
AHEAD = Vector((-0.55, 0.75, -0.38)).normalized()  # from the camera
SUN_ANGLES = math.radians(50.0), 0.0, math.radians(-35.0)
HILL, HILL_SIDE = 300.0, 65  # metres across, and samples a side, of the ground that shows materials


class Studio:
    """A scene with sun, grey sky and an orthographic camera that frames the objects in it. `file`: the last picture.

    The given scene gets these, and settings for small pictures; `folder` gets the picture.
    """

    def __init__(self, scene, folder: Path):
        """Set up a scene for small pictures of objects on a transparent background; `folder` gets the picture."""
        self.scene, self.file = scene, folder / "preview.png"
        scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", SAMPLES
        scene.cycles.use_denoising, scene.cycles.max_bounces = False, 4
        scene.render.resolution_x = scene.render.resolution_y = SIDE
        scene.render.film_transparent = True
        scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGBA"
        scene.view_settings.view_transform = "Standard"
        scene.world = bpy.data.worlds.new("Preview")
        scene.world.color = 0.45, 0.5, 0.55
        sun = bpy.data.lights.new("Preview", "SUN")
        sun.energy = 3.5
        lamp = bpy.data.objects.new("Preview", sun)
        lamp.rotation_euler = SUN_ANGLES
        camera = bpy.data.cameras.new("Preview")
        camera.type, camera.clip_end = "ORTHO", 1e5
        scene.camera = bpy.data.objects.new("Preview", camera)
        for obj in (lamp, scene.camera):
            scene.collection.objects.link(obj)

    def take(self, item, objects) -> None:
        """Render objects, which need not be in the scene, side by side; the picture becomes a data-block's preview."""
        instances = self._place(objects)
        self.scene.render.filepath = str(self.file)
        bpy.ops.render.render(write_still=True)
        for obj in instances:
            bpy.data.objects.remove(obj)
        image = bpy.data.images.load(str(self.file))
        pixels = np.empty(4 * SIDE * SIDE, np.float32)
        image.pixels.foreach_get(pixels)
        bpy.data.images.remove(image)
        preview = item.preview_ensure()
        preview.image_size = SIDE, SIDE
        preview.image_pixels_float.foreach_set(pixels)

    def _place(self, objects) -> list:
        """Add instances of the objects in a row from the left to the right of the picture, and frame them.

        They overlap by a tenth of their widths. Return the instances, which the caller removes.
        """
        turn = AHEAD.to_track_quat("-Z", "Y").to_matrix()  # from the camera to the world
        right, offset, corners, instances = Vector((turn.col[0].x, turn.col[0].y, 0.0)).normalized(), 0.0, [], []
        for obj in objects:
            to_world = Matrix.Translation(right * offset)
            instance = bpy.data.objects.new("Preview", obj.data)
            instance.matrix_world = to_world
            self.scene.collection.objects.link(instance)
            instances.append(instance)
            corners += [to_world @ Vector(corner) for corner in obj.bound_box]
            offset += 0.9 * np.ptp(obj.bound_box, axis=0)[:2].max()
        in_camera = np.array([turn.transposed() @ corner for corner in corners])
        low, high = in_camera.min(axis=0), in_camera.max(axis=0)
        self.scene.camera.data.ortho_scale = float(1.08 * (high - low)[:2].max())  # with a margin of 4 % at each side
        middle = Vector(((low + high) / 2).tolist())
        middle.z = high[2] + 100.0  # in front of all
        self.scene.camera.matrix_world = Matrix.Translation(turn @ middle) @ turn.to_4x4()
        return instances

    def new_ground(self, layers: int):
        """Return a new hill with the attribute splat_1, whose layers change with the height, and water_depth.

        It is in no scene; the caller removes it. layers: number of layers, 4 at most, from the lowest to the highest
        ground.
        """
        x, y = np.meshgrid(*[np.linspace(-1.0, 1.0, HILL_SIDE)] * 2)
        z = 0.5 * np.exp(-2.5 * (x * x + y * y)) + 0.05 * np.sin(7.0 * x) * np.cos(6.0 * y)
        points = np.c_[x.ravel(), y.ravel(), z.ravel()] * HILL / 2
        first = np.add.outer(np.arange(HILL_SIDE - 1) * HILL_SIDE, np.arange(HILL_SIDE - 1)).ravel()  # corner of a face
        faces = np.c_[first, first + 1, first + 1 + HILL_SIDE, first + HILL_SIDE]
        mesh = bpy.data.meshes.new("Preview")
        mesh.from_pydata(points, [], faces)
        mesh.shade_smooth()
        height = (z.ravel() - z.min()) / np.ptp(z) * layers
        # [vertices, 4]: each layer has its most weight in the middle of its range of heights.
        weights = np.clip(1.0 - abs(height[:, None] - (np.arange(4) + 0.5)), 0.0, 1.0).astype(np.float32)
        splat = mesh.attributes.new("splat_1", "FLOAT_COLOR", "POINT")
        splat.data.foreach_set("color", weights.ravel())
        depth = mesh.attributes.new("water_depth", "FLOAT", "POINT")
        depth.data.foreach_set("value", (20.0 * (1.0 - height / layers)).astype(np.float32))
        return bpy.data.objects.new("Preview", mesh)
