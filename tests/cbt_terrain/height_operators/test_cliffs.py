# SPDX-License-Identifier: GPL-3.0-or-later
"""Start heights of a finer level at cliffs."""

import numpy as np
import pytest
from adaptive_terrain.cbt_terrain.height_operators.cliffs import limit_at_cliffs
from adaptive_terrain.cbt_terrain.height_operators.levels import coarser, finer

DROP = 10.0


def cliff():
    """Return a wall of 400 m between columns 9 and 10 of 9 x 21 samples."""
    return np.where(np.arange(21) < 10, 100.0, 500.0).astype(np.float32) * np.ones((9, 1), np.float32)


def slid(before):
    """Return heights after the interpolated coarser change of walls that slide half down."""
    mean = np.float32(0.5) * (before.min() + before.max())
    change = np.where(abs(np.arange(before.shape[1]) - 9.5) < 3, mean - before, np.float32(0.0))
    return before + finer(coarser(change), before.shape)


def test_there_is_neither_a_spike_nor_a_trench():
    before = cliff()
    after = slid(before)
    assert after[:, 9].max() < 150.0 and after[:, 11].max() == 300.0  # the trench: a mean of +200 and -200
    found = limit_at_cliffs(after, before, after, (0, 0), DROP)
    assert (found[:, 8:12] >= 290.0).all() and (found[:, 8:12] <= 310.0).all()
    assert (found[:, ::2] == after[:, ::2]).all()


@pytest.mark.parametrize("axis", [0, 1])
def test_a_tile_that_begins_anywhere_has_the_same(axis):
    before = np.ascontiguousarray(np.moveaxis(cliff(), 0, axis))
    after = np.ascontiguousarray(np.moveaxis(slid(cliff()), 0, axis))
    whole = limit_at_cliffs(after, before, after, (0, 0), DROP)
    for south, west in ((1, 0), (0, 1), (3, 3)):
        part = np.s_[south:, west:]
        tile = limit_at_cliffs(after[part], before[part], after[part], (south, west), DROP)
        inner = np.s_[int(south > 0) :, int(west > 0) :]  # the first lacks a coarser neighbour
        assert (tile[inner] == whole[part][inner]).all()


def test_peaks_and_pits_of_the_ground_are_preserved():
    before = np.full((9, 9), 100.0, np.float32)
    before[3, 3], before[5, 5] = 180.0, 30.0
    after = before - np.float32(20.0)
    assert (limit_at_cliffs(after, before, after, (0, 0), DROP) == after).all()
