# SPDX-License-Identifier: GPL-3.0-or-later
"""What open windows read of a mesh: solid viewports coloured by it, and spreadsheets."""

import bpy

from ...cbt_terrain.effects.effect import PICTURE
from .found import ALL, Demand
from .materials import read_workbench


def screens_key() -> tuple:
    """Changes with whatever `read_screens` depends on."""
    return tuple(
        (area.type, shading.type, shading.color_type) if shading else (area.type,) for area, shading in _areas()
    )


def read_screens(found: Demand) -> None:
    """Add what the windows show of any mesh."""
    for area, shading in _areas():
        if area.type == "SPREADSHEET":
            found.add(ALL, "an open spreadsheet shows every attribute", PICTURE)
        elif shading.type == "SOLID":
            read_workbench(found, shading, "viewport, solid shading")


def _areas() -> list[tuple]:
    """Areas that show meshes, with the shading of those that have one."""
    manager = bpy.context.window_manager
    windows = manager.windows if manager else ()
    areas = [area for window in windows for area in window.screen.areas if area.type in ("VIEW_3D", "SPREADSHEET")]
    return [(area, area.spaces.active.shading if area.type == "VIEW_3D" else None) for area in areas]
