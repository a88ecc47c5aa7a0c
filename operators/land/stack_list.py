# SPDX-License-Identifier: GPL-3.0-or-later
"""The stack of land effects of a terrain: add, remove, move, duplicate."""

import bpy

from ...cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS
from ..session.polls import TerrainOperator
from .entries import add_entry, copy_group, free_name
from .properties import RULES

MAX_ENTRIES = 32
# Where a new rule begins whose range is open otherwise: ridges; streams; valley floors.
STARTS = {"mean_curvature": 0.0, "flow": 1e5, "wetness": 8.0}


def _effect_items(_self, _context):
    """Return the enum items of all height operators; Blender calls it when it draws the menu."""
    return _ITEMS


# Blender keeps no reference to the texts of items that a function gives.
_ITEMS = [(name, effect.label, effect.about) for name, effect in HEIGHT_OPERATORS.items()]


class _StackOperator(TerrainOperator):
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        """Change the stack of the active terrain, and tag the terrain for an update if `_change_stack` returns True."""
        land = context.object.adaptive_terrain.land
        done = self._change_stack(land)
        if done:
            context.object.update_tag()
        return {"FINISHED"} if done else {"CANCELLED"}


class _EntryOperator(_StackOperator):
    @classmethod
    def poll(cls, context):
        """Require a chosen entry, besides a terrain."""
        return super().poll(context) and 0 <= (land := context.object.adaptive_terrain.land).active < len(land.entries)


def _has_room(operator, land) -> bool:
    """Return whether the stack may get another entry; report an error if not."""
    if len(land.entries) < MAX_ENTRIES:
        return True
    operator.report({"ERROR"}, f"The stack has {MAX_ENTRIES} effects, which is the most: remove one first.")
    return False


class AddLandEffect(_StackOperator, bpy.types.Operator):
    """Add a land effect below the chosen one. It acts on the ground that the effects above it have made"""

    bl_idname = "adaptive_terrain.land_add"
    bl_label = "Add Land Effect"

    effect: bpy.props.EnumProperty(name="Effect", description="Kind of the land effect", items=_effect_items)

    def _change_stack(self, land) -> bool:
        """Add the chosen effect below the active entry; return whether the stack changed."""
        if not _has_room(self, land):
            return False
        add_entry(land, self.effect)
        _move_new_below_active(land)
        return True


class DuplicateLandEffect(_EntryOperator, bpy.types.Operator):
    """Add a copy of the chosen effect below it"""

    bl_idname = "adaptive_terrain.land_duplicate"
    bl_label = "Duplicate Land Effect"

    def _change_stack(self, land) -> bool:
        """Copy the active entry with all settings; return whether the stack changed."""
        if not _has_room(self, land):
            return False
        number = land.active
        name = free_name(land.entries[number].name, {entry.name for entry in land.entries})
        copy = add_entry(land, land.entries[number].effect)
        copy_group(land.entries[number], copy)
        copy.name = name
        _move_new_below_active(land)
        return True


class RemoveLandEffect(_EntryOperator, bpy.types.Operator):
    """Remove the chosen effect from the list"""

    bl_idname = "adaptive_terrain.land_remove"
    bl_label = "Remove Land Effect"

    def _change_stack(self, land) -> bool:
        """Remove the active entry and make the one that takes its place active, or the last one; return True."""
        land.entries.remove(land.active)
        land.active = max(0, min(land.active, len(land.entries) - 1))
        return True


class MoveLandEffect(_EntryOperator, bpy.types.Operator):
    """Move the chosen effect up or down. Each effect acts on the ground that those above it have made"""

    bl_idname = "adaptive_terrain.land_move"
    bl_label = "Move Land Effect"

    by: bpy.props.IntProperty(
        name="By", description="Rows to move; below 0 is up", default=1, min=-MAX_ENTRIES, max=MAX_ENTRIES
    )

    def _change_stack(self, land) -> bool:
        """Move the active entry by `by` rows, down if above 0; return False if that is beyond the list's ends."""
        to = land.active + self.by
        if not 0 <= to < len(land.entries):
            return False
        land.entries.move(land.active, to)
        land.active = to
        return True


class AddLandRule(_EntryOperator, bpy.types.Operator):
    """Add a condition to the mask, such as the curvature of the ground or the depth of snow"""

    bl_idname = "adaptive_terrain.land_rule_add"
    bl_label = "Add Rule"

    of: bpy.props.EnumProperty(
        name="Quantity", description="Property of the ground that the condition is about",
        items=[(of, *(group.__annotations__["use"].keywords[key] for key in ("name", "description")))
               for of, group in RULES.items()],
    )  # fmt: skip

    def _change_stack(self, land) -> bool:
        """Switch on a rule of the active entry's mask, with a low limit that suits its quantity if none was set."""
        rule = getattr(land.entries[land.active].mask, self.of)
        rule.use = True
        if self.of in STARTS and not rule.is_property_set("low"):
            rule.low = STARTS[self.of]
        return True


def _move_new_below_active(land) -> None:
    """Move the last entry, which was just added, below the active one, and make it the active one."""
    last = len(land.entries) - 1
    to = min(land.active + 1, last)
    land.entries.move(last, to)
    land.active = to
