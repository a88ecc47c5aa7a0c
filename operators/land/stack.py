# SPDX-License-Identifier: GPL-3.0-or-later
"""A terrain's stack of land effects: its settings as the engine's data, and the engine's data as settings."""

import math
import os
from pathlib import Path

import bpy

from ...cbt_terrain.errors import TerrainError
from ...cbt_terrain.height_operators.catalogue import HEIGHT_OPERATORS, operator_of
from ...cbt_terrain.height_operators.mask import ASPECT, LIMITS, SLOPE, GroundRule, HeightMask
from ...cbt_terrain.height_operators.stack import Entry, Stack
from ...cbt_terrain.run.named_file import blocks_reader
from ..bridge.scene_paths import absolute_path, no_heights
from ..importing.imported import imported_of
from ..layers.properties import set_band
from . import masks as land_masks
from .entries import add_entry
from .properties import BY_IMAGE, BY_OBJECT, BY_RULE, EVERYWHERE, RULES, number_of, set_number


def unknown_operator(effect: str) -> TerrainError:
    """Return the error for an entry whose height operator this version does not have."""
    return TerrainError(
        f"The effect {effect!r} is not one of this version's",
        expected=f"one of {', '.join(HEIGHT_OPERATORS)}",
        fix="remove it, switch it off, or open the file with the version that made it",
    )


def stack_of(terrain, depsgraph, masks: Path) -> Stack:
    """Return the engine's stack of the entries that are on, from the evaluated object `terrain`.

    masks: folder for the files of masks by images and objects, which are written. Raises TerrainError for an invalid
    entry that is on.
    """
    entries = [entry for entry in terrain.adaptive_terrain.land.entries if entry.on]
    stack = Stack(tuple(_to_engine(entry, terrain, depsgraph, masks) for entry in entries))
    stack.check(f"The stack of {terrain.name!r}")
    return stack


def _to_engine(entry, terrain, depsgraph, masks: Path) -> Entry:
    """Return the engine's Entry for an entry of the settings. masks: folder for the files of masks."""
    if operator_of(entry.effect) is None:
        raise unknown_operator(entry.effect)
    mask = _mask_of(entry, terrain, depsgraph, masks)
    return Entry(entry.effect, _changed_parameters(entry), entry.seed, on=True, mask=mask, name=entry.name)


def _changed_parameters(entry) -> dict[str, float]:
    """Return the parameters of an entry that differ from their defaults, in declared units."""
    declared = operator_of(entry.effect).parameters
    numbers = [(parameter, number_of(parameter, getattr(entry, entry.effect))) for parameter in declared]
    return {parameter.name: number for parameter, number in numbers if number != parameter.default}


def _mask_of(entry, terrain, depsgraph, masks: Path) -> HeightMask | None:
    """Return the mask of an entry for the engine, None if it acts everywhere. Raises TerrainError.

    Images and shadows of objects are written into the folder `masks`.
    """
    mask = entry.mask
    if mask.kind == EVERYWHERE:
        return None
    chosen = {BY_IMAGE: mask.image, BY_OBJECT: mask.object}
    if mask.kind in chosen and chosen[mask.kind] is None:
        what = "image" if mask.kind == BY_IMAGE else "object"
        raise TerrainError(
            f"The effect {entry.name!r} of {terrain.name!r} is masked by an {what}, and none is chosen",
            fix="choose one, or let the effect act everywhere",
        )
    if mask.kind == BY_OBJECT and mask.object.original == terrain.original:
        raise TerrainError(
            f"The effect {entry.name!r} of {terrain.name!r} is masked by the terrain itself, which it changes",
            fix="choose another object",
        )
    file = ""
    if mask.kind == BY_IMAGE:
        file = land_masks.write_image_mask(mask.image, masks)
    elif mask.kind == BY_OBJECT:
        file = land_masks.write_shadow_mask(mask.object, terrain, _extent_of(terrain), depsgraph, masks)
    rules = _rules_of(mask) if mask.kind == BY_RULE else ()
    return HeightMask(image=file, rules=rules, factor=mask.factor)


def _extent_of(terrain) -> tuple[float, float]:
    """Return a terrain's size in metres from west to east and from south to north.

    Raises TerrainError without a store.
    """
    found = imported_of(terrain.adaptive_terrain)
    if found is None:
        raise no_heights(terrain)
    return found.extent_m


def _rules_of(mask) -> tuple[GroundRule, ...]:
    """Return the rules of a mask that are switched on; slopes become degrees, limits at the end of their range open.

    The rule of aspect has the cosine of the largest angle from its direction as its low limit, and its direction in
    degrees clockwise from north. () without rules.
    """
    rules = []
    for quantity in RULES:
        band = getattr(mask, quantity)
        if band.use:
            limits, convert = band.bl_rna.properties["low"], _slope_degrees if quantity == SLOPE else float
            low = -math.inf if band.low <= limits.hard_min else convert(band.low)
            high = math.inf if band.high >= limits.hard_max else convert(band.high)
            rules.append(GroundRule(quantity, low, high, convert(band.edge)))
    if mask.aspect.use:
        aspect = mask.aspect
        direction = math.degrees(aspect.direction)
        rules.append(GroundRule(ASPECT, math.cos(aspect.within), edge=aspect.edge, direction=direction))
    return tuple(rules)


def _slope_degrees(radians: float) -> float:
    """Return degrees, at most 90: Blender's right angle, a float32, is larger."""
    return min(math.degrees(radians), LIMITS[SLOPE])


def preset_of(land) -> Stack:
    """Return the whole stack of a terrain's settings (LandSettings) for a file.

    It includes entries that are off. An entry whose mask is an object, or an image that is not chosen, acts everywhere
    in it. Raises TerrainError for an invalid entry, and for an image without a file.
    """
    entries = []
    for entry in land.entries:
        if operator_of(entry.effect) is None:
            raise unknown_operator(entry.effect)
        mask, kind = None, entry.mask.kind
        if kind == BY_IMAGE and entry.mask.image is not None:
            image = absolute_path(entry.mask.image.filepath)
            if not os.path.isfile(image):
                raise TerrainError(
                    f"The image {entry.mask.image.name!r}, which masks {entry.name!r}, has no file, and a preset names "
                    "files",
                    fix="save it with Image > Save As",
                )
            mask = HeightMask(image=image, factor=entry.mask.factor)
        elif kind == BY_RULE:
            mask = HeightMask(rules=_rules_of(entry.mask), factor=entry.mask.factor)
        numbers = _changed_parameters(entry)
        entries.append(Entry(entry.effect, numbers, entry.seed, on=entry.on, mask=mask, name=entry.name))
    stack = Stack(tuple(entries))
    stack.check()
    return stack


def fill(land, stack: Stack) -> list[str]:
    """Replace the entries of `land` (LandSettings) by those of `stack`, such as a preset's.

    Returns a sentence for each part that the settings cannot hold.
    """
    land.entries.clear()
    left_out = []
    for number, source in enumerate(stack.entries, 1):
        entry = add_entry(land, source.effect)
        entry.on, entry.seed = source.on, source.seed
        if source.name:
            entry.name = source.name
        for parameter in source.declaration.parameters:
            if parameter.name in source.parameters:
                set_number(parameter, getattr(entry, source.effect), source.parameters[parameter.name])
        if source.mask is not None:
            left_out += [f"Entry {number}, {entry.name}: {what}" for what in _fill_mask(entry.mask, source.mask)]
    land.active = 0
    return left_out


def _fill_mask(mask, source: HeightMask) -> list[str]:
    """Set the mask of a new entry from the engine's `source`; return a clause for each part that was left out."""
    left_out = []
    mask.kind, mask.factor = BY_RULE, source.factor
    if source.image:
        mask.kind = BY_IMAGE
        try:
            if blocks_reader(source.image):
                raise RuntimeError("it is a pipe, a socket or a device")
            mask.image = bpy.data.images.load(source.image, check_existing=True)
        except RuntimeError:
            left_out.append(f"the image {source.image} of its mask cannot be read; choose another")
        if source.rules:
            left_out.append("its mask has an image and rules; the rules are left out")
        return left_out
    for number, rule in enumerate(source.rules):
        if any(rule.of == other.of for other in source.rules[:number]):
            left_out.append(f"its mask has two rules about {rule.of}; the first counts")
        elif rule.of == ASPECT:
            aspect = mask.aspect
            if rule.high < 1.0:
                left_out.append("its mask has a high limit of aspect, which is left out")
            aspect.use, aspect.direction = True, math.radians(rule.direction % 360.0)
            aspect.within, aspect.edge = math.acos(min(max(rule.low, -1.0), 1.0)), rule.edge  # low: a cosine
        else:
            convert = math.radians if rule.of == SLOPE else float
            set_band(getattr(mask, rule.of), convert(rule.low), convert(rule.high), convert(rule.edge))
    return left_out
