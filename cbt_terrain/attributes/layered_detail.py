# SPDX-License-Identifier: GPL-3.0-or-later
"""Displacement of splat layers: each layer's displacement is weighted by the layer.

Weights are computed once at every sample at the raster's scale, so that heights do not depend on the camera.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..field.derived_arrays import derive_cached_if_large
from ..field.detail import Detail
from ..field.displacement_layers import (
    ALL,
    DisplacementLayer,
    DisplacementLayers,
    Ground,
    LayerMask,
    fill_max_cells,
    mask_levels,
)
from ..field.heightfield import HeightField, with_detail
from ..field.tiled import Tiled
from ..run.locks import caching
from .attribute import AttributeRequest
from .catalogue import ATTRIBUTES
from .splat import NAMES
from .splat_rules import Layer
from .whole import remove_old

# Number of cached sets of masks of a field, in memory and in its store, for several terrains or vertical scales.
MAX_CACHED = 4
KIND = "masks of detail"


@dataclass(frozen=True)
class LayeredDetail:
    """Displacement of the whole terrain, `everywhere`, and of some of the splat layers."""

    everywhere: Detail | Tiled | None
    layers: tuple[Layer, ...]  # all splat layers
    details: tuple[tuple[int, Detail | Tiled], ...]  # index of a layer, and its displacement


def displaced(
    field: HeightField,
    ground: Ground | LayeredDetail | None,
    vertical_scale: float,
    vertical_offset: float,
    threads: int,
) -> HeightField:
    """Return the field with a displacement, which the surface then includes.

    ground: Detail, layers of it, or LayeredDetail whose layers are weighted by splat layers, computed here with
    this vertical scale and offset; None for no displacement. Raises TerrainError for splat layers or attributes that
    cannot be evaluated.
    """
    if not isinstance(ground, LayeredDetail):
        return with_detail(field, ground)
    plain = with_detail(field, detail=None)  # masks do not depend on the displacement
    numbers = tuple(number for number, _ in ground.details)  # of the splat layers, each with its detail
    masks = _masks(plain, ground.layers, numbers, (float(vertical_scale), float(vertical_offset)), threads)
    # A layer without a mask.
    everywhere = [DisplacementLayer(ground.everywhere)] if ground.everywhere else []
    displacement = [DisplacementLayer(detail, mask) for (_, detail), mask in zip(ground.details, masks, strict=True)]
    return with_detail(field, DisplacementLayers((*everywhere, *displacement)))


def _masks(
    field: HeightField, layers: tuple[Layer, ...], numbers: tuple[int, ...], vertical: tuple[float, float], threads: int
) -> list[LayerMask]:
    """Return the masks, a byte for each sample, of some splat layers, cached with the field.

    numbers: indices of the layers. vertical: scale and offset of heights.
    """
    key = layers, numbers, vertical
    with caching:
        cache = field.cache.results.setdefault((KIND,), OrderedDict())
        if key not in cache:
            cache[key] = _compute_masks(field, layers, numbers, vertical, threads)
            while len(cache) > MAX_CACHED:
                cache.popitem(last=False)
        cache.move_to_end(key)
        return cache[key]


def _compute_masks(
    field: HeightField,
    layers: tuple[Layer, ...],
    numbers: Sequence[int],
    vertical: tuple[float, float],
    threads: int,
) -> list[LayerMask]:
    """Return the masks of the splat layers `numbers`, at least one, at all samples: uint8, ALL for a weight of 1.

    Those of a large raster are cached in its store, MAX_CACHED sets of them. An attribute of the splat map holds the
    weights of four layers. vertical: scale and offset of heights.
    """
    from .evaluate import on_samples

    lattice, names = field.lattice, NAMES[: max(numbers) // 4 + 1]
    versions = tuple((name, attribute.version) for name, attribute in ATTRIBUTES.items())  # rules may read any of them
    digest = hashlib.blake2b(repr((versions, layers, numbers, vertical)).encode(), digest_size=8).hexdigest()
    mask_array, maxima_array = f"masks_{digest}", f"mask_maxima_{digest}"  # their names

    def fill(arrays: dict[str, np.ndarray]) -> None:
        """Compute the masks row by row, and their maxima over cells, 2 x 2 cells and so on (`LayerMask.max_cells`).

        arrays: to be filled, by name.
        """
        # A request names who reads the attribute; here KIND, the displacement of layers.
        requests = [AttributeRequest(name, (KIND,), parameters=(("layers", layers),)) for name in names]
        for rows, values in on_samples(field, requests, *vertical, threads):
            for mask, number in zip(arrays[mask_array], numbers, strict=True):
                weights = values[NAMES[number // 4]][..., number % 4]
                mask[rows] = np.rint(weights * np.float32(ALL))
        for values, max_cells in zip(arrays[mask_array], arrays[maxima_array], strict=True):
            fill_max_cells(values, max_cells)

    shapes = {
        mask_array: ((len(numbers), lattice.height, lattice.width), np.uint8),
        # The last item of `mask_levels` is the number of entries of `max_cells` on all levels together.
        maxima_array: ((len(numbers), int(mask_levels(lattice)[-1])), np.uint8),
    }
    derived = derive_cached_if_large(field.raster, shapes, fill)
    # Of other layers and scales, keep only the newest in the store.
    for name in shapes:
        remove_old(field, f"{name.removesuffix(digest)}*.npy", name, MAX_CACHED)
    return list(map(LayerMask, derived[mask_array], derived[maxima_array]))
