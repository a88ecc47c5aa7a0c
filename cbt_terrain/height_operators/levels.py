# SPDX-License-Identifier: GPL-3.0-or-later
"""Transfers between levels, and the application of one operator over all levels."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from .height_operator import Change, HeightOperator, OperatorGround

# Maximum number of samples along the longer side of the coarsest level, which is always computed as a whole.
COARSEST = 257


def finer(samples: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Interpolate samples of a level linearly to `shape`, float32 [rows, columns], of the next finer level.

    samples: float32 [(rows + 1) // 2 or one more, (columns + 1) // 2 or one more].
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
    """Return every second sample. The last one of a side with an even number is repeated."""
    odd_sized = np.pad(samples, [(0, 1 - n % 2) for n in samples.shape], mode="edge")
    return np.ascontiguousarray(odd_sized[::2, ::2])


def finer_window(samples: np.ndarray, rows: slice, columns: slice) -> np.ndarray:
    """Interpolate the samples of a level to a window of the next finer level.

    The result has the bits of that window of `finer`, which interpolates the whole level. rows, columns: the window in
    the finer level.
    """
    south, west = rows.start // 2, columns.start // 2
    # One coarse sample after the last row and column, as odd ones are between two coarse samples.
    coarse = samples[south : (rows.stop - 1) // 2 + 2, west : (columns.stop - 1) // 2 + 2]
    fine = finer(coarse, (2 * coarse.shape[0] - 1, 2 * coarse.shape[1] - 1))
    return fine[rows.start - 2 * south : rows.stop - 2 * south, columns.start - 2 * west : columns.stop - 2 * west]


def interpolate_change(change: Change, shape: tuple[int, ...]) -> Change:
    """Interpolate all arrays of a change to the next finer level."""
    layers, state = ({name: finer(a, shape) for name, a in arrays.items()} for arrays in (change.layers, change.state))
    return Change(finer(change.heights, shape), layers, state)


def apply_by_levels(effect: HeightOperator, ground: OperatorGround, values: Mapping[str, float]) -> Change:
    """Return the change that an operator makes to a whole raster over all levels.

    values: every parameter. Heights, mask and layers of a coarser level are every second sample of the finer one's.
    """
    rows, columns = ground.heights.shape
    size = (rows - 1) * ground.step_y, (columns - 1) * ground.step_x
    change = _apply_without_mask(effect, replace(ground, size=size), values)
    return apply_mask(effect, change, ground.mask)


def _apply_without_mask(effect: HeightOperator, ground: OperatorGround, values: Mapping[str, float]) -> Change:
    """Return the change of an operator over all levels, before it is multiplied by its mask.

    The mask would otherwise be applied again at each level. effect: the operator's declaration. values: its parameters
    by name.
    """
    (rows, columns), change = ground.heights.shape, None
    ground = replace(ground, whole=(rows, columns))
    if max(rows, columns) > COARSEST:
        change = interpolate_change(_apply_without_mask(effect, coarser_ground(ground), values), (rows, columns))
    if change is not None and effect.finest and max(rows, columns) > effect.finest:
        return change  # finer levels only interpolate
    return effect.apply(ground, values, change)


def apply_mask(effect: HeightOperator, change: Change, mask: np.ndarray | None) -> Change:
    """Return the change with heights and by-products that add up multiplied by a mask.

    Return it as it is if the operator applies masks itself. mask: weights 0 to 1, float32 [rows, columns]; None changes
    nothing. effect: the operator's declaration.
    """
    if mask is None or effect.masks:
        return change
    scaled = {layer.name for layer in effect.layers if layer.adds_up}
    layers = {name: layer * mask if name in scaled else layer for name, layer in change.layers.items()}
    return Change(change.heights * mask, layers, change.state)


def coarser_ground(ground: OperatorGround, halve: Callable[[np.ndarray], np.ndarray] = coarser) -> OperatorGround:
    """Return a level's ground at every second sample, as an operator reads it at the next coarser level.

    The caller sets `whole` and `first`. halve: returns every second one of an array's samples.
    """
    return replace(
        ground,
        step_x=2 * ground.step_x,
        step_y=2 * ground.step_y,
        level=ground.level + 1,
        heights=halve(ground.heights),
        missing=None if ground.missing is None else halve(ground.missing),
        mask=None if ground.mask is None else halve(ground.mask),
        layers={name: halve(layer) for name, layer in ground.layers.items()},
    )
