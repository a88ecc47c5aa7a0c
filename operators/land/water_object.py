# SPDX-License-Identifier: GPL-3.0-or-later
"""The object that shows the water of a terrain."""

MARK = "adaptive_terrain_water"  # a property of the object, by which it is found again under any name
LEVEL = "adaptive_terrain_sea_level"  # a property of the object: the level that the user has chosen, metres


def existing_water(terrain):
    """Return the water object of a terrain, None without one."""
    return next((child for child in terrain.children if child.type == "MESH" and child.get(MARK)), None)
