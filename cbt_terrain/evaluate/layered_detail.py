# SPDX-License-Identifier: GPL-3.0-or-later
"""Splat layers with detail of their own: each layer's lies where the layer does, and as much.

How much that is is taken once, at every sample of the raster at its own scale: heights do not depend on the camera.
"""

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from ..effects.effect import Asked
from ..effects.splat import NAMES
from ..effects.splat_rules import Layer
from ..errors import TerrainError
from ..field.coats import ALL, Coat, Coats, Ground, Mask
from ..field.detail import Detail
from ..field.heightfield import HeightField, with_detail
from ..field.tiled import Tiled
from ..run.locks import caching
from .evaluate import on_samples

MOST_SAMPLES = 1 << 26
# Rasters' masks that a field keeps: of several terrains, or vertical scales.
MOST_KEPT = 4
KIND = "masks of detail"


@dataclass(frozen=True)
class LayeredDetail:
    """`everywhere`: what lies all over the terrain, or None. `details`: of those of the splat `layers` that have one:
    the layer's number and its detail."""

    everywhere: Detail | Tiled | None
    layers: tuple[Layer, ...]
    details: tuple[tuple[int, Detail | Tiled], ...]


def laid(
    field: HeightField,
    ground: Ground | LayeredDetail | None,
    vertical_scale: float,
    vertical_offset: float,
    threads: int,
) -> HeightField:
    """The surface with a detail on it. The rules of layers are about heights that are scaled and moved so.

    Raises TerrainError where the raster is too large for masks.
    """
    if not isinstance(ground, LayeredDetail):
        return with_detail(field, ground)
    plain = with_detail(field, None)
    lattice = plain.lattice
    if lattice.width * lattice.height > MOST_SAMPLES:
        raise TerrainError(
            f"The height map has {lattice.width:,} x {lattice.height:,} samples; expected {MOST_SAMPLES:,} at most for "
            "detail of splat layers: give the detail to the whole terrain, or import a coarser height map."
        )
    numbers = tuple(number for number, _ in ground.details)
    masks = _masks(plain, ground.layers, numbers, (float(vertical_scale), float(vertical_offset)), threads)
    coats = [Coat(detail, mask) for (_, detail), mask in zip(ground.details, masks, strict=True)]
    return with_detail(field, Coats((*([Coat(ground.everywhere)] if ground.everywhere else []), *coats)))


def _masks(
    field: HeightField, layers: tuple[Layer, ...], numbers: tuple[int, ...], heights: tuple[float, float], threads: int
) -> list[Mask]:
    """Of these layers; kept with the field."""
    key = layers, numbers, heights
    with caching:
        kept = field.found.setdefault((KIND,), OrderedDict())
        if key not in kept:
            kept[key] = _made(field, layers, numbers, heights, threads)
            while len(kept) > MOST_KEPT:
                kept.popitem(last=False)
        kept.move_to_end(key)
        return kept[key]


def _made(field, layers, numbers, heights, threads) -> list[Mask]:
    lattice = field.lattice
    asked = [Asked(name, (KIND,), parameters=(("layers", layers),)) for name in NAMES[: max(numbers) // 4 + 1]]
    masks = np.empty((len(numbers), lattice.height, lattice.width), np.uint8)
    for rows, values in on_samples(field, asked, *heights, threads):
        for mask, number in zip(masks, numbers, strict=True):
            weights = values[NAMES[number // 4]][..., number % 4]
            mask[rows] = np.rint(weights * np.float32(ALL))
    return [Mask(mask) for mask in masks]
