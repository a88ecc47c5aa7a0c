# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules that keep a new scatter out of water."""

from ...cbt_terrain.height_operators.catalogue import operator_of
from ..importing.imported import imported_of
from ..land.water_object import existing_water
from ..text.numbers import length_text
from .open_water import FILM_M

SEA = "sea"  # parameter of height operators: all ground up to this height is sea


def keep_dry(settings, terrain) -> str:
    """Keep the scatter of `settings` out of a terrain's water; return a clause about the result, for a sentence.

    Water Depth is on in any case: it acts on the water of *Add Water*, and on that of the stack once it has *Water* or
    *Flood* and the land is shaped. Above the Sea is on for land that reaches down to the level of the sea.
    """
    terrain_settings = terrain.adaptive_terrain
    depth_rule, entries = settings.where.water_depth, terrain_settings.land.entries
    # Points stay where the water is no deeper than a film of rain.
    depth_rule.use, depth_rule.low, depth_rule.high, depth_rule.edge = True, 0.0, FILM_M, FILM_M
    imported, sea = imported_of(terrain_settings), _sea_level(entries)  # metres of the height map
    settings.sea_level = _in_terrain(sea, terrain_settings)
    settings.use_sea = imported is not None and imported.heights_m[0] <= sea < imported.heights_m[1]
    has_object = existing_water(terrain) is not None
    notes = ["none in the water"] if has_object or _has_water(entries) else []
    if settings.use_sea and not has_object:
        notes.append(f"none below the sea at {length_text(settings.sea_level)}")
    return ", ".join(notes) or "the terrain has no water"


def _in_terrain(height: float, terrain_settings) -> float:
    """Return the z in the terrain's own space of a height of the height map, both metres."""
    return height * terrain_settings.vertical_scale + terrain_settings.vertical_offset


def _has_water(entries) -> bool:
    """Return whether an operator of the stack leaves the layer `water_depth`."""
    effects = [effect for entry in entries if entry.on and (effect := operator_of(entry.effect)) is not None]
    return any(layer.name == "water_depth" for effect in effects for layer in effect.layers)


def _sea_level(entries) -> float:
    """Return the height of the sea in the stack's last operator that has one, else 0."""
    # An entry has the parameters of its effect in a member of the effect's name.
    levels = [getattr(getattr(entry, entry.effect, None), SEA, None) for entry in entries if entry.on]
    return next((level for level in reversed(levels) if level is not None), 0.0)
