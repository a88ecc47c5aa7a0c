# SPDX-License-Identifier: GPL-3.0-or-later
"""What is gained or lost where a coarser level's change is brought to a finer one, made up for by what lies nearby.

So nothing is lost over all levels, and no tile needs to know of samples far away: it has what the whole has there.
"""

import numpy as np

from .land_effect import Ground
from .levels import finer

# A gain is taken from what was laid down within 2^4 samples, what is left of it within 2^5, and then within 2^6. That
# is so little that the halo of a tile may be shorter: tiles lose or gain up to 1e-4 of what slides.
HALVINGS = 4, 5, 6
# A part of all that was laid down: what is left then and is less is but rounding.
ROUNDING = 1e-7


def balanced(
    laid: np.ndarray, taken: np.ndarray, most: np.ndarray, now: np.ndarray, net: np.ndarray, ground: Ground
) -> tuple[np.ndarray, np.ndarray]:
    """As much of what was laid down, and of what was taken, as keeps the sum: of a whole raster exactly, of a tile as
    far as it looks.

    All float32 [rows, columns] m. net: what a coarser level has moved, whose sum over that level's samples is 0,
    brought to this one. now: the same as it is to be here, of which `laid`, at least 0, may become less or more.
    `taken`, at least 0, becomes less or more, up to `most`, where too little was laid down nearby: at a rim that all
    has slid from.
    """
    elsewhere = now.sum(dtype=np.float64) - laid.sum(dtype=np.float64)
    padding = [(first % (1 << HALVINGS[-1]), 0) for first in ground.first]  # grids lie alike in a tile and in the whole
    within = tuple(slice(before, None) for before, _ in padding)
    laid, gained, done = np.pad(laid, padding), np.pad(now - _all_of(net, ground), padding), 0
    for halvings in HALVINGS:
        there, gained = _gathered(laid, halvings), _gathered(gained, halvings - done)
        part, done = _part(gained, there), halvings
        gained = gained - part * there
        laid = laid - _spread(part, laid.shape, halvings) * laid
    laid, before = laid[within], taken
    if abs(gained).sum() > ROUNDING * laid.sum(dtype=np.float64):
        for sign, room in ((1.0, np.minimum(taken, most - taken)), (-1.0, taken)):
            room = np.pad(room, padding)
            part = _part(np.maximum(sign * gained, 0.0), _gathered(room, done))
            taken = taken + (np.float32(sign) * _spread(part, room.shape, done) * room)[within]
    if all(ground.rims):  # nothing lay nearby, or the coarser level's sum was not quite 0
        there = laid.sum(dtype=np.float64)
        elsewhere -= (taken - before).sum(dtype=np.float64)
        laid = laid - np.float32(_part(elsewhere + there, there)) * laid
    return laid, taken


def _part(gained, there):
    """The part of what is there that goes, at most all; negative for what comes, at most as much again."""
    return np.clip(gained / np.maximum(there, 1e-12), -1.0, 1.0)


def _gathered(samples: np.ndarray, halvings: int) -> np.ndarray:
    """float64: so many times [rows // 2 + 1, columns // 2 + 1]: the samples of `finer`, each given back what it would
    give; the sum stays."""
    for axis in (0, 1) * halvings:
        along = np.moveaxis(samples, axis, 0)
        some = np.zeros((len(along) // 2 + 1, along.shape[1]))
        some[: (len(along) + 1) // 2] = along[::2]
        between = 0.5 * along[1::2]
        some[: len(between)] += between
        some[1 : len(between) + 1] += between
        samples = np.moveaxis(some, 0, axis)
    return samples


def _spread(part: np.ndarray, shape: tuple[int, int], halvings: int) -> np.ndarray:
    """float32 of a shape, from what is so many halvings coarser."""
    if halvings > 1:
        part = _spread(part, (shape[0] // 2 + 1, shape[1] // 2 + 1), halvings - 1)
    return finer(part.astype(np.float32), shape)


def _all_of(net: np.ndarray, ground: Ground) -> np.ndarray:
    """What was brought to a finer level, with what is missing at the raster's rims: there a coarser sample has samples
    of the finer level on one side of it only, or lies beyond the last one."""
    net, rims = net.copy(), ground.rims
    for axis, (start, end) in enumerate((rims[:2], rims[2:])):
        along = np.moveaxis(net, axis, 0)
        odd = (ground.first[axis] + len(along)) % 2 == 1
        last = 0.5 * along[-1] if odd else 3.0 * along[-1] - 1.5 * along[-2]
        if start:
            along[0] *= np.float32(1.5)
        if end:
            along[-1] += last
    return net
