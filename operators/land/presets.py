# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets of stacks of land effects: the JSON files that the command `shape` takes, too."""

import os
from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.height_operators.fitted import fitted
from ...cbt_terrain.height_operators.stack import read_stack, write_stack
from ...cbt_terrain.run.owned_files import remove_file
from ..importing.imported import imported_of
from ..session.polls import TerrainOperator, cancelled_by_errors
from ..text.numbers import plain
from . import stack as land_stack
from .entries import PRESETS
from .properties import BY_OBJECT

PRESET_PANEL = "ADAPTIVE_TERRAIN_PT_land_presets"
SUFFIX = ".json"
FOLDER = Path(__file__).resolve().parents[1] / "presets" / PRESETS
# The shipped presets in the order of the menu: heading of a group -> name of a file -> label and tooltip.
SHIPPED = {
    "Keep the Land": {
        "light_weathering": ("Light Weathering", "Scree below cliffs, small gullies and fine relief. Mountains and "
                             "valleys stay where they are"),
        "water_and_snow": ("Water and Snow", "Streams and lakes, and snow near the summits. The ground changes only by "
                           "the depth of its snow"),
    },
    "Wear the Land Down": {
        "desert": ("Desert", "250,000 years of flash floods, with ledges and scree. It lowers ridges and cuts gorges"),
        "volcanic_island": ("Volcanic Island", "400,000 years of rivers, with scree and gullies. It cuts deep valleys"),
        "old_hills": ("Old Hills", "2.5 million years of rivers. Most of a mountain's height is gone after them"),
    },
    "Build Different Mountains": {
        "alpine": ("Alpine", "Uplift and rivers build different mountains from a young or small land, with snow and "
                   "lakes. Do not use it to keep the summits of an elevation model"),
        "great_range": ("Great Range", "Uplift and rivers build different mountains from a wide land, with snow and "
                        "lakes. Do not use it to keep the summits of an elevation model"),
    },
}  # fmt: skip


def user_files() -> list[Path]:
    """Return the files of the presets that users have saved or installed, by name."""
    folders = (Path(folder) for folder in bpy.utils.preset_paths(PRESETS))
    files = (file for folder in folders if folder.resolve() != FOLDER for file in folder.glob(f"*{SUFFIX}"))
    return sorted(files, key=lambda file: file.name.lower())


class ApplyLandPreset(TerrainOperator, bpy.types.Operator):
    """Replace the list by the effects of a preset"""

    bl_idname = "adaptive_terrain.land_preset"
    bl_label = "Land Preset"
    bl_options = {"REGISTER", "UNDO"}

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})

    @classmethod
    def description(cls, _context, properties):
        """Return the tooltip of a shipped preset, and for others that of the operator."""
        file = Path(properties.filepath)
        tooltips = {FOLDER / f"{name}{SUFFIX}": text for group in SHIPPED.values() for name, (_, text) in group.items()}
        return tooltips.get(file, "")

    @cancelled_by_errors
    def execute(self, context):
        """Replace the entries of the active terrain by those of the preset, fitted to its range of heights."""
        stack = read_stack(self.filepath)
        imported = imported_of(context.object.adaptive_terrain)
        if stack.heights is not None and imported is not None:
            designed_for, stack = stack.heights, fitted(stack, *imported.heights_m)
            if stack.heights != designed_for:
                low, high, new_low, new_high = (plain(v, 3) for v in (*designed_for, *stack.heights))
                note = f"Made for land from {low} to {high} m: heights and uplift fitted to {new_low} to {new_high} m"
                self.report({"INFO"}, note)
        for left_out in land_stack.fill(context.object.adaptive_terrain.land, stack):
            self.report({"WARNING"}, left_out)
        context.object.update_tag()
        return {"FINISHED"}


class AddLandPreset(TerrainOperator, AddPresetBase, bpy.types.Operator):
    """Save the list as a preset, or delete one"""

    bl_idname = "adaptive_terrain.land_preset_add"
    bl_label = "Add Land Preset"
    preset_menu = PRESET_PANEL
    preset_subdir = PRESETS

    @cancelled_by_errors
    def execute(self, context):
        """Save the list as a preset, or delete one if `remove_name` is set.

        It replaces `AddPresetBase.execute`, which would write Python instead of JSON.
        """
        name = self.as_filename(self.name)
        if not name:
            return {"FINISHED"}
        found = bpy.utils.preset_find(name, PRESETS, ext=SUFFIX)
        if self.remove_name:
            return self._remove(found)
        if found:
            raise TerrainError(f"There is a preset {self.name!r} already", fix="choose another name")
        folder = bpy.utils.user_resource("SCRIPTS", path=os.path.join("presets", PRESETS), create=True)
        land = context.object.adaptive_terrain.land
        write_stack(land_stack.preset_of(land), Path(folder, name + SUFFIX))
        for entry in land.entries:
            if entry.mask.kind == BY_OBJECT:
                note = f"{entry.name} is masked by an object, which a preset cannot hold: there it acts everywhere"
                self.report({"WARNING"}, note)
        return {"FINISHED"}

    def _remove(self, found: str | None):
        """Remove a preset's file. Raises TerrainError unless it is one of the user's own. found: path, None without."""
        user = bpy.utils.user_resource("SCRIPTS", path="presets")
        if not found or not Path(found).is_relative_to(user):
            raise TerrainError(f"The preset {self.name!r} cannot be removed", expected="one of your own presets")
        remove_file(found, may_be_link=True)
        return {"FINISHED"}
