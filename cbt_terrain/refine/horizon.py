# SPDX-License-Identifier: GPL-3.0-or-later
"""The polar maps of what nearer ground hides from each view; kernels/refine/hiding.py has the method and its proof."""

import math

import numpy as np
import warp as wp

from ...kernels.field.domain import Domain
from ...kernels.refine.hiding import RING_BITS, ROW
from ...kernels.refine.horizon_map import FINEST, HeightBlocks, fill_blocks, fill_horizon
from ...kernels.refine.pixels import CriterionArrays, LocalView
from ..field.blocks import halvings, stacked
from ..field.heightfield import HeightField
from ..run import launch
from ..run.buffers import Buffers, flat
from ..run.locks import cached
from ..view.criterion import LARGEST
from ..view.view import KINDS, ORTHOGRAPHIC

BIN_COST = 2000.0  # of a bin's rings, in lookups
# Where points rise, ground gets coarser as rays to it pass deeper below what hides it, up to this slope (height over
# distance), not at once.
RAMP = 0.15


def place_rings(domain: Domain, views: list[LocalView], factor: float, ramp: float = 0.0) -> int:
    """Give each view its rings, for ground that may be `factor` times coarser where it is hidden: by degrees up to a
    slope of `ramp` below what hides it, 0: at once. Returns how many entries all maps have. Orthographic views have no
    eye, and no map: nothing is hidden from them."""
    entries, factor = 0, min(factor, LARGEST)
    for view in views:
        view.hidden2, view.occlusion_fade, view.ramp = factor * factor, math.sqrt(math.sqrt(factor)) - 1, ramp
        first, count = _rings_of(domain, view)
        if KINDS[view.kind] != ORTHOGRAPHIC and count > 0:
            view.rings.first, view.rings.count, view.rings.at = first, count, entries
            entries += (count + 1) * int(ROW)
    return entries


def has_rings(asked: CriterionArrays) -> bool:
    """Whether something may be hidden from a view."""
    return bool(asked.view.rings.count or (asked.view_count > 1 and asked.views.numpy()["rings"]["count"].any()))


def fill(
    field: HeightField,
    domain: Domain,
    asked: CriterionArrays,
    max_depth: int,
    relaxed: float,
    buffers: Buffers,
    threads: int,
) -> None:
    """Fill the maps for meshes that keep `relaxed` times what is asked, and leaves down to `max_depth`; of an infinite
    factor nothing is hidden."""
    views = [(k, view) for k, view in enumerate(asked.views.numpy()) if view["rings"]["count"]]
    entries = sum(int(view["rings"]["count"] + 1) for _, view in views) * int(ROW)
    asked.slopes = buffers.get("horizons", entries, wp.float32)
    if relaxed == math.inf:
        buffers.numpy("horizons")[:entries] = -math.inf
        return
    blocks = _blocks_of(field, domain, threads)
    grown = 1 << (domain.unit_bits - ((max_depth - 1) >> 1))
    for k, view in views:
        start = _start(domain, view["near2"], view["cosine2"], view["weight"])
        inputs = [domain, blocks, asked, k, start, grown, relaxed]
        launch.spread(fill_horizon, int(ROW), inputs, step="horizon", threads=threads, cost=BIN_COST)


def horizon_of(
    field: HeightField, domain: Domain, asked: CriterionArrays, max_depth: int, off: float, threads: int
) -> CriterionArrays:
    """What hides from the views of `asked`, with the maps, for a mesh that keeps `off` times what is asked and leaves
    down to `max_depth`."""
    views = asked.views.numpy().copy().view(np.recarray)
    entries = place_rings(domain, views, LARGEST)
    own = CriterionArrays()
    own.view_count, own.error_px2, own.metres2 = len(views), asked.error_px2, asked.metres2
    own.views = wp.array(views, dtype=LocalView, device=launch.DEVICE)
    if entries:
        fill(field, domain, own, max_depth, off, Buffers(), threads)
    return own


def _blocks_of(field: HeightField, domain: Domain, threads: int) -> HeightBlocks:
    """The blocks of a field's surface: found once, and kept with the field."""
    key = "blocks", field.interpolation
    min_height, first, wide = cached(field.found, key, lambda: _find_blocks(domain, threads))
    blocks = HeightBlocks()
    blocks.min_height, blocks.first, blocks.wide = (
        flat(min_height, wp.float32),
        flat(first, wp.int32),
        flat(wide, wp.int32),
    )
    return blocks


def _find_blocks(domain: Domain, threads: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The arrays of `Blocks`; the levels below FINEST are empty."""
    wide, high = (((n - 2) >> FINEST) + 1 for n in (domain.samples.columns, domain.samples.rows))
    finest = np.empty((high, wide, 2), np.float32)
    inputs = [domain, wide, flat(finest, wp.float32)]
    launch.spread(fill_blocks, high, inputs, step="horizon", threads=threads, cost=20.0 * wide)
    return stacked(halvings(finest, np.minimum), int(FINEST))


def _rings_of(domain: Domain, view: LocalView) -> tuple[int, int]:
    """Number of the first ring of a view, and how many there are: from a raster's cell, or from the raster, to its far
    corner; none where the view begins."""
    cells = (domain.samples.columns - 1, domain.samples.rows - 1)
    unit = 1 << (domain.unit_bits - domain.levels)
    near, far = 0.0, 0.0
    eyes = [float(e) for e in view.eye]
    sides = zip(eyes, (domain.west, domain.south), (domain.unit_x, domain.unit_y), cells, strict=False)
    for eye, low, step, count in sides:
        high = low + count * unit * step
        near, far = max(near, low - eye, eye - high), max(far, eye - low, high - eye)
    start = _start(domain, view.near2, view.cosine2, view.weight)
    first = max(ring_of(max(near, unit * min(domain.unit_x, domain.unit_y))), ring_of(start) + 1)
    return first, ring_of(far) + 1 - first


def _start(domain: Domain, near2: float, cosine2: float, weight) -> float:
    """Metres of the terrain's space from the eye, along x or y, beyond which all in the frame is drawn.

    Half the clip range's start is in `near2`; so far along the view is that far in camera space over the cosine.
    """
    nearest = 2.0 * math.sqrt(float(near2) / (float(cosine2) * min(float(weight[0]), float(weight[1]))))
    return max(nearest, domain.unit_x, domain.unit_y)


def ring_of(distance: float) -> int:
    """As in kernels/refine/hiding.py."""
    return int(np.float64(distance).view(np.int64)) >> int(RING_BITS)
