# SPDX-License-Identifier: GPL-3.0-or-later
"""Conservation of mass when a coarser level's change is interpolated to a finer one.

Interpolation gains or loses material, which deposits nearby make up for. All levels together conserve mass, and a tile
has the result of the whole without reading distant samples.
"""

import numpy as np

from .height_operator import OperatorGround
from .levels import finer

# A gain is removed from deposits within 2^4 samples, the remainder within 2^5, then 2^6. The last remainder is so small
# that the halo of a tile may be shorter: tiles lose or gain up to 1e-4 of the moved material.
HALVINGS = 4, 5, 6
# A remainder below this fraction of all deposits is rounding.
ROUNDING = 1e-7


def balance_mass(
    deposited: np.ndarray,
    eroded: np.ndarray,
    max_eroded: np.ndarray,
    change: np.ndarray,
    net: np.ndarray,
    ground: OperatorGround,
) -> tuple[np.ndarray, np.ndarray]:
    """Return deposits and erosion scaled so that mass is conserved, both float32 [rows, columns] m.

    Mass is conserved for a whole raster, to rounding, and for a tile within its window. Where too little is deposited
    nearby, as at a border that all material has left, erosion changes instead. Arrays are float32 [rows, columns] m and
    are not written into.

    Args:
        deposited: deposits, >= 0, which are scaled first.
        eroded: erosion, >= 0.
        max_eroded: largest erosion of each sample.
        change: change of this level before the correction; it includes `deposited`.
        net: the coarser level's change, interpolated to this level. Its sum over that level's samples is 0.
        ground: this level or tile. Only its position in the whole level is read: `first`, row and column of its first
            sample, and `rims`, whether its south, north, west and east side is the raster's border and no cut.
    """
    # gain: material to remove, metres by which samples rise above the coarser change; negative where some is missing.
    # It is summed to the samples of a level that is `gathered` halvings coarser.
    # other_change: sum of the change without deposits, which the last step needs.
    other_change = change.sum(dtype=np.float64) - deposited.sum(dtype=np.float64)
    padding = [(first % (1 << HALVINGS[-1]), 0) for first in ground.first]  # aligns the grids of tiles and of the whole
    unpadded = tuple(slice(start, None) for start, _ in padding)
    expected = _complete(net, ground)  # the coarser change with what interpolation lost at the raster's borders
    deposited, gain, gathered = np.pad(deposited, padding), np.pad(change - expected, padding), 0
    # Remove gains from deposits within 2^4 samples, or add to them; what remains is balanced within 2^5, then 2^6.
    for halvings in HALVINGS:
        available, gain = _gather(deposited, halvings), _gather(gain, halvings - gathered)
        fraction, gathered = _clipped_ratio(gain, available), halvings
        gain = gain - fraction * available
        deposited = deposited - _interpolate(fraction, deposited.shape, halvings) * deposited
    deposited, eroded_before = deposited[unpadded], eroded
    # Where material must still be removed, erode up to twice as much (`sign` 1); where it is missing, less (-1).
    if abs(gain).sum() > ROUNDING * deposited.sum(dtype=np.float64):
        for sign, available in ((1.0, np.minimum(eroded, max_eroded - eroded)), (-1.0, eroded)):
            available = np.pad(available, padding)
            fraction = _clipped_ratio(np.maximum(sign * gain, 0.0), _gather(available, gathered))
            added = np.float32(sign) * _interpolate(fraction, available.shape, gathered) * available
            eroded = eroded + added[unpadded]
    # Of a whole raster, deposits far away make up for the remainder: nothing was near enough, or the coarser level's
    # sum was not exactly 0.
    if all(ground.rims):
        total = deposited.sum(dtype=np.float64)
        other_change -= (eroded - eroded_before).sum(dtype=np.float64)
        deposited = deposited - np.float32(_clipped_ratio(other_change + total, total)) * deposited
    return deposited, eroded


def _clipped_ratio(gain: np.ndarray | float, available: np.ndarray | float) -> np.ndarray:
    """Return the fraction of the available material to remove, at most 1; negative to add material, at least -1.

    gain: material to remove. Both are in one unit.
    """
    return np.clip(gain / np.maximum(available, 1e-12), -1.0, 1.0)


def _gather(samples: np.ndarray, halvings: int) -> np.ndarray:
    """Sum samples to a level that is `halvings` coarser: each is distributed over the coarser samples around it.

    It is the transpose of the interpolation `finer`, and the sum stays the same. Returns float64, each time [rows // 2
    + 1, columns // 2 + 1].
    """
    for axis in (0, 1) * halvings:
        along = np.moveaxis(samples, axis, 0)
        coarse = np.zeros((len(along) // 2 + 1, along.shape[1]))
        coarse[: (len(along) + 1) // 2] = along[::2]
        between = 0.5 * along[1::2]
        coarse[: len(between)] += between
        coarse[1 : len(between) + 1] += between
        samples = np.moveaxis(coarse, 0, axis)
    return samples


def _interpolate(samples: np.ndarray, shape: tuple[int, ...], halvings: int) -> np.ndarray:
    """Interpolate to a level that is `halvings` finer, one level at a time; float32 [shape]."""
    if halvings > 1:
        samples = _interpolate(samples, (shape[0] // 2 + 1, shape[1] // 2 + 1), halvings - 1)
    return finer(samples.astype(np.float32), shape)


def _complete(net: np.ndarray, ground: OperatorGround) -> np.ndarray:
    """Return an interpolated change, metres, with the material added that interpolation loses at the raster's borders.

    Along an axis a coarser sample has the weights 1/2, 1 and 1/2 at finer ones, 2 in all. At the border it has finer
    samples on one side only (1 1/2 in all), or is beyond the last of them (1/2). Only the sides with `ground.rims` are
    the raster's border; the others are cuts of a tile.
    """
    net, rims = net.copy(), ground.rims
    for axis, (start, end) in enumerate((rims[:2], rims[2:])):
        along = np.moveaxis(net, axis, 0)
        ends_on_coarser = (ground.first[axis] + len(along)) % 2 == 1
        # A last coarser sample beyond the finer ones is 2 * along[-1] - along[-2], of which 1 1/2 times are missing.
        last = 0.5 * along[-1] if ends_on_coarser else 3.0 * along[-1] - 1.5 * along[-2]
        if start:
            along[0] *= np.float32(1.5)
        if end:
            along[-1] += last
    return net
