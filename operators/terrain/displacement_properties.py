# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of displacement, relief below a raster's cells: `object.adaptive_terrain.ground`, and of its layers."""

import bpy
from bpy.props import FloatProperty, IntProperty, PointerProperty

from ...cbt_terrain.field.detail import Detail
from ...cbt_terrain.field.tiled import Tiled
from ..layers.images import painted_of
from .detail_properties import changed


def is_gray(_settings, image) -> bool:
    """Return whether the red channel of an image can be read: it is a file or painted. Blender offers only these."""
    return image.source in {"FILE", "GENERATED"}


class DisplacementSettings(bpy.types.PropertyGroup):
    """Relief finer than the height map: octaves of noise, or an image."""

    amplitude: FloatProperty(
        name="Amplitude",
        description="Largest height of the added relief above and below the height map, in metres; 0 adds none. It "
        "takes triangles only where the camera can see it",
        default=0.0, min=0.0, soft_max=2.0, precision=3, step=1, unit="LENGTH", update=changed,
    )  # fmt: skip
    wavelength: FloatProperty(
        name="Wavelength",
        description="Size of the largest waves, in metres; up to eight smaller ones follow, each half as long",
        default=4.0, min=0.01, soft_max=100.0, precision=2, unit="LENGTH", update=changed,
    )  # fmt: skip
    roughness: FloatProperty(
        name="Roughness",
        description="Height of each smaller wave compared with the one twice as long: higher is rougher",
        default=0.5, min=0.0, max=1.0, precision=2, subtype="FACTOR", update=changed,
    )  # fmt: skip
    seed: IntProperty(
        name="Seed", description="Another number gives another random pattern", default=0, min=0, update=changed
    )
    image: PointerProperty(
        name="Image",
        description="Tiling image to use instead of noise: in its red channel white is high and black is as far below "
        "the surface",
        type=bpy.types.Image, poll=is_gray, update=changed,
    )  # fmt: skip
    tile: FloatProperty(
        name="Tile Size",
        description="Width of one tile of the image, in metres",
        default=4.0, min=0.01, soft_max=100.0, precision=2, unit="LENGTH", update=changed,
    )  # fmt: skip


def displacement_of(settings) -> Detail | Tiled | None:
    """Return the engine's displacement for a DisplacementSettings; None if its amplitude is 0.

    Raises TerrainError for an invalid number or an image that cannot be read.
    """
    if settings.image is not None:
        detail = Tiled(settings.amplitude, settings.tile, painted_of(settings.image, "of a displacement"))
    else:
        detail = Detail(settings.amplitude, settings.wavelength, settings.roughness, settings.seed)
    return detail if detail.amplitude else None
