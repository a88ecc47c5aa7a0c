# SPDX-License-Identifier: GPL-3.0-or-later
"""Entries of a terrain's stack: new ones, and copies."""

import bpy

from ...cbt_terrain.land_effects.catalogue import LAND_EFFECTS

PRESETS = "adaptive_terrain/land"  # the folder of stacks among Blender's presets


def add_entry(land, effect: str):
    """A new entry at the end of a stack, with a name that no other has and chance of its own."""
    label = LAND_EFFECTS[effect].label if effect in LAND_EFFECTS else effect
    taken, seeds = {entry.name for entry in land.entries}, {entry.seed for entry in land.entries}
    entry = land.entries.add()
    entry.effect, entry.name = effect, free_name(label, taken)
    entry.seed = next(seed for seed in range(len(land.entries)) if seed not in seeds)
    return entry


def free_name(wanted: str, taken: set[str]) -> str:
    """`wanted`, or with a number as Blender's own the first that nobody has."""
    if wanted not in taken:
        return wanted
    base = wanted[:-4] if wanted[-4:-3] == "." and wanted[-3:].isdigit() else wanted
    return next(name for number in range(1, 1000) if (name := f"{base}.{number:03}") not in taken)


def copy_group(source, target) -> None:
    """All that is set in a group of properties, and in those inside it, to another of its kind."""
    for name in dict.fromkeys(source.bl_rna.properties.keys()):
        if name == "rna_type":
            continue
        value = getattr(source, name)
        if isinstance(value, bpy.types.PropertyGroup):
            copy_group(value, getattr(target, name))
        elif source.is_property_set(name) and not source.bl_rna.properties[name].is_readonly:
            setattr(target, name, value)
