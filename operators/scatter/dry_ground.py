# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules that keep a new scatter out of water."""

from ...cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from ..importing.imported import imported_of
from ..text.numbers import length_text

FILM_M = 0.05  # depth of rain that runs off a slope
SEA = "sea"  # parameter of height operators: all ground up to this height is sea


def keep_dry(settings, terrain_settings) -> str:
    """Keep a scatter out of a terrain's water; return a sentence about the result.

    Water Depth is on in any case: it acts once the stack has *Water* or *Flood* and the land is shaped. Above the Sea
    is on for land that reaches down to the level of the sea.
    """
    depth, entries = settings.where.water_depth, terrain_settings.land.entries
    depth.use, depth.low, depth.high, depth.edge = True, 0.0, FILM_M, FILM_M
    notes = ["none in the water of the stack"] if _has_water(entries) else []
    found, sea = imported_of(terrain_settings), _sea_level(entries)
    settings.sea_level = sea * terrain_settings.vertical_scale + terrain_settings.vertical_offset
    settings.use_sea = found is not None and found.heights_m[0] <= sea < found.heights_m[1]
    notes += [f"none below the sea at {length_text(settings.sea_level)}"] if settings.use_sea else []
    return ", ".join(notes) or "the terrain has no water"


def _has_water(entries) -> bool:
    effects = [HEIGHT_OPERATORS[entry.effect] for entry in entries if entry.on and entry.effect in HEIGHT_OPERATORS]
    return any(layer.name == "water_depth" for effect in effects for layer in effect.layers)


def _sea_level(entries) -> float:
    """Return the height of the sea in the stack's last operator that has one, else 0."""
    levels = [getattr(getattr(entry, entry.effect, None), SEA, None) for entry in entries if entry.on]
    return next((level for level in reversed(levels) if level is not None), 0.0)
