# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement by a terrain's settings: on the whole terrain, and on its splat layers."""

from ...cbt_terrain.attributes.layered_detail import LayeredDetail
from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.field.displacement_layers import Ground
from ..layers.properties import layers_of
from .displacement_properties import displacement_of


def ground_of(settings, name: str) -> Ground | LayeredDetail | None:
    """Return the displacement of a terrain and of its splat layers; None if no amplitude is above 0.

    name: the terrain's, for errors. Raises TerrainError.
    """
    try:  # a driver or a script may set any number
        everywhere = displacement_of(settings.ground)
        found = ((number, displacement_of(layer.detail)) for number, layer in enumerate(settings.layers))
        details = tuple((number, detail) for number, detail in found if detail is not None)
        return LayeredDetail(everywhere, layers_of(settings), details) if details else everywhere
    except TerrainError as error:
        raise error.within(f"The terrain {name!r} cannot be refined") from None
