# SPDX-License-Identifier: GPL-3.0-or-later
"""Entries of a terrain's stack: new ones, and copies."""

import bpy

from ...cbt_terrain.height_operators.catalogue import operator_of

PRESETS = "adaptive_terrain/land"  # the folder of stacks among Blender's presets


def add_entry(land, effect: str):
    """Add an entry at the end of a stack, with a unique name and a seed that no other entry has.

    land: the LandSettings. effect: name of a height operator, which is also the entry's name if this version lacks it.
    """
    label = getattr(operator_of(effect), "label", effect)  # operator_of: None for an unknown one
    used, seeds = {entry.name for entry in land.entries}, {entry.seed for entry in land.entries}
    entry = land.entries.add()
    entry.effect, entry.name = effect, free_name(label, used)
    entry.seed = next(seed for seed in range(len(land.entries)) if seed not in seeds)
    return entry


def free_name(name: str, used: set[str]) -> str:
    """Return `name`, or the first free name with a number from .001 to .999 after it, as Blender numbers."""
    if name not in used:
        return name
    base = name[:-4] if name[-4:-3] == "." and name[-3:].isdigit() else name  # without an earlier number
    return next(other for number in range(1, 1000) if (other := f"{base}.{number:03}") not in used)


def copy_group(source, target) -> None:
    """Copy the properties that are set in a property group, also in nested groups, to a group of the same class.

    Properties of `target` that are not set in `source` stay as they are, so it should be new.
    """
    # A class that defines `name`, as all property groups have, lists it twice.
    for name in dict.fromkeys(source.bl_rna.properties.keys()):
        if name == "rna_type":
            continue
        value = getattr(source, name)
        if isinstance(value, bpy.types.PropertyGroup):
            copy_group(value, getattr(target, name))
        elif source.is_property_set(name) and not source.bl_rna.properties[name].is_readonly:
            setattr(target, name, value)
