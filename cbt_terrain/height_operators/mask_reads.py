# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that mask rules read: scalars of attributes/ that depend on heights alone, and layers.

Those of SHAPES are computed from an operator's input ground at the spacing of the level. BY_PRODUCTS are layers, which
come from earlier operators of the stack or from the source.
"""

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from ..attributes.attribute import AttributeDeclaration, AttributeRequest
from ..attributes.catalogue import ATTRIBUTES
from ..attributes.layers import NAMES as BY_PRODUCTS
from ..field.heightfield import HeightField, HeightRaster
from ..field.lattice import fit
from .tile_cache import compute_digest
from .tiles import Level, Window

# Attributes of the ground's shape; a rule about one of them needs the heights of the whole level.
SHAPES = ("mean_curvature", "profile_curvature", "plan_curvature", "flow", "wetness", "sky")
MASK_ATTRIBUTES: dict[str, AttributeDeclaration] = {name: ATTRIBUTES[name] for name in (*SHAPES, *BY_PRODUCTS)}


def values_of(
    names: Iterable[str],
    level: Level,
    heights: Callable[[Window], np.ndarray],
    missing: np.ndarray | None,
    layers: Mapping[str, np.ndarray],
    threads: int,
) -> dict[str, np.ndarray]:
    """Return the values that a mask's rules read, for those `names` that are in MASK_ATTRIBUTES.

    They are float32 [rows, columns] by name. Those of SHAPES are for the whole level; by-products are taken from
    `layers` as they are. heights(window): returns float32 metres of the ground. missing: bool [rows, columns] of the
    level, holes, or None.
    """
    from ..attributes.evaluate import on_samples

    results = {name: layers[name] for name in names if name in BY_PRODUCTS}
    requests = [AttributeRequest(name, readers=()) for name in names if name in SHAPES]
    if requests:
        field = _field(level, np.ascontiguousarray(heights(level.whole)), missing)
        results |= {request.name: np.empty(level.shape, np.float32) for request in requests}
        for rows, values in on_samples(field, requests, threads=threads):
            for request in requests:
                results[request.name][rows] = values[request.name]
    return results


def _field(level: Level, heights: np.ndarray, missing: np.ndarray | None) -> HeightField:
    """Return a level as a height field without errors and ranges, which no attribute reads.

    missing: bool, holes; None for none.
    """
    none = np.empty(0, np.uint8)
    return HeightField(
        HeightRaster(
            heights,
            fit(level.columns, level.rows, level.step_x, level.step_y),
            compute_digest(heights, level.step_x, level.step_y, missing),
            valid=None if missing is None else (~missing).view(np.uint8),
        ),
        error=none,
        exponents=[],
        ranges=none,
        range_base=0.0,
        range_step=0.0,
        min_height=float(heights.min()),
        max_height=float(heights.max()),
        steepest_x=0.0,
        steepest_y=0.0,
    )
