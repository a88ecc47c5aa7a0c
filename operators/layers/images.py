# SPDX-License-Identifier: GPL-3.0-or-later
"""Images of splat layers and decals: values computed from their pixels, cached until an image changes."""

import glob
import io
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...cbt_terrain.attributes.splat_rules import Painted
from ...cbt_terrain.errors import TerrainError, shown
from ...cbt_terrain.formats.png_file import png_damage
from ...cbt_terrain.run.named_file import blocks_reader, open_regular
from ..bridge.scene_paths import absolute_path

T = TypeVar("T")
# By image name and kind of value: the state of the image, and the value.
_read: dict[tuple[str, type], tuple[tuple, object]] = {}


def painted_of(image, user: str = "of a splat layer") -> Painted:
    """Return the red channel of an image as a Painted, row 0 in the south, cached until the image changes.

    user: its reader in words, for errors. Raises TerrainError for an image without pixels.
    """
    return cached_value(image, Painted, user, _to_painted)


def _to_painted(_image, pixels: np.ndarray) -> Painted:
    """Return the red channel of pixels, float32 [rows, columns, channels], limited to 0 .. 1."""
    values = pixels[..., 0].copy()
    np.nan_to_num(values, copy=False)
    return Painted(np.clip(values, 0.0, 1.0, out=values))


def cached_value(image, kind: type[T], user: str, make: Callable[[object, np.ndarray], T]) -> T:
    """Return `make(image, pixels)`, cached until the image changes.

    pixels: float32 [rows, columns, channels], row 0 at the lower edge. kind: type of the value, of which an image has
    one each, always by the same `make`. user: its reader in words, for errors. Raises TerrainError for an image without
    pixels, for a truncated PNG file and for a pipe or a device.
    """
    image = image.original
    check_image_files(image, user)
    identity = *image.size, image.filepath, image.channels, image.colorspace_settings.name, image.alpha_mode
    cached = _read.get((image.name_full, kind))
    if cached is None or cached[0] != identity:
        _check_not_truncated(image, user)
        columns, rows = image.size
        if not image.channels or not rows * columns:
            raise TerrainError(
                f"The image {image.name!r} {user} has no pixels",
                expected="an image file that can be read",
                fix="find it, or choose another",
            )
        pixels = np.empty(rows * columns * image.channels, np.float32)
        image.pixels.foreach_get(pixels)
        cached = identity, make(image, pixels.reshape(rows, columns, image.channels))
        _read[image.name_full, kind] = cached
    return cached[1]


def check_image_files(image, user: str) -> None:
    """Raise TerrainError if a file of an image is a pipe or a device: Blender would wait for it forever.

    user: the image's reader in words, for the error.
    """
    if image.source == "GENERATED" or image.packed_file is not None:
        return
    path = Path(absolute_path(image.filepath_raw, library=image.library))
    waiting = next(filter(blocks_reader, [path, *numbered_files(path, image.source)]), None)
    if waiting is not None:
        raise TerrainError(
            f"The image {image.name!r} {user} is {shown(waiting)}, a pipe, a socket or a device",
            expected="an image file",
            fix="choose another",
        )


def numbered_files(path: Path, source: str) -> list[Path]:
    """Return the files of a tiled image or of a sequence, of which `path` names one or the pattern.

    source: of the image; [] for one that is neither TILED nor SEQUENCE.
    """
    number = {"TILED": r"<UDIM>|<UVTILE>|\d{4}(?=\.\w+$)", "SEQUENCE": r"\d+(?=\D*$)"}.get(source)
    if number is None or not path.name:
        return []
    pattern = "*".join(map(glob.escape, re.split(number, path.name)))
    return [Path(file) for file in glob.glob(os.path.join(glob.escape(str(path.parent)), pattern))]


def _check_not_truncated(image, user: str) -> None:
    """Raise TerrainError for a truncated PNG: Blender would show the missing part in black.

    user: the image's reader in words, for the error.
    """
    if image.is_dirty or image.source != "FILE":
        return  # painted: the file does not matter
    path = Path(absolute_path(image.filepath_raw, library=image.library))
    try:
        packed = image.packed_file
        with open_regular(path, links=True) if packed is None else io.BytesIO(packed.data) as file:
            damage = png_damage(file)
    except OSError:
        return  # a file that was read once may be gone by now
    if damage:
        raise TerrainError(
            f"The image {image.name!r} {user} is damaged ({damage})",
            expected="a whole PNG",
            fix="get the file again, and reload the image",
        )


@persistent
def forget_changed(_scene, depsgraph) -> None:
    """Drop the cached values of images that have changed. The next live update (handlers.py) reads them again."""
    changed = _changed_images(depsgraph) if _read else set()
    for key in [key for key in _read if key[0] in changed]:
        del _read[key]


def _changed_images(depsgraph) -> set[str]:
    """Return the full names of the images that may have changed by an update of a dependency graph.

    The graph does not have the images of empties. Reloading one updates its empty, without a transform. Painting one
    reports no more than that some image has changed, so all of them with unsaved changes are in the result, and those
    of hidden empties, which the graph does not update.
    """
    changed = set()
    for update in depsgraph.updates:
        if isinstance(update.id, bpy.types.Image):
            changed.add(update.id.name_full)
        elif isinstance(update.id, bpy.types.Object) and not update.is_updated_transform and _has_image(update.id):
            changed.add(update.id.data.name_full)
    if depsgraph.id_type_updated("IMAGE"):
        for obj in filter(_has_image, bpy.data.objects):
            if obj.data.is_dirty or not obj.evaluated_get(depsgraph).is_evaluated:
                changed.add(obj.data.name_full)
    return changed


def _has_image(obj) -> bool:
    """Return whether an object is an empty with an image."""
    return obj.type == "EMPTY" and obj.data is not None


@persistent
def forget(_file: str = "") -> None:
    """Forget the images that were read, since another file was opened."""
    _read.clear()
