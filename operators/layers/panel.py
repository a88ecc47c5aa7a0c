# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel of splat layers: which ones, in which order, and where each lies."""

import bpy
from bl_ui.utils import PresetPanel

from ...cbt_terrain.attributes.splat_rules import covers_nothing
from ..ui.panel_parts import LIMITS, TerrainSubpanel, draw_band, draw_ground, show_terrain
from .operators import PRESET_PANEL, PRESETS
from .properties import BANDS, rule_of


class LayerList(bpy.types.UIList):
    """A row for each layer: its color, its name, its rules."""

    bl_idname = "ADAPTIVE_TERRAIN_UL_layers"

    def draw_item(self, _context, layout, _data, layer, _icon, _active_data, _active_name):
        """Draw the row of one layer: its colour, name, icons of its mask and image, and whether it is on top."""
        row = layout.row(align=True)
        swatch = row.row()
        swatch.ui_units_x = 1.0
        swatch.prop(layer, "color", text="")
        row.prop(layer, "name", text="", emboss=False)
        if layer.mask:
            row.label(icon="MOD_MASK")
        if layer.image is not None:
            row.label(icon="IMAGE_DATA")
        row.prop(layer, "on_top", text="", icon="TRIA_UP_BAR" if layer.on_top else "REMOVE", emboss=False)


class LayerPresets(PresetPanel, bpy.types.Panel):
    bl_label = "Layer Presets"
    preset_subdir = PRESETS
    preset_operator = "script.execute_preset"
    preset_add_operator = "adaptive_terrain.layer_preset_add"

    def draw(self, context):
        """Draw the presets, whose buttons act on the shown terrain."""
        show_terrain(self.layout, context)
        PresetPanel.draw(self, context)


# Blender finds the panel by the name of its class.
LayerPresets.__name__ = LayerPresets.bl_idname = PRESET_PANEL


class LayersPanel(TerrainSubpanel):
    bl_idname = "ADAPTIVE_TERRAIN_PT_layers"
    bl_label = "Layers"
    bl_parent_id = "ADAPTIVE_TERRAIN_PT_look"
    bl_options = set()

    def draw_header_preset(self, _context):
        """Draw the menu of presets in the panel's header."""
        LayerPresets.draw_panel_header(self.layout)

    def draw(self, context):
        """Draw the list with its buttons, and the settings of the active layer."""
        settings = show_terrain(self.layout, context).adaptive_terrain
        row = self.layout.row()
        row.template_list(LayerList.bl_idname, "", settings, "layers", settings, "active_layer", rows=4)
        buttons = row.column(align=True)
        buttons.operator("adaptive_terrain.layer_add", text="", icon="ADD")
        buttons.operator("adaptive_terrain.layer_remove", text="", icon="REMOVE")
        buttons.separator()
        buttons.operator("adaptive_terrain.layer_move", text="", icon="TRIA_UP").by = -1
        buttons.operator("adaptive_terrain.layer_move", text="", icon="TRIA_DOWN").by = 1
        if not settings.layers:
            self.layout.label(text="None: grass, scree, rock and snow", icon="INFO")
        elif settings.active_layer < len(settings.layers):
            _draw_layer(self._columns(), settings, settings.layers[settings.active_layer])


def _draw_layer(column, settings, layer) -> None:
    """Draw the rules, the mask and the displacement of one layer."""
    draw_rules(column, layer)
    column.prop_search(layer, "mask", settings, "layers")
    column.separator()
    column.label(text="Displacement")
    draw_ground(column, layer.detail)


def draw_rules(column, layer) -> None:
    """Draw the rules for the ground that a layer covers, without its mask by another layer.

    Scatters have the same rules.
    """
    column.prop(layer, "strength")
    for kind in BANDS:
        band = getattr(layer, kind)
        draw_band(column, band, LIMITS)
        if band.use and covers_nothing(rule_of(kind, band)):
            column.label(text="Nothing: From is above To", icon="ERROR")
    draw_band(column, layer.aspect, ("direction", "within", "edge"))
    column.prop(layer, "image")
    column.separator()
    column.prop(layer, "noise_size")
    column.prop(layer, "ragged")
    column.prop(layer, "seed")
