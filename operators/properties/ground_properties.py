# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the detail below a raster's cells: `object.adaptive_terrain.ground`, and of its layers."""

import bpy
from bpy.props import FloatProperty, IntProperty, PointerProperty

from ...cbt_terrain.field.detail import Detail
from ...cbt_terrain.field.tiled import Tiled
from .detail_properties import changed
from .layer_images import painted_of


def _is_gray(_settings, image) -> bool:
    return image.source in {"FILE", "GENERATED"}


class GroundDetail(bpy.types.PropertyGroup):
    """Height that the height map is too coarse for: octaves of noise, or an image."""

    amplitude: FloatProperty(
        name="Amplitude",
        description="Detail that is added to the height map, at most so many metres above and below it; 0 adds none. "
        "It takes triangles only where the camera can see it",
        default=0.0, min=0.0, soft_max=2.0, precision=3, step=1, unit="LENGTH", update=changed,
    )  # fmt: skip
    wavelength: FloatProperty(
        name="Wavelength",
        description="Length of the longest wave of detail, in metres; up to eight more are half as long each",
        default=4.0, min=0.01, soft_max=100.0, precision=2, unit="LENGTH", update=changed,
    )  # fmt: skip
    roughness: FloatProperty(
        name="Roughness",
        description="Height of each wave of detail, as a part of that of the one twice as long",
        default=0.5, min=0.0, max=1.0, precision=2, subtype="FACTOR", update=changed,
    )  # fmt: skip
    seed: IntProperty(name="Seed", description="Another seed is other detail", default=0, min=0, update=changed)
    image: PointerProperty(
        name="Image",
        description="A tiling image in place of noise: its red is the height, black as far below the surface as white "
        "is above it",
        type=bpy.types.Image, poll=_is_gray, update=changed,
    )  # fmt: skip
    tile: FloatProperty(
        name="Tile Size",
        description="Width of a tile of the image, in metres",
        default=4.0, min=0.01, soft_max=100.0, precision=2, unit="LENGTH", update=changed,
    )  # fmt: skip


def detail_of(settings) -> Detail | Tiled | None:
    """The detail that a GroundDetail asks for; None where it has no amplitude."""
    if settings.image is not None:
        detail = Tiled(settings.amplitude, settings.tile, painted_of(settings.image, "of a detail"))
    else:
        detail = Detail(settings.amplitude, settings.wavelength, settings.roughness, settings.seed)
    return detail if detail.amplitude else None
