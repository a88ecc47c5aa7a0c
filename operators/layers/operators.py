# SPDX-License-Identifier: GPL-3.0-or-later
"""Splat layers of a terrain: add, remove, move, and presets as files."""

from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase

from ...cbt_terrain.attributes.splat_rules import MAX_LAYERS
from ..session.polls import TerrainOperator

PRESETS = "adaptive_terrain/layers"
PRESET_PANEL = "ADAPTIVE_TERRAIN_PT_layer_presets"


class _LayerOperator(TerrainOperator):
    bl_options = {"REGISTER", "UNDO"}


class AddLayer(_LayerOperator, bpy.types.Operator):
    """Add a layer below the chosen one. Layers further down in the list cover those above"""

    bl_idname = "adaptive_terrain.layer_add"
    bl_label = "Add Layer"

    @classmethod
    def poll(cls, context):
        """Return whether the active object is a terrain with room for another layer."""
        return super().poll(context) and len(context.object.adaptive_terrain.layers) < MAX_LAYERS

    def execute(self, context):
        """Add a layer with a free name and another seed below the active one."""
        settings = context.object.adaptive_terrain
        layers, names = settings.layers, {layer.name for layer in settings.layers}
        layer = layers.add()
        # A terrain has 12 layers at most, so one of these names is free.
        layer.name = next(name for number in range(1, 14) if (name := f"Layer {number}") not in names)
        layer.seed = len(layers)
        position = min(settings.active_layer + 1, len(layers) - 1)
        layers.move(len(layers) - 1, position)
        settings.active_layer = position
        return {"FINISHED"}


class RemoveLayer(_LayerOperator, bpy.types.Operator):
    """Remove the chosen layer"""

    bl_idname = "adaptive_terrain.layer_remove"
    bl_label = "Remove Layer"

    @classmethod
    def poll(cls, context):
        """Return whether the active object is a terrain with a layer."""
        return super().poll(context) and len(context.object.adaptive_terrain.layers) > 0

    def execute(self, context):
        """Remove the active layer and make the one that takes its place active, or the last one."""
        settings = context.object.adaptive_terrain
        settings.layers.remove(settings.active_layer)
        settings.active_layer = max(0, min(settings.active_layer, len(settings.layers) - 1))
        context.object.update_tag()
        return {"FINISHED"}


class MoveLayer(_LayerOperator, bpy.types.Operator):
    """Move the chosen layer up or down. Layers further down in the list cover those above"""

    bl_idname = "adaptive_terrain.layer_move"
    bl_label = "Move Layer"

    by: bpy.props.IntProperty(
        name="By", description="Rows to move; below 0 is up", default=1, min=-MAX_LAYERS, max=MAX_LAYERS
    )

    def execute(self, context):
        """Move the active layer by `by` rows, down if above 0; cancel if that is beyond the list's ends."""
        settings = context.object.adaptive_terrain
        to = settings.active_layer + self.by
        if not 0 <= to < len(settings.layers):
            return {"CANCELLED"}
        settings.layers.move(settings.active_layer, to)
        settings.active_layer = to
        context.object.update_tag()
        return {"FINISHED"}


class AddPreset(TerrainOperator, AddPresetBase, bpy.types.Operator):
    """Save the layers as a preset, or delete one"""

    bl_idname = "adaptive_terrain.layer_preset_add"
    bl_label = "Add Layer Preset"
    preset_menu = PRESET_PANEL
    preset_subdir = PRESETS

    def add(self, context, filepath: str) -> None:
        """Write the preset file; Blender's AddPresetBase calls it."""
        Path(filepath).write_text(preset_text(context.object.adaptive_terrain.layers), encoding="utf-8")


def preset_text(layers) -> str:
    """Return a preset file: Python that recreates these layers on the active object.

    It has no painted images, which belong to their .blend file.
    """
    lines = ["import bpy", "", "settings = bpy.context.object.adaptive_terrain", "settings.layers.clear()"]
    for layer in layers:
        lines += ["", "layer = settings.layers.add()", *_assignments("layer", layer)]
    lines += ["", "settings.active_layer = 0", "bpy.context.object.update_tag()", ""]
    return "\n".join(lines)


def _assignments(path: str, group) -> list[str]:
    """Return Python assignments for the members of a property group that were set, also in nested groups.

    path: expression of the group, such as `layer.height`.
    """
    lines = []
    names = dict.fromkeys(group.bl_rna.properties.keys())  # one that replaces another is there twice
    for item in (group.bl_rna.properties[name] for name in names if name != "rna_type"):
        value = getattr(group, item.identifier)
        if item.type == "POINTER":
            if isinstance(value, bpy.types.PropertyGroup):
                lines += _assignments(f"{path}.{item.identifier}", value)
        elif group.is_property_set(item.identifier) and not (item.is_readonly or item.is_hidden):
            value = tuple(value) if getattr(item, "is_array", False) else value
            lines.append(f"{path}.{item.identifier} = {_literal(value)}")
    return lines


def _literal(value) -> str:
    """Return a value as Python text; numbers have float32's seven digits."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_literal, value))})"
    return f"{value:.7g}" if isinstance(value, float) else repr(value)
