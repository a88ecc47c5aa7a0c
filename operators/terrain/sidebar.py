# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab *Terrain* of the sidebar, opened for the first terrain of a scene."""

import bpy

TAB = "Terrain"
TRIES, PAUSE_S = 20, 0.1  # the tabs of a sidebar are known only after it is drawn


def open_tab(viewports: list[tuple]) -> None:
    """Open the tab in the largest of some viewports, (window, area, region, region_3d) each.

    A timer tries until the tab is there.
    """
    if not viewports:
        return
    _, area, _, _ = max(viewports, key=lambda viewport: viewport[2].width * viewport[2].height)
    area.spaces.active.show_region_ui = True
    tries = iter(range(TRIES))
    bpy.app.timers.register(
        lambda: None if _chose_tab(area) or next(tries, None) is None else PAUSE_S, first_interval=PAUSE_S
    )


def _chose_tab(area) -> bool:
    """Choose the tab in the sidebar of an area; return False if it is not there yet, so that a timer tries again.

    True also if the area is gone or has no sidebar: there is nothing to try.
    """
    try:
        sidebar = next(region for region in area.regions if region.type == "UI")
        sidebar.active_panel_category = TAB
        return sidebar.active_panel_category == TAB
    except (AttributeError, TypeError):
        return False
    except (ReferenceError, StopIteration):  # the area is gone, or shows another editor
        return True
