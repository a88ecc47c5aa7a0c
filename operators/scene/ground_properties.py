# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the detail below a raster's cells: `object.adaptive_terrain.ground`."""

import bpy
from bpy.props import FloatProperty, IntProperty

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.detail import Detail
from .detail_properties import changed


class GroundDetail(bpy.types.PropertyGroup):
    """Octaves of height that the height map is too coarse for."""

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


def ground_of(settings, name: str) -> Detail | None:
    """The detail that a GroundDetail asks for, of the terrain `name`; None where it has no amplitude."""
    try:
        detail = Detail(settings.amplitude, settings.wavelength, settings.roughness, settings.seed)
    except TerrainError as error:  # a driver or a script may set any number
        raise TerrainError(f"The terrain {name!r} cannot be refined. {error}") from None
    return detail if detail.amplitude else None
