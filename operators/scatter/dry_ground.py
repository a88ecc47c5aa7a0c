# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules that keep a new scatter out of water."""

from ...cbt_terrain.height_operators.catalogue import operator_of
from ..importing.imported import imported_of
from ..land.water_object import shown_sea
from ..text.numbers import length_text
from .request import scatters_of

FILM_M = 0.05  # depth of rain that runs off a slope
SAME_LEVEL_M = 0.01  # two levels of the sea that differ by less are the same
SEA = "sea"  # parameter of height operators: all ground up to this height is sea


def keep_dry(settings, terrain) -> str:
    """Keep the scatter of `settings` out of a terrain's water; return a clause about the result, for a sentence.

    Water Depth is on in any case: it acts once the stack has *Water* or *Flood* and the land is shaped. Above the Sea
    is on for land that reaches down to the level of the sea: that of *Add Water* if there is one.
    """
    terrain_settings = terrain.adaptive_terrain
    depth_rule, entries = settings.where.water_depth, terrain_settings.land.entries
    # Points stay where the water is no deeper than a film of rain.
    depth_rule.use, depth_rule.low, depth_rule.high, depth_rule.edge = True, 0.0, FILM_M, FILM_M
    notes = ["none in the water of the stack"] if _has_water(entries) else []
    imported, sea = imported_of(terrain_settings), shown_sea(terrain)
    sea = _sea_level(entries) if sea is None else sea  # metres of the height map
    settings.sea_level = _in_terrain(sea, terrain_settings)
    settings.use_sea = imported is not None and imported.heights_m[0] <= sea < imported.heights_m[1]
    notes += [f"none below the sea at {length_text(settings.sea_level)}"] if settings.use_sea else []
    return ", ".join(notes) or "the terrain has no water"


def follow_sea(terrain, before: float | None, is_new: bool) -> None:
    """Keep the scatters of a terrain out of the sea that *Add Water* shows now.

    The water object has to show a sea. before: the level that it showed before in metres of the height map, None for
    no sea. is_new: it showed none before, which switches *Above the Sea* on; later a scatter's level is changed only
    where it was that of the water.
    """
    settings, sea = terrain.adaptive_terrain, shown_sea(terrain)
    for scatter in (obj.adaptive_scatter for obj in scatters_of(terrain)):
        has_followed = before is not None and abs(scatter.sea_level - _in_terrain(before, settings)) <= SAME_LEVEL_M
        if is_new or has_followed:
            scatter.sea_level = _in_terrain(sea, settings)
            scatter.use_sea |= is_new


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
