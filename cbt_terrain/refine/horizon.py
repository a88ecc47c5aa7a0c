# SPDX-License-Identifier: GPL-3.0-or-later
"""The polar horizon maps of all views; kernels/refine/hiding.py describes and proves the method.

A map has a row of ROW directions for each *ring*, a square around the eye. An entry is the slope (height above the eye
over distance) below which ground within the ring hides everything behind it.
"""

import math
from collections.abc import Sequence

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.refine.hiding import RING_BITS, ROW
from ...kernels.refine.horizon_map import FINEST, OUTWARD, HorizonBlocks, fill_blocks, fill_horizon
from ...kernels.refine.local_view import LocalView
from ...kernels.refine.pixels import CriterionArrays
from ..field.blocks import concatenate_levels, halvings
from ..field.extremes import extremes
from ..field.heightfield import HeightField
from ..run import launch
from ..run.buffers import Buffers, flat
from ..run.locks import cached
from ..view.criterion import LARGEST
from ..view.view import KINDS, ORTHOGRAPHIC

BIN_COST, BLOCK_COST = 2000.0, 20.0  # of a bin's rings, and of a block's extremes, in lookups
# With geomorphing, ground gets coarser gradually, until rays to it are this slope (height over distance) below the
# horizon.
RAMP = 0.15


def place_rings(domain: Domain, views: list[LocalView], factor: float, ramp: float = 0.0) -> int:
    """Give each view its horizon rings and its factors for hidden ground; return the number of entries of all maps.

    factor: how many times coarser hidden ground may be. ramp: slope below the horizon at which the factor is reached;
    0: the factor is a step. Orthographic views have no eye and no map: no ground is hidden from them.
    """
    entries, factor = 0, min(factor, LARGEST)
    for view in views:
        # Kernels use the squared factor of wholly hidden ground. With less hidden the factor is
        # (1 + occlusion_fade * hidden fraction)^4, which is `factor` at the fraction 1.
        view.hidden2, view.occlusion_fade, view.ramp = factor * factor, math.sqrt(math.sqrt(factor)) - 1, ramp
        first, count = _rings_of(domain, view)
        if KINDS[view.kind] != ORTHOGRAPHIC and count > 0:
            # first: the nearest ring. at: the view's first entry in the maps of all views.
            view.rings.first, view.rings.count, view.rings.at = first, count, entries
            # by direction: the floor, below which a ray may pass below the mesh, then a slope for each ring
            entries += (count + 1) * int(ROW)
    return entries


def has_rings(criterion: CriterionArrays) -> bool:
    """Return whether any view has a horizon map."""
    return bool(
        criterion.view.rings.count or (criterion.view_count > 1 and criterion.views.numpy()["rings"]["count"].any())
    )


def fill_horizons(
    field: HeightField,
    domain: Domain,
    criterion: CriterionArrays,
    max_depth: int,
    relaxed: float,
    buffers: Buffers,
    threads: int,
) -> None:
    """Fill the horizon maps of all views, `criterion.slopes`, for meshes that satisfy the criterion times `relaxed`.

    max_depth: largest depth of leaves. buffers: hold the maps. With an infinite factor the maps hide nothing.
    """
    views = [(k, view) for k, view in enumerate(criterion.views.numpy()) if view["rings"]["count"]]
    entries = sum(int(view["rings"]["count"] + 1) for _, view in views) * int(ROW)
    criterion.slopes = buffers.get("horizons", entries, wp.float32)
    if relaxed == math.inf:
        buffers.numpy("horizons")[:entries] = -math.inf
        return
    blocks = _blocks_of(field, domain, threads)
    # The longest leg of the deepest leaves, which may be too coarse: they are between the ground's heights this near.
    margin_units = 1 << (domain.unit_bits - ((max_depth - 1) >> 1))
    for k, view in views:
        clip_start = _max_clip_distance(domain, view["near2"], view["cosine2"], view["weight"])
        inputs = [domain, blocks, criterion, k, clip_start, margin_units, relaxed]
        launch.spread(fill_horizon, int(ROW), inputs, step="horizon", threads=threads, cost=BIN_COST)


def horizon_of(
    field: HeightField, domain: Domain, criterion: CriterionArrays, max_depth: int, factor: float, threads: int
) -> CriterionArrays:
    """Return the criterion's views with filled horizon maps, for a mesh that satisfies it times `factor`.

    max_depth: bisections of the mesh's deepest leaf. The maps can test whether light or a view reaches a point.
    """
    views = criterion.views.numpy().copy().view(np.recarray)
    entries = place_rings(domain, views, factor=LARGEST)  # any: users read the maps only
    result = CriterionArrays()
    result.view_count, result.error_px2, result.metres2 = len(views), criterion.error_px2, criterion.metres2
    result.views = wp.array(views, dtype=LocalView, device=launch.DEVICE)
    if entries:
        fill_horizons(field, domain, result, max_depth, factor, Buffers(), threads)
    return result


def _blocks_of(field: HeightField, domain: Domain, threads: int) -> HorizonBlocks:
    """Return bounds of the field's surface over square blocks of cells, in levels: a block has 2^level cells a side.

    They are computed once; those of a large raster are kept in its store.
    """
    blocks = HorizonBlocks()
    if field.interpolation == "bilinear":
        low, level_firsts, row_blocks = extremes(field, np.minimum)
        # `outward`: fraction of itself by which a stored extreme may be inside the surface's range
        high, blocks.outward = extremes(field, np.maximum)[0], OUTWARD
    else:
        values = cached(field.cache.results, ("blocks",), lambda: _patch_blocks(domain, threads))
        low, high, level_firsts, row_blocks = values
    blocks.low, blocks.high = flat(low, wp.float32), flat(high, wp.float32)
    blocks.first, blocks.wide = flat(level_firsts, wp.int64), flat(row_blocks, wp.int32)
    return blocks


def _patch_blocks(domain: Domain, threads: int) -> tuple[np.ndarray, ...]:
    """Compute the extremes of a bicubic surface in blocks of cells, rounded outwards: the arrays of HorizonBlocks.

    The levels below FINEST are empty.
    """
    columns, rows = (((n - 2) >> FINEST) + 1 for n in (domain.samples.columns, domain.samples.rows))
    finest = np.empty((rows, columns, 2), np.float32)
    inputs = [domain, columns, flat(finest, wp.float32)]
    launch.spread(fill_blocks, rows, inputs, step="horizon", threads=threads, cost=BLOCK_COST * columns)
    levels, level_firsts, row_blocks = concatenate_levels(halvings(finest, np.minimum), int(FINEST))
    # the highest heights are stored negated, so that one minimum serves both
    low, negative_high = levels.reshape(-1, 2).T
    return low.copy(), -negative_high, level_firsts, row_blocks


def _rings_of(domain: Domain, view: LocalView) -> tuple[int, int]:
    """Return the number of a view's first horizon ring, and the number of its rings, 0 or less if there are none.

    Rings extend to the raster's far corner. They start at the largest of three distances from the eye: one raster cell,
    the raster's nearest point, and the clip start.
    """
    cell_counts = (domain.samples.columns - 1, domain.samples.rows - 1)
    cell_units = 1 << (domain.unit_bits - domain.levels)
    near, far = 0.0, 0.0
    eyes = [float(e) for e in view.eye]
    axes = zip(eyes, (domain.west, domain.south), (domain.unit_x, domain.unit_y), cell_counts, strict=False)
    for eye, low, unit_m, cells in axes:
        high = low + cells * cell_units * unit_m
        near, far = max(near, low - eye, eye - high), max(far, eye - low, high - eye)
    clip_start = _max_clip_distance(domain, view.near2, view.cosine2, view.weight)
    first = max(ring_of(max(near, cell_units * min(domain.unit_x, domain.unit_y))), ring_of(clip_start) + 1)
    return first, ring_of(far) + 1 - first


def _max_clip_distance(domain: Domain, near2: float, cosine2: float, weight: Sequence[float]) -> float:
    """Return a distance max(|x|, |y|) from the eye beyond which no point in the frame is before the clip start.

    It is metres in terrain space, at least a lattice unit. near2: square of half the clip start, which is measured
    along the view; dividing by the cosine gives the distance. cosine2: smallest square of the cosine between a ray and
    the view. weight: squared scales from metres along x, y and z to camera space.
    """
    nearest = 2.0 * math.sqrt(float(near2) / (float(cosine2) * min(float(weight[0]), float(weight[1]))))
    return max(nearest, domain.unit_x, domain.unit_y)


def ring_of(distance: float) -> int:
    """Return the number of the largest ring whose radius is at most a distance, as in kernels/refine/hiding.py.

    A ring's number is the upper bits of its radius as float64: exponent and first mantissa bits, so that each octave
    has as many rings.
    """
    return int(np.float64(distance).view(np.int64)) >> int(RING_BITS)
