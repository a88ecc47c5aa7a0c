# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that open windows read: solid viewports coloured by them, and spreadsheets."""

import bpy

from ....cbt_terrain.attributes.attribute import PICTURE
from .found import ALL, Demand
from .materials import read_workbench


def screens_key() -> tuple:
    """Return a key of everything that `read_screens` depends on."""
    return tuple(
        (area.type, shading.type, shading.color_type) if shading else (area.type,) for area, shading in _areas()
    )


def read_screens(found: Demand) -> None:
    """Add the attributes that windows show of any mesh."""
    for area, shading in _areas():
        if area.type == "SPREADSHEET":
            found.add(ALL, "an open spreadsheet shows every attribute", PICTURE)
        elif shading.type == "SOLID":
            read_workbench(found, shading, "viewport, solid shading")


def _areas() -> list[tuple]:
    """Return the areas that show meshes, each with its shading or None."""
    manager = bpy.context.window_manager
    windows = manager.windows if manager else ()
    areas = [area for window in windows for area in window.screen.areas if area.type in ("VIEW_3D", "SPREADSHEET")]
    return [(area, area.spaces.active.shading if area.type == "VIEW_3D" else None) for area in areas]
