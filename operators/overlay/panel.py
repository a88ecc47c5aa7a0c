# SPDX-License-Identifier: GPL-3.0-or-later
"""The overlay's panel: which colours, where they are shown, what they mean."""

import bpy
import bpy.utils.previews

from ..session import session
from ..terrain.properties import NO_OVERLAY
from ..ui.panel_parts import TerrainSubpanel
from .colors import LEGEND_LINES

SWATCH_SIZE = 8
_swatches = None  # a preview collection: an icon for each colour, by its name


class OverlayPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_overlay"
    bl_label = "Overlay"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_advanced"

    def draw(self, context):
        """Draw which overlay is shown, and its legend in a fixed number of rows."""
        column = self._columns()
        obj = session.shown_terrain(context)
        column.prop(obj.adaptive_terrain, "overlay")
        if obj.adaptive_terrain.overlay == NO_OVERLAY:
            return
        column.operator("adaptive_terrain.show_overlay", icon="SHADING_SOLID")
        overlay = session.record_of(obj).overlay
        legend = overlay.legend if overlay else []
        for text, colour in legend:
            column.label(text=text, icon_value=swatch(colour))
        for _ in range(LEGEND_LINES + 1 - len(legend)):  # rows below do not move
            column.label(text="")


def swatch(colour: tuple[float, float, float]) -> int:
    """Return the icon of an sRGB colour; 0 without a window."""
    name = "{:.3f} {:.3f} {:.3f}".format(*colour)
    if name not in _swatches:
        preview = _swatches.new(name)
        preview.icon_size = SWATCH_SIZE, SWATCH_SIZE
        preview.icon_pixels_float = (*colour, 1.0) * SWATCH_SIZE**2
    return _swatches[name].icon_id


class ShowOverlay(bpy.types.Operator):
    """Show the overlay's colours: switch every 3D viewport of this window to Solid with the color of attributes"""

    bl_idname = "adaptive_terrain.show_overlay"
    bl_label = "Show in Viewport"

    def execute(self, context):
        """Set all viewports of the window to solid shading with the mesh's colours."""
        for area in context.screen.areas:
            if area.type == "VIEW_3D":
                area.spaces.active.shading.type = "SOLID"
                area.spaces.active.shading.color_type = "VERTEX"
        return {"FINISHED"}


def start() -> None:
    """Create the collection of colour swatches that the panel shows; `stop` removes it."""
    global _swatches
    _swatches = bpy.utils.previews.new()


def stop() -> None:
    """Free the swatches of the legend."""
    global _swatches
    bpy.utils.previews.remove(_swatches)
    _swatches = None
