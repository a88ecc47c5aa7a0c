# SPDX-License-Identifier: GPL-3.0-or-later
"""From level to level: halved heights, changes brought to a finer level, and one effect applied over all of them."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from .land_effect import Change, Ground, LandEffect

# Samples along the longer side of the coarsest level, at most: it is always computed for the whole.
COARSEST = 257


def finer(samples: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """float32 [rows, columns] of the next finer level: its own samples where they coincide, between them their mean.

    samples: float32 [(rows + 1) // 2 or one more, likewise], of the coarser level.
    """
    rows, columns = samples.shape
    wide = np.empty((rows, 2 * columns - 1), np.float32)
    wide[:, ::2] = samples
    wide[:, 1::2] = 0.5 * (samples[:, :-1] + samples[:, 1:])
    tall = np.empty((2 * rows - 1, wide.shape[1]), np.float32)
    tall[::2] = wide
    tall[1::2] = 0.5 * (wide[:-1] + wide[1:])
    return tall[: shape[0], : shape[1]]


def coarser(samples: np.ndarray) -> np.ndarray:
    """Every second sample; the last of a side with an even number, which a level ends beyond, is repeated."""
    odd = np.pad(samples, [(0, 1 - n % 2) for n in samples.shape], mode="edge")
    return np.ascontiguousarray(odd[::2, ::2])


def finer_window(samples: np.ndarray, rows: slice, columns: slice) -> np.ndarray:
    """float32: rows and columns of what `finer` makes of a whole level, bit for bit, from no more than it needs."""
    south, west = rows.start // 2, columns.start // 2
    part = samples[south : (rows.stop - 1) // 2 + 2, west : (columns.stop - 1) // 2 + 2]
    up = finer(part, (2 * part.shape[0] - 1, 2 * part.shape[1] - 1))
    return up[rows.start - 2 * south : rows.stop - 2 * south, columns.start - 2 * west : columns.stop - 2 * west]


def apply_by_levels(effect: LandEffect, ground: Ground, values: Mapping[str, float]) -> Change:
    """The change that an effect makes to a whole raster, by way of all its levels.

    values: every parameter, as the effect's `defaults`. The heights, the mask and the layers of coarser levels are
    every second sample of the finer one's.
    """
    size = tuple((n - 1) * step for n, step in zip(ground.heights.shape, (ground.step_y, ground.step_x), strict=True))
    change = _unmasked(effect, replace(ground, size=size), values)
    return masked(effect, change, ground.mask)


def _unmasked(effect: LandEffect, ground: Ground, values: Mapping[str, float]) -> Change:
    """A level starts from the whole of its own change at the coarser one: of a masked one each level would take its
    part again."""
    shape, change = ground.heights.shape, None
    ground = replace(ground, whole=shape)
    if max(shape) > COARSEST:
        below = _unmasked(effect, _coarser_ground(ground), values)
        some = ({name: finer(a, shape) for name, a in of.items()} for of in (below.layers, below.kept))
        change = Change(finer(below.heights, shape), *some)
    if change is not None and effect.finest and max(shape) > effect.finest:
        return change
    return effect.apply(ground, values, change)


def masked(effect: LandEffect, change: Change, mask: np.ndarray | None) -> Change:
    """The part of a change that a mask lets through, if the effect does not see to that itself: of its heights and of
    those layers that are depths."""
    if mask is None or effect.masks:
        return change
    depths = {layer.name for layer in effect.layers if layer.per_metre}
    layers = {name: layer * mask if name in depths else layer for name, layer in change.layers.items()}
    return Change(change.heights * mask, layers, change.kept)


def _coarser_ground(ground: Ground) -> Ground:
    halved = {
        "heights": coarser(ground.heights),
        "missing": None if ground.missing is None else coarser(ground.missing),
        "mask": None if ground.mask is None else coarser(ground.mask),
        "layers": {name: coarser(layer) for name, layer in ground.layers.items()},
    }
    return replace(ground, step_x=2 * ground.step_x, step_y=2 * ground.step_y, level=ground.level + 1, **halved)
