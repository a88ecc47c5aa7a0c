# SPDX-License-Identifier: GPL-3.0-or-later
"""Decals of a terrain: image empties that are parented to it, as effects take them. Its Z axis projects them.

An image whose colour space is data (Non-Color) is a normal map, any other shows colours. Higher decals are on top.
"""

import numpy as np

from ...cbt_terrain.attributes.decals import Decal, DecalPicture, picture_of_rows
from ...cbt_terrain.view.linear import inverse, length, product
from ..bridge.evaluated import evaluated_or_still
from .images import cached_value

# IEC 61966-2-1, of each byte.
LINEAR = np.array(
    [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (k / 255 for k in range(256))], np.float32
)


def decal_parameters(terrain, placement: np.ndarray, depsgraph, tilts: bool) -> dict[str, object]:
    """Return a terrain's decals as the parameter "decals" of the attributes that show them; {} without decals.

    tilts: those whose images are normal maps, else those with colours. The lowest decal is first. placement: the
    terrain's matrix to the world, float64 [4, 4]. Raises TerrainError for an empty that stands upright, an image
    without pixels, or a hidden empty that Blender would have to evaluate.
    """
    found = []
    for child in terrain.original.children_recursive:
        if child.type == "EMPTY" and child.empty_display_type == "IMAGE" and _is_normal_map(child.data) == tilts:
            empty, matrix = evaluated_or_still(depsgraph, child, "decal")
            if not empty.hide_render:
                matrix = product(inverse(placement), np.array(matrix, np.float64))
                found.append((float(matrix[2, 3]), child.name_full, _to_decal(child.name, empty, matrix)))
    return {"decals": tuple(decal for *_, decal in sorted(found, key=lambda item: item[:2]))} if found else {}


def _to_decal(name: str, empty, matrix: np.ndarray) -> Decal:
    """Return the Decal of an image empty.

    matrix: from the empty's space to the terrain's. An empty's size is the length of the image's longer side.
    """
    image = empty.data.original
    picture = cached_value(image, DecalPicture, f"of the decal {name!r}", _to_picture)
    sides = np.array(image.size, np.float64) * np.array(image.display_aspect, np.float64)
    sides *= empty.empty_display_size / sides.max()
    along, up = matrix[:2, 0] * sides[0], matrix[:2, 1] * sides[1]  # sides of the image in plan, metres
    normal = np.cross(matrix[:3, 0], matrix[:3, 1])
    up = up * (abs(normal[2]) > 1e-5 * length(normal))  # 0 for an upright one, where only rounding errors are left
    corner = matrix[:2, 3] + along * empty.empty_image_offset[0] + up * empty.empty_image_offset[1]
    opacity = empty.color[3] if empty.use_empty_image_alpha else 1.0
    return Decal(name, picture, *(tuple(v.tolist()) for v in (corner, along, up)), float(opacity))


def _is_normal_map(image) -> bool | None:
    """Return whether a decal's image is a normal map, None without an image."""
    return None if image is None else image.colorspace_settings.is_data


def _to_picture(image, pixels: np.ndarray) -> DecalPicture:
    """Return a DecalPicture from Blender's pixels, float32 [rows, columns, channels]: linear colours and alpha.

    One channel is grey; without an alpha channel, or if the image ignores it, alpha is 1.
    """
    has_alpha = pixels.shape[2] == 4 and image.alpha_mode != "NONE"
    is_multiplied = image.is_float and image.alpha_mode in ("STRAIGHT", "PREMUL")  # as Blender holds float colours
    is_srgb = not image.is_float and image.colorspace_settings.name == "sRGB"
    num_colours = 3 if pixels.shape[2] >= 3 else 1  # grey is given to all three

    def read_rows(first: int, end: int) -> np.ndarray:
        """Return linear colours and alpha of rows `first` to `end` - 1, float32 [rows, columns, 4]."""
        part = pixels[first:end]
        linear = np.empty((*part.shape[:2], 4), np.float32)
        if is_srgb:
            levels = np.clip(part, 0.0, 1.0)
            levels *= np.float32(255.0)
            levels += np.float32(0.5)
            # LINEAR: the linear value of each byte in sRGB.
            part = LINEAR.take(levels.astype(np.uint8), mode="clip")  # alpha, too: faster than colours alone
        if part.shape[2] == 4:
            linear[...] = part
        else:
            linear[..., :3] = part[..., :num_colours]
        linear[..., 3:] = pixels[first:end, :, 3:] if has_alpha else 1.0
        if is_multiplied:
            linear[..., :3] /= np.maximum(linear[..., 3:], np.float32(1e-6))
        return linear

    return picture_of_rows((*pixels.shape[:2], 4), read_rows, tilts=_is_normal_map(image))  # tilts: stored as slopes
