# SPDX-License-Identifier: GPL-3.0-or-later
"""Painted images as splat layers read them: the red of their pixels, kept until an image changes."""

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...cbt_terrain.effects.splat_rules import Painted
from ...cbt_terrain.errors import TerrainError

_read: dict[str, tuple[tuple, Painted]] = {}


def painted_of(image) -> Painted:
    """The red of an image, row 0 south. Raises TerrainError for one without pixels."""
    image = image.original
    mark = (*image.size, image.filepath, image.channels)
    kept = _read.get(image.name_full)
    if kept is None or kept[0] != mark:
        columns, rows = image.size
        if not image.channels or not rows * columns:
            raise TerrainError(
                f"The image {image.name!r} of a splat layer has no pixels; expected an image file that can be read: "
                "find it, or choose another."
            )
        pixels = np.empty(rows * columns * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        red = pixels.reshape(rows, columns, image.channels)[..., 0]
        kept = mark, Painted(np.clip(np.nan_to_num(red), 0.0, 1.0))
        _read[image.name_full] = kept
    return kept[1]


@persistent
def forget_changed(_scene, depsgraph) -> None:
    """Images that have changed are read again, and terrains that read them evaluated again."""
    changed = {update.id.name_full for update in depsgraph.updates if isinstance(update.id, bpy.types.Image)}
    if not changed & _read.keys():
        return
    for name in changed:
        _read.pop(name, None)
    for obj in bpy.data.objects:
        images = [layer.image for layer in obj.adaptive_terrain.layers if layer.image is not None]
        if any(image.name_full in changed for image in images):
            obj.update_tag()


@persistent
def _forget(_file) -> None:
    _read.clear()


def register() -> None:
    bpy.app.handlers.depsgraph_update_post.append(forget_changed)
    bpy.app.handlers.load_post.append(_forget)


def unregister() -> None:
    bpy.app.handlers.depsgraph_update_post.remove(forget_changed)
    bpy.app.handlers.load_post.remove(_forget)
    _read.clear()
