# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement of splat layers: each layer's displacement is weighted by the layer.

Weights are computed once at every sample at the raster's scale, so that heights do not depend on the camera.
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import TerrainError
from ..field.detail import Detail
from ..field.displacement_layers import ALL, DisplacementLayer, DisplacementLayers, Ground, LayerMask
from ..field.heightfield import HeightField, with_detail
from ..field.tiled import Tiled
from ..run.locks import caching
from .attribute import AttributeRequest
from .evaluate import on_samples
from .splat import NAMES
from .splat_rules import Layer

MAX_SAMPLES = 1 << 26
# Number of cached sets of masks of a field, for several terrains or vertical scales.
MAX_CACHED = 4
KIND = "masks of detail"


@dataclass(frozen=True)
class LayeredDetail:
    """Displacement of the whole terrain, or None, and of some of the splat `layers`: pairs of index and detail."""

    everywhere: Detail | Tiled | None
    layers: tuple[Layer, ...]
    details: tuple[tuple[int, Detail | Tiled], ...]


def displaced(
    field: HeightField,
    ground: Ground | LayeredDetail | None,
    vertical_scale: float,
    vertical_offset: float,
    threads: int,
) -> HeightField:
    """Return the field with a displacement below its samples, which the surface then includes.

    ground: Detail, layers of it, or LayeredDetail whose layers are weighted by splat layers, computed here with
    this vertical scale and offset; None for no displacement. Raises TerrainError if the raster is too large for
    masks.
    """
    if not isinstance(ground, LayeredDetail):
        return with_detail(field, ground)
    plain = with_detail(field, None)
    lattice = plain.lattice
    if lattice.width * lattice.height > MAX_SAMPLES:
        raise TerrainError(
            f"The height map has {lattice.width:,} x {lattice.height:,} samples",
            expected=f"at most {MAX_SAMPLES:,} for detail of splat layers",
            fix="give the detail to the whole terrain, or import a coarser height map",
        )
    numbers = tuple(number for number, _ in ground.details)
    masks = _masks(plain, ground.layers, numbers, (float(vertical_scale), float(vertical_offset)), threads)
    everywhere = [DisplacementLayer(ground.everywhere)] if ground.everywhere else []
    displacement = [DisplacementLayer(detail, mask) for (_, detail), mask in zip(ground.details, masks, strict=True)]
    return with_detail(field, DisplacementLayers((*everywhere, *displacement)))


def _masks(
    field: HeightField, layers: tuple[Layer, ...], numbers: tuple[int, ...], heights: tuple[float, float], threads: int
) -> list[LayerMask]:
    """Return the masks, a byte for each sample, of some splat layers, cached with the field.

    numbers: indices of the layers. heights: vertical scale and offset.
    """
    key = layers, numbers, heights
    with caching:
        cache = field.cache.results.setdefault((KIND,), OrderedDict())
        if key not in cache:
            cache[key] = _compute_masks(field, layers, numbers, heights, threads)
            while len(cache) > MAX_CACHED:
                cache.popitem(last=False)
        cache.move_to_end(key)
        return cache[key]


def _compute_masks(
    field: HeightField,
    layers: tuple[Layer, ...],
    numbers: Sequence[int],
    heights: tuple[float, float],
    threads: int,
) -> list[LayerMask]:
    """Return the masks of the splat layers `numbers` at all samples, 8 bits each.

    An attribute of the splat map holds the weights of four layers.
    """
    lattice = field.lattice
    requests = [
        AttributeRequest(name, (KIND,), parameters=(("layers", layers),)) for name in NAMES[: max(numbers) // 4 + 1]
    ]
    masks = np.empty((len(numbers), lattice.height, lattice.width), np.uint8)
    for rows, values in on_samples(field, requests, heights[0], heights[1], threads):
        for mask, number in zip(masks, numbers, strict=True):
            weights = values[NAMES[number // 4]][..., number % 4]
            mask[rows] = np.rint(weights * np.float32(ALL))
    return [LayerMask(mask) for mask in masks]
