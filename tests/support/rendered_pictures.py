# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that Cycles renders, as arrays."""

import bpy
import numpy as np


def rendered(path, samples: int = 1) -> np.ndarray:
    """Render the scene to a file without denoising; return linear colours from bottom to top, [rows, columns, 4]."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", samples, False
    scene.view_settings.view_transform = "Raw"
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "OPEN_EXR", "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return pixels_of(path)


def pixels_of(path) -> np.ndarray:
    """Return the pixels of a picture file from bottom to top, float32 [rows, columns, 4]."""
    image = bpy.data.images.load(str(path))
    columns, rows = image.size
    pixels = np.empty((rows, columns, 4), np.float32)
    image.pixels.foreach_get(pixels.ravel())
    bpy.data.images.remove(image)
    return pixels
